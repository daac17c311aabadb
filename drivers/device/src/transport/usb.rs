//! Devices through libusb, the kernel's driver detached, with rusb.

use std::{io, path::Path, sync::Arc, time::Duration};

use rusb::{Context, Device, DeviceHandle, UsbContext};

use super::{
    Warning,
    scan::{Backend, Control, Found, Input, InputReader, Opened},
};
use crate::{
    catalog::{self, Access, CATALOG},
    usb::{Port, Setup, UsbId},
};

/// How long a control transfer may take.
const CONTROL_TIMEOUT: Duration = Duration::from_millis(500);
/// Where the kernel has its USB devices.
const DEVICES: &str = "/dev/bus/usb";

/// Reaches devices of the catalogue whose access is [`Access::Usb`].
pub struct Usb {
    context: Option<Context>,
    devices: Vec<(Port, Device<Context>)>,
    every: bool,
}

impl Usb {
    /// A backend for the devices that are reached this way.
    #[must_use]
    pub fn new() -> Self {
        Self {
            context: None,
            devices: Vec::new(),
            every: false,
        }
    }

    /// A backend for every device of the catalogue: where the kernel has no HID driver for them.
    #[must_use]
    pub fn for_every_device() -> Self {
        Self {
            every: true,
            ..Self::new()
        }
    }

    /// Whether the catalogue has a device that this backend would read.
    #[must_use]
    pub fn is_wanted(&self) -> bool {
        self.every || CATALOG.iter().any(|entry| entry.access == Access::Usb)
    }

    fn list(&mut self) -> Result<Vec<(Device<Context>, UsbId)>, rusb::Error> {
        if self.context.is_none() {
            self.context = Some(Context::new()?);
        }
        let context = self.context.as_ref().ok_or(rusb::Error::Other)?;
        let with_id = |device: Device<Context>| {
            let descriptor = device.device_descriptor().ok()?;
            Some((
                device,
                UsbId::new(descriptor.vendor_id(), descriptor.product_id()),
            ))
        };
        Ok(context.devices()?.iter().filter_map(with_id).collect())
    }
}

impl Default for Usb {
    fn default() -> Self {
        Self::new()
    }
}

impl Backend for Usb {
    fn name(&self) -> &'static str {
        "libusb"
    }

    fn scan(&mut self) -> Result<Vec<Found>, Warning> {
        let failed = |reason: String| Warning::Listing {
            access: "libusb",
            reason,
        };
        if !Path::new(DEVICES).exists() {
            return Err(failed(format!(
                "there is no {DEVICES} (no USB, or a container)"
            )));
        }
        let devices = self.list().map_err(|error| failed(error.to_string()))?;
        self.devices.clear();
        let mut found = Vec::new();
        for (device, id) in devices {
            let every = self.every;
            let reached = |entry: &&catalog::Entry| every || entry.access == Access::Usb;
            if let Some(entry) = catalog::find(id).filter(reached) {
                let bus = u16::from(device.bus_number());
                let port = Port {
                    bus,
                    address: u16::from(device.address()),
                };
                found.push(Found { port, id, entry });
                self.devices.push((port, device));
            }
        }
        Ok(found)
    }

    fn open(&mut self, found: &Found) -> Result<Opened, Warning> {
        let Found { port, entry, .. } = *found;
        let name = entry.name;
        let failed = |error| match error {
            rusb::Error::Access => Warning::Permission { name, port },
            error => Warning::Open {
                name,
                port,
                reason: error.to_string(),
            },
        };
        let device = self
            .devices
            .iter()
            .find(|(at, _)| *at == port)
            .map(|(_, device)| device);
        let device = device.ok_or_else(|| failed(rusb::Error::NoDevice))?;
        let handle = Arc::new(device.open().map_err(failed)?);
        handle.set_auto_detach_kernel_driver(true).map_err(failed)?;
        let endpoints = endpoints(device, entry.endpoints).map_err(failed)?;
        if endpoints.is_empty() {
            return Err(failed(rusb::Error::NotFound));
        }
        let mut inputs = Vec::new();
        for (interface, endpoint) in endpoints {
            handle.claim_interface(interface).map_err(failed)?;
            let reader = Box::new(Reader {
                handle: Arc::clone(&handle),
                endpoint,
            });
            inputs.push(Input { endpoint, reader });
        }
        Ok(Opened {
            control: Box::new(ControlPipe(handle)),
            inputs,
        })
    }
}

/// Which of the endpoints that posed reads the device has, and on which interfaces.
fn endpoints(device: &Device<Context>, wanted: &[u8]) -> Result<Vec<(u8, u8)>, rusb::Error> {
    let configuration = device.active_config_descriptor()?;
    let mut endpoints = Vec::new();
    for interface in configuration.interfaces() {
        let settings = interface
            .descriptors()
            .filter(|setting| setting.setting_number() == 0);
        for endpoint in settings.flat_map(|s| s.endpoint_descriptors().collect::<Vec<_>>()) {
            if wanted.contains(&endpoint.address()) {
                endpoints.push((interface.number(), endpoint.address()));
            }
        }
    }
    Ok(endpoints)
}

struct Reader {
    handle: Arc<DeviceHandle<Context>>,
    endpoint: u8,
}

impl InputReader for Reader {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        match self.handle.read_interrupt(self.endpoint, buffer, timeout) {
            Err(rusb::Error::Timeout) => Ok(0),
            result => result.map_err(io::Error::other),
        }
    }
}

/// Endpoint 0.
struct ControlPipe(Arc<DeviceHandle<Context>>);

fn feature(data: &[u8]) -> u16 {
    report(Setup::REPORT_FEATURE, data)
}

fn report(kind: u8, data: &[u8]) -> u16 {
    u16::from(kind) << 8 | u16::from(data.first().copied().unwrap_or(0))
}

impl ControlPipe {
    fn set_report(&self, interface: u8, value: u16, data: &[u8]) -> io::Result<()> {
        let result = self.0.write_control(
            0x21,
            Setup::HID_SET_REPORT,
            value,
            u16::from(interface),
            data,
            CONTROL_TIMEOUT,
        );
        result.map(|_| ()).map_err(io::Error::other)
    }
}

impl Control for ControlPipe {
    fn set_feature(&mut self, interface: u8, data: &[u8]) -> io::Result<()> {
        self.set_report(interface, feature(data), data)
    }

    fn output(&mut self, interface: u8, data: &[u8]) -> io::Result<()> {
        self.set_report(interface, report(Setup::REPORT_OUTPUT, data), data)
    }

    fn get_feature(&mut self, interface: u8, data: &mut [u8]) -> io::Result<usize> {
        let (value, index) = (feature(data), u16::from(interface));
        let result = self.0.read_control(
            0xa1,
            Setup::HID_GET_REPORT,
            value,
            index,
            data,
            CONTROL_TIMEOUT,
        );
        result.map_err(io::Error::other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_without_usb_is_told_from_one_without_devices() {
        match Usb::for_every_device().scan() {
            Ok(found) => assert!(found.iter().all(|found| catalog::find(found.id).is_some())),
            Err(warning) => assert!(warning.to_string().contains("libusb"), "{warning}"),
        }
    }
}
