//! From samples and a time to a body pose: the trackers and what they share.

pub mod eval;
mod fade;
mod geometry;
pub mod ik;
pub mod inference;
pub mod metrics;
mod presence;
pub mod sensors;
pub mod tracker;

pub use ik::Ik;
pub use sensors::{Mount, Mounts};
pub use tracker::{Input, Quality, Tracked, Tracker, TrackerKind, Wearer};
