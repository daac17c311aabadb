//! From device samples to published poses: the tracker loop and those who drive it.

pub mod latency;
pub mod live;
mod naming;
pub mod playback;
pub mod replay;
pub mod source;
pub mod stature;
pub mod tracking;
