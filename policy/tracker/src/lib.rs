//! From samples and a time to a body pose: the trackers and what they share.

pub mod eval;
mod fade;
mod geometry;
pub mod hmd_nemo;
pub mod ik;
pub mod inference;
pub mod metrics;
pub mod physics;
mod presence;
pub mod sensors;
pub mod tracker;

pub use hmd_nemo::HmdNemo;
pub use ik::Ik;
pub use physics::Physical;
pub use sensors::{Mount, Mounts};
pub use tracker::{Input, Quality, Stance, Tracked, Tracker, TrackerKind, Wearer};
