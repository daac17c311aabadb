//! Motion of somebody who calibrates: a straight stance, a T-pose and a crouch, each held, and
//! then whatever the wearer does.

use std::f32::consts::FRAC_PI_2;

use glam::{Quat, Vec3};
use posed_body::{BodyPose, Joint, Skeleton, motion::Clip};
use posed_tracker::worn::Stance;

/// Each posture is held for so long, and the way to the next takes so long, seconds.
const HOLD_S: f64 = 3.0;
const WAY_S: f64 = 1.0;
/// Toe joints of somebody who stands are this high, metres.
const TOE: f32 = 0.025;
/// How far trunk and shanks lean in the crouch, and thighs the other way, radians.
const LEAN: f32 = 0.4;
const THIGH: f32 = 0.7;

/// When each posture is held for certain: the middle of its time, seconds from the start.
#[must_use]
pub fn middle(posture: Stance) -> f64 {
    f64::from(posture as u8) * (HOLD_S + WAY_S) + HOLD_S / 2.0
}

/// Seconds until the motion of the clip begins.
pub const LEAD_IN_S: f64 = 3.0 * (HOLD_S + WAY_S);

/// The clip with the three postures before it, where and as the wearer then stands and faces.
#[must_use]
pub fn before(clip: &Clip) -> Clip {
    let Some(&first) = clip.frames.first() else {
        return clip.clone();
    };
    let pelvis = first.rotations[Joint::Pelvis as usize];
    let facing = Quat::from_rotation_y(2.0 * pelvis.y.atan2(pelvis.w));
    let postures = Stance::ALL.map(|posture| pose(posture, &clip.skeleton, facing, first.root));
    let [hold, way] = [HOLD_S, WAY_S].map(|seconds| (seconds * clip.fps).round() as usize);
    let mut frames = Vec::with_capacity(3 * (hold + way) + clip.frames.len());
    for (index, posture) in postures.iter().enumerate() {
        let next = postures.get(index + 1).unwrap_or(&first);
        frames.extend(std::iter::repeat_n(*posture, hold));
        frames.extend((0..way).map(|step| between(posture, next, step as f32 / way as f32)));
    }
    frames.extend_from_slice(&clip.frames);
    Clip {
        frames,
        ..clip.clone()
    }
}

/// Somebody in a posture, above the place of `root`, with the toes on the floor.
fn pose(posture: Stance, skeleton: &Skeleton, facing: Quat, root: Vec3) -> BodyPose {
    let mut pose = BodyPose::rest(Vec3::ZERO);
    let mut turn = |joint: Joint, rotation: Quat| pose.rotations[joint as usize] = rotation;
    turn(Joint::Pelvis, facing);
    if posture != Stance::TPose {
        turn(Joint::LeftShoulder, Quat::from_rotation_z(FRAC_PI_2));
        turn(Joint::RightShoulder, Quat::from_rotation_z(-FRAC_PI_2));
    }
    if posture == Stance::Crouch {
        turn(Joint::Pelvis, facing * Quat::from_rotation_x(-LEAN));
        turn(Joint::Neck, Quat::from_rotation_x(LEAN));
        for (hip, knee, ankle) in [
            (Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle),
            (Joint::RightHip, Joint::RightKnee, Joint::RightAnkle),
        ] {
            turn(hip, Quat::from_rotation_x(THIGH + LEAN));
            turn(knee, Quat::from_rotation_x(-THIGH - LEAN));
            turn(ankle, Quat::from_rotation_x(LEAN));
        }
    }
    let joints = skeleton.forward(&pose);
    let toes = joints
        .position(Joint::LeftFoot)
        .y
        .min(joints.position(Joint::RightFoot).y);
    pose.root = Vec3::new(root.x, TOE - toes, root.z);
    pose
}

/// Between two poses, at rest at both ends.
fn between(from: &BodyPose, to: &BodyPose, fraction: f32) -> BodyPose {
    let s = fraction * fraction * fraction * (10.0 + fraction * (6.0 * fraction - 15.0));
    let mut pose = *from;
    pose.root = from.root.lerp(to.root, s);
    for (rotation, to) in pose.rotations.iter_mut().zip(&to.rotations) {
        *rotation = rotation.slerp(*to, s);
    }
    pose
}

#[cfg(test)]
mod tests {
    use posed_signal::Role;

    use super::*;

    #[test]
    fn postures_are_those_that_calibration_expects() {
        let clip = crate::simulated::built_in(1.75, 1);
        let led = before(&clip);
        assert_eq!(
            led.frames.len(),
            clip.frames.len() + (LEAD_IN_S * clip.fps) as usize
        );
        let facing = led.frames[0].rotations[0];
        for posture in [Stance::Straight, Stance::TPose] {
            let frame = (middle(posture) * clip.fps) as usize;
            let joints = led.skeleton.forward(&led.frames[frame]);
            for (role, joint) in [
                (Role::LeftWrist, Joint::LeftElbow),
                (Role::RightWrist, Joint::RightElbow),
                (Role::LeftKnee, Joint::LeftKnee),
                (Role::Waist, Joint::Pelvis),
            ] {
                let expected = facing * posture.bone(role).unwrap();
                let error = joints.rotation(joint).angle_between(expected);
                assert!(error < 1e-3, "{posture:?} {role}: {error}");
            }
            let wrist = joints.position(Joint::LeftWrist) - joints.position(Joint::LeftShoulder);
            let hangs = wrist.y < -0.4;
            assert_eq!(hangs, posture == Stance::Straight, "{wrist}");
        }
        let crouch = &led.frames[(middle(Stance::Crouch) * clip.fps) as usize];
        let joints = led.skeleton.forward(crouch);
        let knee = facing.inverse()
            * (joints.position(Joint::LeftKnee) - joints.position(Joint::LeftAnkle));
        assert!(knee.z < -0.1, "the knee is before the ankle: {knee}");
        let foot = joints.rotation(Joint::LeftAnkle).angle_between(facing);
        assert!(foot < 1e-3, "the feet stay flat: {foot}");
    }
}
