//! SteamVR Tracking ("Lighthouse") devices: headsets, controllers and trackers that see the light
//! planes of base stations.
//!
//! [`reader`] takes packets apart, [`rotor`] turns sweep times into angles, and a track for each
//! device fuses angles and inertial samples into poses: found without a guess by least squares,
//! carried on by an error-state Kalman filter that takes every sweep for itself.

pub mod base_station;
mod blob;
mod decoder;
mod filter;
mod fuzz;
pub mod gen1;
mod input;
pub mod inspect;
pub mod light;
pub mod model;
mod motion;
pub mod ootx;
mod outlook;
pub mod output;
mod planes;
mod pulses;
mod radio;
mod radio_pulses;
pub mod reader;
pub mod reproject;
mod rest;
pub mod room;
pub mod rotor;
mod solve;
mod startup;
mod track;
pub mod wire;

pub use fuzz::fuzz_entry;

use self::{base_station::BaseStation, model::ImuRange};
use crate::decode::Decoder;

/// Full scales that an IMU is set to until the device says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuClass {
    /// 4 g and 500 degrees a second.
    Headset,
    /// 8 g and 2000 degrees a second.
    Controller,
}

/// How a Lighthouse device is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// By its own cable.
    Wired(ImuClass),
    /// By radio, through a "watchman" dongle.
    Watchman,
    /// The mainboard of a Vive, a USB device beside its sensors' own.
    Mainboard,
}

impl Variant {
    /// Full scales that such a device's IMU is set to.
    #[must_use]
    pub fn range(self) -> ImuRange {
        match self {
            Self::Wired(ImuClass::Headset) => ImuRange::headset(),
            _ => ImuRange::controller(),
        }
    }
}

/// What Lighthouse decoders are told when they are made.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// Base stations whose places are given; where there are none, the room finds its own.
    pub base_stations: Vec<BaseStation>,
    /// The room that all devices share.
    pub room: room::Handle,
}

impl Settings {
    /// A copy that shares the room, in which given base stations stand.
    fn shared(&self) -> Self {
        self.room.with(|room| room.give(&self.base_stations));
        self.clone()
    }
}

/// Makes the decoder of a device. Its poses are those of the device's head frame (a headset's is
/// OpenXR's view: x right, y up, -z forward) in the world of the base stations.
#[must_use]
pub fn decoder(variant: Variant, settings: &Settings) -> Box<dyn Decoder> {
    match variant {
        Variant::Mainboard => Box::new(decoder::Mainboard::default()),
        _ => Box::new(decoder::Device::new(variant, settings)),
    }
}

#[cfg(test)]
mod tests;
