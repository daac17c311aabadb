//! SlimeVR trackers: the HID receiver (1209:7690), which hands on what up to [`UNITS_MAX`] trackers
//! send by radio, and a tracker on its own cable (1209:7692), which speaks the same.
//!
//! [`wire`] takes reports apart and puts them together, the decoder makes samples of them. The
//! protocol is that of SlimeVR-Server's `HIDCommon.kt` and of the firmware's `connection.c` and
//! `hid.c`.
//!
//! [`UNITS_MAX`]: crate::decode::UNITS_MAX

mod decoder;
mod fuzz;
pub mod inspect;
mod turning;
pub mod wire;

pub use fuzz::fuzz_entry;

use crate::decode::Decoder;

/// Makes the decoder of a receiver or of a tracker on its cable.
#[must_use]
pub fn decoder() -> Box<dyn Decoder> {
    Box::new(decoder::Receiver::default())
}

#[cfg(test)]
mod tests;
