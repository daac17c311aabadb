//! Devices through the kernel's HID driver, `/dev/hidrawN`, with hidapi.

use std::{
    collections::BTreeMap,
    ffi::{CStr, CString},
    fs::{self, OpenOptions},
    io,
    os::unix::ffi::OsStrExt,
    path::{Path, PathBuf},
    time::Duration,
};

use hidapi::{HidApi, HidDevice, HidError};

use super::{
    Warning,
    scan::{Backend, Control, Found, Input, InputReader, Opened},
};
use crate::{
    catalog::{self, Access, Entry},
    usb::{Port, UsbId},
};

/// One hidraw node: one interface of a device.
struct Node {
    path: CString,
    interface: u8,
    /// Its interrupt IN endpoint, if the kernel says so.
    endpoint: Option<u8>,
}

/// Reaches devices of the catalogue whose access is [`Access::Hidraw`].
#[derive(Default)]
pub struct Hidraw {
    api: Option<HidApi>,
    nodes: BTreeMap<Port, Vec<Node>>,
}

impl Hidraw {
    /// A backend that has not looked yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    fn listing(&mut self) -> Result<&mut HidApi, HidError> {
        if self.api.is_none() {
            self.api = Some(HidApi::new()?);
        }
        let api = self.api.as_mut().ok_or(HidError::InitializationError)?;
        api.refresh_devices()?;
        Ok(api)
    }
}

impl Backend for Hidraw {
    fn name(&self) -> &'static str {
        "hidraw"
    }

    fn scan(&mut self) -> Result<Vec<Found>, Warning> {
        let mut found: Vec<Found> = Vec::new();
        let mut nodes: BTreeMap<Port, Vec<Node>> = BTreeMap::new();
        let api = self.listing().map_err(|error| Warning::Listing {
            access: "hidraw",
            reason: error.to_string(),
        })?;
        for info in api.device_list() {
            let id = UsbId::new(info.vendor_id(), info.product_id());
            let Some(entry) = catalog::find(id).filter(|e| e.access == Access::Hidraw) else {
                continue;
            };
            let place = Place::of(info.path());
            let of_device = nodes.entry(place.port).or_default();
            // One node is listed once for each of its usages.
            if of_device
                .iter()
                .any(|node| node.path.as_c_str() == info.path())
            {
                continue;
            }
            if of_device.is_empty() {
                found.push(Found {
                    port: place.port,
                    id,
                    entry,
                });
            }
            of_device.push(Node {
                path: info.path().to_owned(),
                interface: u8::try_from(info.interface_number()).unwrap_or(0),
                endpoint: place.endpoint,
            });
        }
        self.nodes = nodes;
        Ok(found)
    }

    fn open(&mut self, found: &Found) -> Result<Opened, Warning> {
        let Found { port, entry, .. } = *found;
        let failed = |reason: String| Warning::Open {
            name: entry.name,
            port,
            reason,
        };
        let api = self
            .api
            .as_ref()
            .ok_or_else(|| failed("hidapi is not there".to_owned()))?;
        let mut control = Interfaces::default();
        let mut inputs = Vec::new();
        for node in self.nodes.get(&port).into_iter().flatten() {
            let open = || {
                api.open_path(&node.path)
                    .map_err(|error| refusal(entry, port, node, &error))
            };
            // The kernel queues reports for each opening apart; the one for control transfers is
            // never read, which costs the kernel 64 reports and nobody else anything.
            control.0.push((node.interface, open()?));
            let endpoint = node.endpoint.unwrap_or(0x81 + node.interface);
            if entry.endpoints.contains(&endpoint) {
                inputs.push(Input {
                    endpoint,
                    reader: Box::new(Reader(open()?)),
                });
            }
        }
        if inputs.is_empty() {
            return Err(failed(
                "none of its interfaces has an endpoint that posed reads".into(),
            ));
        }
        Ok(Opened {
            control: Box::new(control),
            inputs,
        })
    }
}

