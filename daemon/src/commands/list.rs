//! `posed list`.

use std::{collections::BTreeMap, fs, io, path::Path};

use posed_device::{catalog, usb::UsbId};
use serde_json::json;

use super::CommandError;
use crate::cli::ListArgs;

/// Where the kernel lists its hidraw nodes.
const HIDRAW: &str = "/sys/class/hidraw";

/// A device that posed knows and the kernel sees.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Listed {
    id: UsbId,
    name: &'static str,
    nodes: Vec<String>,
    /// Why the nodes cannot be opened, if they cannot.
    problem: Option<String>,
}

/// Prints the devices.
///
/// # Errors
/// The kernel's list cannot be read.
pub fn run(args: &ListArgs) -> Result<(), CommandError> {
    let devices = devices(Path::new(HIDRAW))?;
    if args.json {
        let all: Vec<_> = devices
            .iter()
            .map(|device| {
                json!({
                    "usb": device.id.to_string(),
                    "device": device.name,
                    "nodes": device.nodes,
                    "problem": device.problem,
                })
            })
            .collect();
        println!(
            "{}",
            serde_json::to_string_pretty(&all).map_err(io::Error::from)?
        );
        return Ok(());
    }
    if devices.is_empty() {
        println!("No device that posed knows is plugged in. It knows:");
        for entry in catalog::CATALOG {
            println!("  {}", entry.name);
        }
    }
    for device in devices {
        println!("{}  {}  {}", device.id, device.name, device.nodes.join(" "));
        if let Some(problem) = device.problem {
            println!("  {problem}");
        }
    }
    Ok(())
}

fn devices(hidraw: &Path) -> Result<Vec<Listed>, CommandError> {
    let mut found: BTreeMap<UsbId, Listed> = BTreeMap::new();
    let entries = match fs::read_dir(hidraw) {
        Ok(entries) => entries,
        // A kernel without hidraw has no such devices.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(CommandError::file(hidraw, error)),
    };
    for entry in entries.flatten() {
        let text = fs::read_to_string(entry.path().join("device/uevent")).unwrap_or_default();
        let Some(id) = hid_id(&text) else { continue };
        let Some(known) = catalog::find(id) else {
            continue;
        };
        let node = Path::new("/dev").join(entry.file_name());
        let listed = found.entry(id).or_insert_with(|| Listed {
            id,
            name: known.name,
            nodes: Vec::new(),
            problem: None,
        });
        if let Err(error) = fs::OpenOptions::new().read(true).write(true).open(&node) {
            listed.problem = Some(explain(&node, &error));
        }
        listed.nodes.push(node.display().to_string());
    }
    let mut devices: Vec<_> = found.into_values().collect();
    for device in &mut devices {
        device.nodes.sort();
    }
    Ok(devices)
}

fn explain(node: &Path, error: &io::Error) -> String {
    let advice = if error.kind() == io::ErrorKind::PermissionDenied {
        "; install the udev rules (`posed udev > /etc/udev/rules.d/70-posed.rules` as root), \
         then plug the device in again"
    } else {
        ""
    };
    format!("{}: {error}{advice}", node.display())
}

/// `HID_ID=0003:000028DE:00002300` of a hidraw node's `uevent`; bus 3 is USB.
fn hid_id(uevent: &str) -> Option<UsbId> {
    let id = uevent
        .lines()
        .find_map(|line| line.strip_prefix("HID_ID="))?;
    let mut parts = id.split(':').map(|part| u32::from_str_radix(part, 16));
    let (bus, vendor, product) = (
        parts.next()?.ok()?,
        parts.next()?.ok()?,
        parts.next()?.ok()?,
    );
    let short = |number: u32| u16::try_from(number).ok();
    (bus == 3).then_some(UsbId::new(short(vendor)?, short(product)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_ids_are_read() {
        let index = "DRIVER=hid-generic\nHID_ID=0003:000028DE:00002300\nHID_NAME=x\n";
        assert_eq!(hid_id(index), Some(UsbId::new(0x28de, 0x2300)));
        assert_eq!(hid_id("HID_ID=0005:000028DE:00002300"), None);
        assert_eq!(hid_id("HID_ID=0003:zz"), None);
    }

    #[test]
    fn a_machine_without_hidraw_lists_nothing() {
        assert_eq!(devices(Path::new("/nonexistent/hidraw")).unwrap(), []);
    }
}
