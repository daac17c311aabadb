//! Which device sat on which port: from descriptors in a capture, or a list beside it.

use crate::usb::{Packet, Port, UsbId};

/// The ids in a device descriptor, if `packet` is the answer to a request for one.
#[must_use]
pub fn device_descriptor(packet: &Packet) -> Option<UsbId> {
    let _ = packet;
    None
}

/// Reads a `.usbdevs` list: one `vendor product bus address NAME` a line, numbers decimal.
/// Lines that are something else are skipped.
#[must_use]
pub fn parse_usbdevs(text: &str) -> Vec<(Port, UsbId)> {
    let _ = text;
    Vec::new()
}
