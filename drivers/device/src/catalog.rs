//! The one table of devices that posed knows.

use std::fmt::Write as _;

use crate::{
    decode::Decoder,
    joycon,
    lighthouse::{self, ImuClass, Variant},
    slimevr,
    usb::{Packet, Transfer, UsbId},
};

/// What the decoders are told when they are made.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// For SteamVR Tracking devices.
    pub lighthouse: lighthouse::Settings,
}

/// How a device is reached live.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Through the kernel's HID driver, `/dev/hidrawN`.
    Hidraw,
    /// Through libusb, the kernel's driver detached.
    Usb,
}

/// Devices that speak the same language.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// SteamVR Tracking.
    Lighthouse,
    /// SlimeVR receivers and trackers.
    SlimeVr,
    /// Joy-Cons and the Pro Controller.
    JoyCon,
}

/// A report that no other device sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Interrupt IN endpoint.
    pub endpoint: u8,
    /// Report id.
    pub report: u8,
    /// Length, report id included.
    pub bytes: usize,
}

/// A device that posed knows.
#[derive(Debug)]
pub struct Entry {
    /// For people.
    pub name: &'static str,
    /// The ids it goes by.
    pub ids: &'static [UsbId],
    /// Which language it speaks.
    pub family: Family,
    /// How it is reached live.
    pub access: Access,
    /// The interrupt IN endpoints that are read.
    pub endpoints: &'static [u8],
    /// What it is told by in captures that do not say which devices they hold.
    pub shapes: &'static [Shape],
    /// Makes its decoder.
    pub make: fn(&Settings) -> Box<dyn Decoder>,
}

/// Valve's vendor id.
const VALVE: u16 = 0x28de;
/// HTC's vendor id.
const HTC: u16 = 0x0bb4;

/// The vendor id that pid.codes gives to open-source projects.
const OPEN_SOURCE: u16 = 0x1209;

/// Nintendo's vendor id.
const NINTENDO: u16 = 0x057e;

const fn shape(endpoint: u8, report: u8, bytes: usize) -> Shape {
    Shape {
        endpoint,
        report,
        bytes,
    }
}

/// Every device that posed knows.
pub static CATALOG: &[Entry] = &[
    Entry {
        name: "HTC Vive headset",
        ids: &[UsbId::new(VALVE, 0x2000)],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81, 0x82],
        shapes: &[shape(0x82, 0x25, 64)],
        make: wired_headset,
    },
    Entry {
        name: "Valve Index headset, or Index controller or Vive tracker (2018) on a cable",
        ids: &[VALVE_WIRED],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81, 0x83, 0x84],
        shapes: &[
            shape(0x83, 0x25, 64),
            shape(0x83, 0x27, 59),
            shape(0x83, 0x28, 64),
        ],
        make: wired_headset,
    },
    Entry {
        name: "Vive controller on a cable",
        ids: &[UsbId::new(VALVE, 0x2012)],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81, 0x82, 0x83],
        shapes: &[shape(0x82, 0x21, 58)],
        make: wired_controller,
    },
    Entry {
        name: "Vive tracker on a cable",
        ids: &[UsbId::new(VALVE, 0x2022)],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81, 0x82, 0x83],
        shapes: &[],
        make: wired_controller,
    },
    Entry {
        name: "Watchman radio (Vive and Index controllers, trackers)",
        ids: &[UsbId::new(VALVE, 0x2101), UsbId::new(VALVE, 0x2102)],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81],
        shapes: &[shape(0x81, 0x23, 30), shape(0x81, 0x24, 59)],
        make: |settings| lighthouse::decoder(Variant::Watchman, &settings.lighthouse),
    },
    Entry {
        name: "HTC Vive or Vive Pro mainboard",
        ids: &[UsbId::new(HTC, 0x2c87), UsbId::new(HTC, 0x030e)],
        family: Family::Lighthouse,
        access: Access::Hidraw,
        endpoints: &[0x81],
        shapes: &[shape(0x81, 0x03, 64)],
        make: |settings| lighthouse::decoder(Variant::Mainboard, &settings.lighthouse),
    },
    Entry {
        name: "SlimeVR receiver, or SlimeVR tracker on a cable",
        ids: &[
            UsbId::new(OPEN_SOURCE, 0x7690),
            UsbId::new(OPEN_SOURCE, 0x7692),
        ],
        family: Family::SlimeVr,
        access: Access::Hidraw,
        endpoints: &[0x81],
        shapes: &[],
        make: |_| slimevr::decoder(),
    },
    Entry {
        name: "Joy-Con or Pro Controller",
        ids: &[
            UsbId::new(NINTENDO, 0x2006),
            UsbId::new(NINTENDO, 0x2007),
            UsbId::new(NINTENDO, 0x2009),
        ],
        family: Family::JoyCon,
        access: Access::Hidraw,
        endpoints: &[0x81],
        shapes: &[
            shape(0x81, 0x21, 49),
            shape(0x81, 0x30, 49),
            shape(0x81, 0x3f, 12),
        ],
        make: |_| joycon::decoder(),
    },
];

