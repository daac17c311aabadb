//! From samples and a time to a body pose: the trackers and what they share.

pub mod tracker;

pub use tracker::{Input, Quality, Tracked, Tracker, TrackerKind, Wearer};
