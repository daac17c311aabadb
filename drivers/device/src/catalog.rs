//! The one table of devices that posed knows.

use crate::{decode::Decoder, usb::UsbId};

/// What the decoders are told when they are made.
#[derive(Debug, Clone, Default)]
pub struct Settings {}

/// How a device is reached live.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Through the kernel's HID driver, `/dev/hidrawN`.
    Hidraw,
    /// Through libusb, the kernel's driver detached.
    Usb,
}

/// An interface that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interface {
    /// `bInterfaceNumber`.
    pub number: u8,
    /// Its interrupt IN endpoint.
    pub endpoint: u8,
}

/// A device that posed knows.
pub struct Entry {
    /// For people.
    pub name: &'static str,
    /// The ids it goes by.
    pub ids: &'static [UsbId],
    /// How it is reached live.
    pub access: Access,
    /// The interfaces that are read.
    pub interfaces: &'static [Interface],
    /// Makes its decoder.
    pub make: fn(&Settings) -> Box<dyn Decoder>,
}

/// Every device that posed knows.
pub static CATALOG: &[Entry] = &[];

/// The entry of a device.
#[must_use]
pub fn find(id: UsbId) -> Option<&'static Entry> {
    CATALOG.iter().find(|entry| entry.ids.contains(&id))
}

/// The udev rules that let the user at the machine's seat use these devices
/// (`systemd/70-posed.rules`).
#[must_use]
pub fn udev_rules() -> String {
    String::new()
}
