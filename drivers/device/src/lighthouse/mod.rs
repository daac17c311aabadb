//! SteamVR Tracking ("Lighthouse") devices: headsets, controllers and trackers that see the light
//! planes of base stations.

pub mod base_station;
pub mod reproject;
