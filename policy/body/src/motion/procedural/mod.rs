//! A made-up person: stands, looks around, walks, turns, waves, squats and reaches. The feet stand
//! where they stand, limbs are bent by inverse kinematics, and every quantity follows curves that
//! are twice continuously differentiable, so that velocities and accelerations are those of a
//! person.
//!
//! * [`track`]: movements from key to key, and slow noise.
//! * [`steps`]: the path over the floor and the steps that it takes.
//! * [`limb`]: two-bone inverse kinematics.
//! * [`person`]: all of it put together into a body pose at a time.
//! * [`script`]: what the person does.

mod limb;
mod person;
mod script;
mod steps;
mod track;

use super::Clip;
use crate::skeleton::Skeleton;
use track::Random;

/// Frames a second.
const FPS: f64 = 60.0;
/// Statures that a person can have, metres; anything else is brought within.
const STATURES: (f32, f32) = (0.8, 2.5);

/// About forty seconds of standing, walking, turning, squatting, reaching and waving by a person
/// of the given stature (metres), within 1.5 m of the world's origin. The same seed gives the
/// same motion.
#[must_use]
pub fn timeline(height: f32, seed: u64) -> Clip {
    let stature = if height.is_finite() { height } else { 1.75 };
    let skeleton = Skeleton::of_height(stature.clamp(STATURES.0, STATURES.1));
    let (person, duration) = script::everything(&skeleton, &mut Random::new(seed));
    let count = (duration * FPS) as usize + 1;
    let frames = (0..count).map(|index| person.pose(index as f64 / FPS));
    Clip {
        name: format!("procedural-{seed}"),
        subject: "procedural".to_owned(),
        split: "train".to_owned(),
        fps: FPS,
        frames: frames.collect(),
        skeleton,
    }
}

#[cfg(test)]
mod tests;
