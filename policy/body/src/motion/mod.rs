//! Recorded and made-up human motion: clips of poses, and their evaluation in continuous time.
//!
//! * [`procedural`]: a person who stands, walks, turns, squats, reaches and waves.

pub mod procedural;

use crate::skeleton::{BodyPose, Skeleton};

/// A motion as a row of poses at a constant rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Clip {
    /// The clip's name in its set.
    pub name: String,
    /// Who moves.
    pub subject: String,
    /// Which part of its set it belongs to: `train`, `val`, `test`, `cross`, `ood`.
    pub split: String,
    /// Frames a second.
    pub fps: f64,
    /// The mover's bones.
    pub skeleton: Skeleton,
    /// The poses.
    pub frames: Vec<BodyPose>,
}
