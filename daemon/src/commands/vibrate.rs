//! `posed vibrate`: to find out which controller is which, and whether its haptics work.

use posed_proto::v1::{
    ApplyHapticsRequest, Device, ListDevicesRequest, device_service_client::DeviceServiceClient,
};
use tonic::Status;

use super::CommandError;
use crate::{cli::VibrateArgs, follow::FollowError, grpc::convert};

/// Has a device of a running posed buzz.
///
/// # Errors
/// No posed answers, or it has no such device, or the device cannot buzz.
pub fn run(args: &VibrateArgs) -> Result<(), CommandError> {
    let server = args.server.server()?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let refused = |status: Status| CommandError::Input(status.message().into());
        let channel = server.connect().await.map_err(FollowError::from)?;
        let mut client = DeviceServiceClient::new(channel);
        let listed = client.list_devices(ListDevicesRequest {}).await;
        let devices = listed.map_err(refused)?.into_inner().devices;
        let device = named(&devices, &args.device)?;
        let request = ApplyHapticsRequest {
            device: device.id,
            duration_s: Some(args.seconds),
            frequency_hz: Some(args.frequency),
            amplitude: Some(args.strength),
        };
        client.apply_haptics(request).await.map_err(refused)?;
        println!("{} {} buzzes", device.model, device.serial);
        Ok(())
    })
}

/// The device of a role or a serial number.
fn named<'a>(devices: &'a [Device], name: &str) -> Result<&'a Device, CommandError> {
    let is_named = |device: &&Device| {
        device.serial.eq_ignore_ascii_case(name) || convert::role_name(device.role()) == name
    };
    devices.iter().find(is_named).ok_or_else(|| {
        let buzzers = devices.iter().filter(|device| device.has_haptics);
        let known: Vec<_> = buzzers
            .map(|device| {
                let role = convert::role_name(device.role());
                format!("{} ({role})", device.serial)
            })
            .collect();
        let known = match known.len() {
            0 => "none that can buzz is there".into(),
            _ => format!("there are {}", known.join(", ")),
        };
        CommandError::Input(format!("no device is called {name}: {known}"))
    })
}

#[cfg(test)]
mod tests {
    use posed_proto::v1::Role;

    use super::*;

    #[test]
    fn a_device_goes_by_its_role_or_its_serial_number() {
        let device = |id, serial: &str, role: Role| Device {
            id,
            serial: serial.into(),
            role: role.into(),
            has_haptics: role != Role::Head,
            ..Device::default()
        };
        let devices = [
            device(0, "LHR-1", Role::Head),
            device(1, "LHR-2", Role::LeftHand),
        ];
        let found = |name| named(&devices, name).map(|device| device.id);
        assert_eq!(found("left_hand").unwrap(), 1);
        assert_eq!(found("lhr-1").unwrap(), 0);
        let error = found("right_hand").unwrap_err().to_string();
        assert!(error.ends_with("there are LHR-2 (left_hand)"), "{error}");
    }
}
