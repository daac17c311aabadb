//! From samples and a time to a body pose: the trackers and what they share.

mod carry;
pub mod eval;
mod fade;
mod gather;
mod geometry;
#[cfg(test)]
mod golden;
pub mod hmd_nemo;
pub mod ik;
pub mod inference;
pub mod metrics;
pub mod objects;
pub mod physics;
pub mod pip;
mod presence;
pub mod questsim;
pub mod sensors;
mod steps;
pub mod tracker;
pub mod worn;

pub use gather::gather;
pub use hmd_nemo::HmdNemo;
pub use ik::Ik;
pub use objects::{ObjectMove, ObjectPose, Objects};
pub use physics::Physical;
pub use pip::Pip;
pub use questsim::QuestSim;
pub use sensors::{Mount, Mounts};
pub use tracker::{Forces, Input, Quality, Recoveries, Tracked, Tracker, TrackerKind, Wearer};
pub use worn::Stance;
