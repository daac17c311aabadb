//! What the networks see: accelerations and rotations in the pelvis's frame.
//! policy/training/pip/FEATURES.md is the exact layout.

use glam::{Mat3, Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Skeleton};

use super::sensors::{JOINTS_OF, PELVIS, SENSORS, Seen};
use crate::geometry::yaw_of;

/// Numbers: three of acceleration and nine of rotation for each sensor.
pub(super) const FEATURES: usize = 12 * SENSORS;
/// Accelerations are divided by this, m/s², and by the head height.
const ACCELERATION: f32 = 20.0;
/// Joints at the ends of the limbs, whose positions begin the networks' memory.
const LEAVES: [Joint; 5] = [
    Joint::LeftWrist,
    Joint::RightWrist,
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::Head,
];
/// Numbers of the first pose's leaf positions.
pub(super) const LEAF_NUMBERS: usize = 3 * LEAVES.len();

/// Writes the features of one frame; `height` is the head height, metres. A sensor that is not
/// heard has zeros.
pub(super) fn write(seen: &Seen, height: f32, out: &mut [f32]) {
    out.fill(0.0);
    let pelvis = seen.pelvis();
    let own = seen.0[PELVIS].map_or(Vec3::ZERO, |reading| reading.accel);
    let into_pelvis = pelvis.inverse();
    let tilt = Quat::from_rotation_y(-yaw_of(pelvis)) * pelvis;
    let (accels, turns) = out.split_at_mut(3 * SENSORS);
    for (sensor, reading) in seen.0.iter().enumerate() {
        let Some(reading) = reading else { continue };
        let (accel, turn) = if sensor == PELVIS {
            (own, tilt)
        } else {
            (reading.accel - own, into_pelvis * reading.turn)
        };
        let accel = into_pelvis * accel / (ACCELERATION * height);
        accels[3 * sensor..3 * sensor + 3].copy_from_slice(&accel.to_array());
        // Row by row.
        let rows = Mat3::from_quat(turn).transpose().to_cols_array();
        turns[9 * sensor..9 * sensor + 9].copy_from_slice(&rows);
    }
}

/// Leaf positions of a pose in the pelvis's frame, over the head height.
pub(super) fn leaves(pose: &BodyPose, skeleton: &Skeleton, height: f32) -> [f32; LEAF_NUMBERS] {
    let joints = skeleton.forward(pose);
    let into_pelvis = pose.rotations[0].inverse();
    let mut out = [0.0; LEAF_NUMBERS];
    for (numbers, leaf) in out.chunks_exact_mut(3).zip(LEAVES) {
        let place = into_pelvis * (joints.position(leaf) - pose.root) / height;
        numbers.copy_from_slice(&place.to_array());
    }
    out
}

/// The pose of somebody who stands with straight arms and legs, as far as the sensors allow: what
/// is taken for the first pose where none is known.
pub(super) fn stance(seen: &Seen, skeleton: &Skeleton) -> BodyPose {
    let pelvis = seen.pelvis();
    let mut world = [pelvis; JOINTS];
    for (joint, reading) in JOINTS_OF.into_iter().zip(seen.0) {
        let Some(reading) = reading else { continue };
        world[joint as usize] = reading.turn;
        let before = match joint {
            Joint::LeftElbow => Some(Joint::LeftShoulder),
            Joint::RightElbow => Some(Joint::RightShoulder),
            _ => None,
        };
        if let Some(before) = before {
            world[before as usize] = reading.turn;
        }
    }
    let mut pose = BodyPose::rest(Vec3::ZERO);
    localise(&mut pose, &world);
    let joints = skeleton.forward(&pose);
    let toes = [Joint::LeftFoot, Joint::RightFoot].map(|toe| joints.position(toe).y);
    pose.root.y = -toes[0].min(toes[1]);
    pose
}

/// Joints whose rotation is neither measured nor predicted: they go on as their parents do.
pub(super) const STRAIGHT: [Joint; 6] = [
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::LeftFoot,
    Joint::RightFoot,
    Joint::LeftWrist,
    Joint::RightWrist,
];

/// Turns rotations to the world into local ones; hands and feet stay straight.
pub(super) fn localise(pose: &mut BodyPose, world: &[Quat; JOINTS]) {
    pose.rotations = [Quat::IDENTITY; JOINTS];
    pose.rotations[0] = world[0].normalize();
    for joint in Joint::ALL {
        if let Some(parent) = joint.parent()
            && !STRAIGHT.contains(&joint)
        {
            let local = world[parent as usize].inverse() * world[joint as usize];
            pose.rotations[joint as usize] = local.normalize();
        }
    }
}
