//! PIP's evaluation: what is not predicted is taken out of both motions before they are compared.

use glam::{DVec3, Quat};
use posed_body::{JOINTS, Joint, skeleton::PARENTS};

use super::{Pair, Track, mean, rotation::angle};

/// Joints that PIP sets to the identity in both motions: the root, ankles, toes and wrists.
const IGNORED: [Joint; 7] = [
    Joint::Pelvis,
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::LeftFoot,
    Joint::RightFoot,
    Joint::LeftWrist,
    Joint::RightWrist,
];

/// SMPL's 24 joints: its hands, 22 and 23, do not turn and so are rotated as the wrists are.
pub(super) const SMPL: [usize; 24] = {
    let mut joints = [0; 24];
    let mut joint = 0;
    while joint < JOINTS {
        joints[joint] = joint;
        joint += 1;
    }
    joints[22] = Joint::LeftWrist as usize;
    joints[23] = Joint::RightWrist as usize;
    joints
};

/// Rotations to the pelvis, and positions from it, metres, of a frame without what is ignored.
fn reduced(track: &Track, frame: usize) -> ([Quat; JOINTS], [DVec3; JOINTS]) {
    let mut turns = [Quat::IDENTITY; JOINTS];
    let mut places = [DVec3::ZERO; JOINTS];
    let (world, positions) = (&track.world[frame], &track.positions[frame]);
    for (index, parent) in PARENTS.into_iter().enumerate() {
        let Some(parent) = parent else { continue };
        let ignored = IGNORED.iter().any(|&joint| joint as usize == index);
        let own = if ignored {
            Quat::IDENTITY
        } else {
            track.local[frame][index]
        };
        turns[index] = (turns[parent] * own).normalize();
        let bone = positions[index].as_dvec3() - positions[parent].as_dvec3();
        let bone = world[parent].as_dquat().normalize().inverse() * bone;
        places[index] = places[parent] + turns[parent].as_dquat() * bone;
    }
    (turns, places)
}

/// Mean angle between rotations, degrees.
pub(super) fn angle_error(pair: &Pair<'_>, joints: &[usize]) -> Option<f64> {
    let angles = (0..pair.frames).flat_map(|frame| {
        let (p, t) = (reduced(pair.p, frame).0, reduced(pair.t, frame).0);
        joints.iter().map(move |&joint| angle(p[joint], t[joint]))
    });
    mean(angles).map(f64::to_degrees)
}

/// Mean distance between positions, centimetres.
pub(super) fn joint_error(pair: &Pair<'_>) -> Option<f64> {
    let errors = (0..pair.frames).flat_map(|frame| {
        let (p, t) = (reduced(pair.p, frame).1, reduced(pair.t, frame).1);
        (0..JOINTS).map(move |joint| p[joint].distance(t[joint]))
    });
    mean(errors).map(|metres| 100.0 * metres)
}
