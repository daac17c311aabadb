//! SteamVR Tracking ("Lighthouse") devices: headsets, controllers and trackers that see the light
//! planes of base stations.

pub mod base_station;
mod blob;
mod input;
pub mod inspect;
pub mod model;
mod motion;
mod radio;
pub mod reader;
pub mod reproject;
pub mod rotor;
mod solve;
pub mod wire;
