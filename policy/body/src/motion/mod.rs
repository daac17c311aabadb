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

use glam::Vec3;

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

    /// The same motion by a mover who is `stature` metres tall: bones and ways grow alike, times
    /// stay.
    #[must_use]
    pub fn of_stature(&self, stature: f32) -> Self {
        let scale = stature / self.skeleton.stature();
        let mut clip = self.clone();
        for offset in &mut clip.skeleton.offsets {
            *offset *= scale;
        }
        for frame in &mut clip.frames {
            frame.root *= scale;
        }
        clip
    }

    /// The same motion, moved over the floor so that the pelvis's way has its middle above the
    /// world's origin: sets place their clips anywhere.
    #[must_use]
    pub fn centred(&self) -> Self {
        let low = self.frames.iter().map(|frame| frame.root).reduce(Vec3::min);
        let high = self.frames.iter().map(|frame| frame.root).reduce(Vec3::max);
        let middle = (low.unwrap_or_default() + high.unwrap_or_default()) / 2.0;
        let shift = Vec3::new(middle.x, 0.0, middle.z);
        let mut clip = self.clone();
        for frame in &mut clip.frames {
            frame.root -= shift;
        }
        clip
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_centred_clip_is_the_same_motion_about_the_origin() {
        let clip = procedural::timeline(1.6, 3);
        let mut away = clip.clone();
        for frame in &mut away.frames {
            frame.root += Vec3::new(4.0, 0.0, -2.5);
        }
        let (near, far) = (clip.centred(), away.centred());
        for (near, far) in near.frames.iter().zip(&far.frames) {
            assert!(near.root.distance(far.root) < 1e-5);
            assert_eq!(near.rotations, far.rotations);
        }
        let lowest = near
            .frames
            .iter()
            .map(|frame| frame.root.x)
            .fold(f32::MAX, f32::min);
        let highest = near
            .frames
            .iter()
            .map(|frame| frame.root.x)
            .fold(f32::MIN, f32::max);
        assert!((lowest + highest).abs() < 1e-5 && highest > 0.3);
    }

    #[test]
    fn a_taller_mover_does_the_same() {
        let clip = procedural::timeline(1.6, 3);
        let tall = clip.of_stature(2.0);
        assert!((tall.skeleton.stature() - 2.0).abs() < 1e-5);
        for (short, long) in clip.frames.iter().zip(&tall.frames) {
            let (short, long) = (clip.skeleton.forward(short), tall.skeleton.forward(long));
            for (short, long) in short.positions.iter().zip(&long.positions) {
                assert!((*short * 1.25).distance(*long) < 1e-4);
            }
        }
    }

    #[test]
    fn resampling_keeps_the_duration_and_the_common_frames() {
        let clip = procedural::timeline(1.75, 1);
        let slow = clip.resampled(30.0);
        assert_eq!(slow.frames.len(), clip.frames.len().div_ceil(2));
        for (index, frame) in slow.frames.iter().enumerate() {
            assert!(frame.root.distance(clip.frames[2 * index].root) < 1e-5);
        }
        assert_eq!(clip.resampled(60.0), clip);
    }
}
