//! Nintendo's Joy-Cons and Pro Controller, worn or held: their inertial sensors, buttons, battery.
//!
//! The protocol is as dekuNukem's "Nintendo Switch Reverse Engineering" and the kernel's
//! `hid-nintendo.c` describe it. Over Bluetooth and over USB the reports are the same.

pub mod calibration;
mod decoder;
mod fuzz;
pub mod inspect;
mod start;
pub mod wire;

pub use fuzz::fuzz_entry;

use crate::decode::Decoder;

/// Makes the decoder of a Joy-Con or a Pro Controller.
#[must_use]
pub fn decoder() -> Box<dyn Decoder> {
    Box::new(decoder::Device::default())
}

#[cfg(test)]
mod tests;
