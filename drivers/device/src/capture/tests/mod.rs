//! Tests of whole captures: hand-made ones, damaged ones, and the shared real ones.

mod build;
mod damaged;
mod formats;
pub(crate) mod shared;

use super::{CaptureReader, Item, Warning, open};
use crate::usb::Packet;

/// Reads a capture to its end: packets, and warnings in their order.
fn read(bytes: &[u8]) -> (Vec<Packet>, Vec<Warning>) {
    split(&mut open(bytes).unwrap())
}

fn split(reader: &mut CaptureReader<'_>) -> (Vec<Packet>, Vec<Warning>) {
    let (mut packets, mut warnings) = (Vec::new(), Vec::new());
    for item in reader {
        match item {
            Item::Packet(packet) => packets.push(packet),
            Item::Warning(warning) => warnings.push(warning),
            Item::Device(..) => {}
        }
    }
    (packets, warnings)
}
