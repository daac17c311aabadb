//! Inertial trackers on a body: how each sits on its bone and where its world points, from
//! postures that the wearer holds; headings that wander, watched and put right.
//!
//! A tracker knows which way is up, but its heading is its own. [`Fitting`] is the state machine
//! that a tracker loop keeps: it is fed the devices' orientations at every tick, and answers with
//! those of the bones.

mod fit;
mod fitting;
mod heading;
pub mod naming;

pub use fit::{Fit, Stance, Stances, conventional};
pub use fitting::{Fitting, Phase, Report};
pub use heading::HeadingWatch;

#[cfg(test)]
mod tests;