/// Answers for every wired device of SteamVR Tracking while nothing but inertial reports came.
const VALVE_WIRED: UsbId = UsbId::new(VALVE, 0x2300);
/// The inertial report that all of them send.
const INERTIAL: Shape = shape(0x81, 0x20, 52);
/// So many inertial reports without a report that tells more, and the device counts as
/// [`VALVE_WIRED`].
const INERTIAL_REPORTS: u32 = 100;

fn wired_headset(settings: &Settings) -> Box<dyn Decoder> {
    lighthouse::decoder(Variant::Wired(ImuClass::Headset), &settings.lighthouse)
}

fn wired_controller(settings: &Settings) -> Box<dyn Decoder> {
    lighthouse::decoder(Variant::Wired(ImuClass::Controller), &settings.lighthouse)
}

/// The entry of a device.
#[must_use]
pub fn find(id: UsbId) -> Option<&'static Entry> {
    CATALOG.iter().find(|entry| entry.ids.contains(&id))
}

/// The entry that a device of unknown ids belongs to, told by a report. `inertial_reports` counts
/// those that several devices have in common; it begins at 0 for each device.
#[must_use]
pub fn recognise(packet: &Packet, inertial_reports: &mut u32) -> Option<&'static Entry> {
    if packet.transfer != Transfer::Interrupt || !packet.is_input() {
        return None;
    }
    let report = *packet.data.first()?;
    let seen = shape(packet.endpoint, report, packet.data.len());
    *inertial_reports += u32::from(seen == INERTIAL);
    if *inertial_reports == INERTIAL_REPORTS {
        return find(VALVE_WIRED);
    }
    CATALOG.iter().find(|entry| entry.shapes.contains(&seen))
}

/// The udev rules that let the user at the machine's seat use these devices
/// (`systemd/70-posed.rules`): the hidraw nodes, and the USB device itself for libusb.
#[must_use]
pub fn udev_rules() -> String {
    let mut rules = String::from(
        "# Devices that posed reads, for the user at the machine's seat (uaccess).\n\
         # Made from the device catalogue, drivers/device/src/catalog.rs; never edited by hand.\n",
    );
    for entry in CATALOG {
        let _ = write!(rules, "\n# {}\n", entry.name);
        for UsbId { vendor, product } in entry.ids {
            let ids = format!("{vendor:04x}\", ATTRS{{idProduct}}==\"{product:04x}");
            let _ = writeln!(
                rules,
                "KERNEL==\"hidraw*\", SUBSYSTEM==\"hidraw\", ATTRS{{idVendor}}==\"{ids}\", \
                 MODE=\"0660\", TAG+=\"uaccess\""
            );
            let ids = format!("{vendor:04x}\", ATTR{{idProduct}}==\"{product:04x}");
            let _ = writeln!(
                rules,
                "SUBSYSTEM==\"usb\", ENV{{DEVTYPE}}==\"usb_device\", ATTR{{idVendor}}==\"{ids}\", \
                 MODE=\"0660\", TAG+=\"uaccess\""
            );
        }
    }
    rules
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs, path::Path};

    use super::*;

    #[test]
    fn no_two_entries_claim_the_same() {
        let ids: Vec<_> = CATALOG.iter().flat_map(|entry| entry.ids).collect();
        assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len());
        let shapes: Vec<_> = CATALOG.iter().flat_map(|entry| entry.shapes).collect();
        for (index, shape) in shapes.iter().enumerate() {
            assert!(
                !shapes[..index].contains(shape),
                "{shape:?} is claimed twice"
            );
        }
    }

    #[test]
    fn the_udev_rules_are_those_of_the_catalogue() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../systemd/70-posed.rules");
        let file = fs::read_to_string(&path).unwrap_or_default();
        assert!(
            file == udev_rules(),
            "{} is stale; it has to be:\n{}",
            path.display(),
            udev_rules()
        );
    }
}
