//! The control transfers of a start: what a host asks of each device, and the answers.

use super::blueprint::Blueprint;
use super::configuration;
use super::device::{Device, Model};
use crate::usb::{Setup, Transfer, UsbId};

/// A control transfer: when (seconds after the start), set-up and data.
pub(super) struct Exchange {
    pub(super) seconds: f64,
    pub(super) setup: Setup,
    pub(super) data: Vec<u8>,
}

impl Exchange {
    /// Endpoint and kind of the packet that carries it.
    pub(super) fn transfer(&self) -> (u8, Transfer) {
        let input = self.setup.request_type & 0x80;
        (input, Transfer::Control(self.setup))
    }
}

/// `idVendor` and `idProduct` of the USB device that carries a model.
pub(super) fn usb_id(model: Model) -> UsbId {
    match model {
        Model::Headset => UsbId::new(0x28de, 0x2300),
        Model::LeftController | Model::RightController => UsbId::new(0x28de, 0x2102),
    }
}

/// Everything that is asked and answered, in order; `old` under base stations of generation 1.
pub(super) fn exchanges(device: &Device, blueprint: &Blueprint, old: bool) -> Vec<Exchange> {
    let mut all = Vec::new();
    let mut push = |after_s: f64, setup: Setup, data: Vec<u8>| {
        let last = all
            .last()
            .map_or(0.0, |exchange: &Exchange| exchange.seconds);
        all.push(Exchange {
            seconds: last + after_s,
            setup,
            data,
        });
    };
    push(
        2e-3,
        get_descriptor(),
        device_descriptor(usb_id(device.model)),
    );
    for command in start_commands(device.model, old) {
        push(2e-4, set_feature(command), command.to_vec());
    }
    let range = blueprint.range;
    let mut scales = vec![0x01, range.gyro_mode, range.acc_mode];
    scales.resize(64, 0);
    push(2e-3, get_feature(0x01), scales);
    let document = configuration::document(device.model, &device.serial, blueprint);
    for report in configuration::feature_reports(&document) {
        push(1.3e-3, get_feature(report[0]), report);
    }
    all
}

/// Feature reports that a host sends to switch light on, in the second raw mode where there is one.
fn start_commands(model: Model, old: bool) -> &'static [&'static [u8]] {
    match model {
        Model::Headset if old => &[&[0x04, 0x00, 0, 0, 0], &[0x07, 0x03, 0, 0, 0]],
        _ if old => &[&[
            0xff, 0x96, 0x10, 0xbe, 0x5b, 0x32, 0x54, 0x11, 0xcf, 0x83, 0x75, 0x53, 0x8a, 0x08,
            0x6a, 0x53, 0x58, 0xd0, 0xb1,
        ]],
        Model::Headset => &[&[0x04, 0x01, 0, 0, 0], &[0x07, 0x03, 0, 0, 0]],
        Model::LeftController | Model::RightController => &[
            &[
                0xff, 0x96, 0x10, 0xbe, 0x5b, 0x32, 0x54, 0x11, 0xcf, 0x83, 0x75, 0x53, 0x8a, 0x08,
                0x6a, 0x53, 0x58, 0xd0, 0xb1,
            ],
            &[0xff, 0x87, 0x06, 0x01, 0x01, 0x00, 0x02, 0x00, 0x00],
            &[0xff, 0x87, 0x03, 0x00, 0x01, 0x00],
        ],
    }
}

pub(super) fn get_descriptor() -> Setup {
    Setup {
        request_type: 0x80,
        request: Setup::GET_DESCRIPTOR,
        value: u16::from(Setup::DESCRIPTOR_DEVICE) << 8,
        index: 0,
        length: 18,
    }
}

fn get_feature(id: u8) -> Setup {
    Setup {
        request_type: 0xa1,
        request: Setup::HID_GET_REPORT,
        value: u16::from(Setup::REPORT_FEATURE) << 8 | u16::from(id),
        index: 0,
        length: 64,
    }
}

fn set_feature(report: &[u8]) -> Setup {
    Setup {
        request_type: 0x21,
        request: Setup::HID_SET_REPORT,
        value: u16::from(Setup::REPORT_FEATURE) << 8 | u16::from(report[0]),
        index: 0,
        length: report.len() as u16,
    }
}

/// A device descriptor (USB 2.0, 9.6.1).
pub(super) fn device_descriptor(id: UsbId) -> Vec<u8> {
    let mut bytes = vec![18, 1, 0x00, 0x02, 0, 0, 0, 64];
    bytes.extend(id.vendor.to_le_bytes());
    bytes.extend(id.product.to_le_bytes());
    // Release 1.0; strings 1 to 3; one configuration.
    bytes.extend([0x00, 0x01, 1, 2, 3, 1]);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Options, Placement};

    #[test]
    fn descriptor_scales_and_configuration_are_exchanged() {
        let device = Device::new(Model::RightController, |_| Placement::IDENTITY);
        let blueprint = Blueprint::new(device.model, &Options::default(), 2);
        let exchanges = exchanges(&device, &blueprint, false);
        assert!(exchanges[0].setup.is_get_device_descriptor());
        assert_eq!(exchanges[0].data[8..12], [0xde, 0x28, 0x02, 0x21]);
        let ids: Vec<_> = exchanges
            .iter()
            .filter_map(|e| e.setup.feature_read())
            .collect();
        assert_eq!(ids[..3], [0x01, 0x10, 0x11]);
        let writes = exchanges
            .iter()
            .filter_map(|e| e.setup.feature_write())
            .count();
        assert_eq!(writes, 3);
        assert!(
            exchanges
                .windows(2)
                .all(|pair| pair[0].seconds < pair[1].seconds)
        );
        assert!(
            exchanges.last().unwrap().seconds < 0.2,
            "done soon after the start"
        );
    }
}
