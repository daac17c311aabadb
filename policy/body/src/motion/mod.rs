//! Recorded and made-up human motion: clips of poses, and their evaluation in continuous time.
//!
//! * [`set`]: the motion-capture sets that hold many clips, from their `.npz` files.
//! * [`procedural`]: a person who stands, walks, turns, squats, reaches and waves.
//! * [`silhouette`]: the room that a body takes up, as capsules.
//! * [`trajectory`]: a clip in continuous time, with velocities and accelerations.
//! * [`spline`]: the cubic splines behind it.

pub mod procedural;
pub mod set;
pub mod silhouette;
pub mod spline;
pub mod trajectory;

pub use set::{MotionError, MotionSet};
pub use silhouette::Limb;
pub use trajectory::{JointMotion, Trajectory};

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

impl Clip {
    /// Time of the last frame, seconds.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.frames.len().saturating_sub(1) as f64 / self.fps
    }

    /// The same motion at another rate, by cubic splines; at the same rate, the same frames.
    #[must_use]
    pub fn resampled(&self, fps: f64) -> Self {
        if (fps - self.fps).abs() < 0.01 || self.frames.len() < 2 {
            return self.clone();
        }
        let trajectory = Trajectory::new(self);
        // The slack takes in a last frame that rounding would lose.
        let count = (self.duration() * fps + 1e-6) as usize + 1;
        let frames = (0..count)
            .map(|index| trajectory.pose(index as f64 / fps))
            .collect();
        Self {
            fps,
            frames,
            ..self.clone()
        }
    }
}