/// hidapi gives the reason as text only: the operating system is asked again.
fn refusal(entry: &Entry, port: Port, node: &Node, error: &HidError) -> Warning {
    let path = Path::new(std::ffi::OsStr::from_bytes(node.path.as_bytes()));
    let again = OpenOptions::new().read(true).write(true).open(path);
    let name = entry.name;
    match again {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            Warning::Permission { name, port }
        }
        _ => Warning::Open {
            name,
            port,
            reason: error.to_string(),
        },
    }
}

/// Where a hidraw node hangs, from `/sys/class/hidraw/hidrawN`.
struct Place {
    port: Port,
    endpoint: Option<u8>,
}

impl Place {
    /// Devices that hang on no USB bus, as those of `uhid`, are told apart by their node's number
    /// and counted to bus 0, which USB does not have.
    fn of(path: &CStr) -> Self {
        let path = Path::new(std::ffi::OsStr::from_bytes(path.to_bytes()));
        let name = path.file_name().unwrap_or_default();
        let link = Path::new("/sys/class/hidraw").join(name);
        let device = fs::canonicalize(link).unwrap_or_default();
        let number = |folder: &Path, file| -> Option<u16> {
            fs::read_to_string(folder.join(file))
                .ok()?
                .trim()
                .parse()
                .ok()
        };
        let port = device.ancestors().find_map(|folder| {
            Some(Port {
                bus: number(folder, "busnum")?,
                address: number(folder, "devnum")?,
            })
        });
        let interface = device
            .ancestors()
            .find(|folder| folder.join("bInterfaceNumber").exists());
        let digits: String = name
            .to_string_lossy()
            .chars()
            .filter(char::is_ascii_digit)
            .collect();
        let address = digits.parse().unwrap_or(0);
        Self {
            port: port.unwrap_or(Port { bus: 0, address }),
            endpoint: interface
                .map(PathBuf::from)
                .and_then(|folder| in_endpoint(&folder)),
        }
    }
}

/// The IN endpoint of an interface: the kernel has a folder `ep_81` for endpoint 0x81.
fn in_endpoint(interface: &Path) -> Option<u8> {
    let names = fs::read_dir(interface)
        .ok()?
        .flatten()
        .map(|entry| entry.file_name());
    let address =
        |name: std::ffi::OsString| u8::from_str_radix(name.to_str()?.strip_prefix("ep_")?, 16).ok();
    names
        .filter_map(address)
        .filter(|endpoint| endpoint & 0x80 != 0)
        .min()
}

struct Reader(HidDevice);

impl InputReader for Reader {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let millis = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        self.0
            .read_timeout(buffer, millis)
            .map_err(io::Error::other)
    }
}

/// A device's interfaces by their numbers.
#[derive(Default)]
struct Interfaces(Vec<(u8, HidDevice)>);

impl Interfaces {
    fn get(&self, number: u8) -> io::Result<&HidDevice> {
        let hit = self.0.iter().find(|(interface, _)| *interface == number);
        hit.or(self.0.first())
            .map(|(_, device)| device)
            .ok_or_else(|| {
                io::Error::new(io::ErrorKind::NotFound, "the device has no such interface")
            })
    }
}

impl Control for Interfaces {
    fn set_feature(&mut self, interface: u8, data: &[u8]) -> io::Result<()> {
        self.get(interface)?
            .send_feature_report(data)
            .map_err(io::Error::other)
    }

    fn output(&mut self, interface: u8, data: &[u8]) -> io::Result<()> {
        let written = self.get(interface)?.write(data);
        written.map(|_| ()).map_err(io::Error::other)
    }

    fn get_feature(&mut self, interface: u8, data: &mut [u8]) -> io::Result<usize> {
        self.get(interface)?
            .get_feature_report(data)
            .map_err(io::Error::other)
    }
}
