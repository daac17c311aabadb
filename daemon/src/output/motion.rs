//! A motion on its way to a file.

use posed_body::{JOINTS, Joints, Skeleton, skeleton::PARENTS};

/// The bone offsets that `joints` were made with.
#[must_use]
pub fn skeleton_of(joints: &Joints) -> Skeleton {
    let mut offsets = [glam::Vec3::ZERO; JOINTS];
    for (index, parent) in PARENTS.into_iter().enumerate() {
        if let Some(parent) = parent {
            let between = joints.positions[index] - joints.positions[parent];
            offsets[index] = joints.rotations[parent].inverse() * between;
        }
    }
    Skeleton { offsets }
}
