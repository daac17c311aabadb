//! A clip in continuous time: cubic splines through the root's positions and through the local
//! rotations' components, the latter brought back to unit length. Every joint's motion is then
//! twice continuously differentiable.

use std::array::from_fn;

use glam::{DQuat, DVec3, Quat};

use super::Clip;
use super::spline::{Jet, Spline};
use crate::skeleton::{BodyPose, JOINTS, Joint, PARENTS};

/// A joint's motion at a time, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointMotion {
    /// Metres.
    pub position: DVec3,
    /// Joint to world.
    pub rotation: DQuat,
    /// m/s.
    pub velocity: DVec3,
    /// m/s^2.
    pub acceleration: DVec3,
    /// rad/s.
    pub angular_velocity: DVec3,
    /// rad/s^2.
    pub angular_acceleration: DVec3,
}

impl JointMotion {
    /// The motion of a point that the joint carries along, with the rotation of a frame there:
    /// both as seen in the joint's frame.
    #[must_use]
    pub fn carry(&self, position: DVec3, rotation: DQuat) -> Self {
        let arm = self.rotation * position;
        let spin = self.angular_velocity;
        Self {
            position: self.position + arm,
            rotation: self.rotation * rotation,
            velocity: self.velocity + spin.cross(arm),
            acceleration: self.acceleration
                + self.angular_acceleration.cross(arm)
                + spin.cross(spin.cross(arm)),
            ..*self
        }
    }

    /// A joint that hangs on this one, by its bone and its local motion.
    fn child(&self, offset: DVec3, local: &LocalMotion) -> Self {
        let spin = self.rotation * local.angular_velocity;
        let carried = self.carry(offset, local.rotation);
        Self {
            angular_velocity: self.angular_velocity + spin,
            angular_acceleration: self.angular_acceleration
                + self.rotation * local.angular_acceleration
                + self.angular_velocity.cross(spin),
            ..carried
        }
    }
}

/// A joint's rotation against its parent, with derivatives in the parent's frame.
struct LocalMotion {
    rotation: DQuat,
    angular_velocity: DVec3,
    angular_acceleration: DVec3,
}

impl LocalMotion {
    /// From the spline through a rotation's components.
    fn new(jet: &Jet<4>) -> Self {
        let [s, s1, s2] = [jet.value, jet.first, jet.second].map(DQuat::from_array);
        // q = s / |s|; n, n1 and n2 are |s| and its derivatives.
        let n = s.length();
        let n1 = s.dot(s1) / n;
        let n2 = (s1.dot(s1) + s.dot(s2) - n1 * n1) / n;
        let q = s / n;
        let q1 = (s1 - q * n1) / n;
        let q2 = (s2 - q1 * (2.0 * n1) - q * n2) / n;
        let twice = |derivative: DQuat| 2.0 * (derivative * q.conjugate()).xyz();
        Self {
            rotation: q,
            angular_velocity: twice(q1),
            angular_acceleration: twice(q2),
        }
    }
}

/// A clip in continuous time.
#[derive(Debug, Clone)]
pub struct Trajectory {
    root: Spline<3>,
    rotations: [Spline<4>; JOINTS],
    offsets: [DVec3; JOINTS],
}

impl Trajectory {
    /// Through the frames of a clip, the first one at time zero. A clip without frames stays in
    /// the rest pose.
    #[must_use]
    pub fn new(clip: &Clip) -> Self {
        let root: Vec<[f64; 3]> = clip
            .frames
            .iter()
            .map(|frame| frame.root.as_dvec3().to_array())
            .collect();
        Self {
            root: Spline::new(&root, clip.fps),
            rotations: from_fn(|joint| {
                Spline::new(
                    &continuous(clip.frames.iter().map(|f| f.rotations[joint])),
                    clip.fps,
                )
            }),
            offsets: clip.skeleton.offsets.map(|offset| offset.as_dvec3()),
        }
    }

    /// Time of the last frame, seconds.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.root.duration()
    }

    /// The whole body at a time in seconds.
    #[must_use]
    pub fn pose(&self, seconds: f64) -> BodyPose {
        let rotation = |joint: usize| -> Quat {
            DQuat::from_array(self.rotations[joint].at(seconds).value)
                .normalize()
                .as_quat()
        };
        BodyPose {
            root: DVec3::from_array(self.root.at(seconds).value).as_vec3(),
            rotations: from_fn(rotation),
        }
    }

    /// A joint's motion at a time in seconds.
    #[must_use]
    pub fn joint(&self, joint: Joint, seconds: f64) -> JointMotion {
        // From the joint to the pelvis, then back.
        let mut chain = [0; JOINTS];
        let mut length = 0;
        let mut next = Some(joint as usize);
        while let Some(index) = next {
            chain[length] = index;
            length += 1;
            next = PARENTS[index];
        }
        let root = self.root.at(seconds);
        let [position, velocity, acceleration] =
            [root.value, root.first, root.second].map(DVec3::from_array);
        let world = JointMotion {
            position,
            rotation: DQuat::IDENTITY,
            velocity,
            acceleration,
            angular_velocity: DVec3::ZERO,
            angular_acceleration: DVec3::ZERO,
        };
        chain[..length].iter().rev().fold(world, |parent, &index| {
            let offset = if index == 0 {
                DVec3::ZERO
            } else {
                self.offsets[index]
            };
            parent.child(
                offset,
                &LocalMotion::new(&self.rotations[index].at(seconds)),
            )
        })
    }
}

/// Rotations with signs chosen so that neighbours lie on one hemisphere: q and -q are the same.
fn continuous(rotations: impl Iterator<Item = Quat>) -> Vec<[f64; 4]> {
    let mut last = DQuat::IDENTITY;
    let mut out: Vec<[f64; 4]> = rotations
        .map(|rotation| {
            let rotation = rotation.as_dquat();
            last = if rotation.dot(last) < 0.0 {
                -rotation
            } else {
                rotation
            };
            last.to_array()
        })
        .collect();
    if out.is_empty() {
        out.push(DQuat::IDENTITY.to_array());
    }
    out
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::skeleton::Skeleton;

    /// A clip in which every joint turns smoothly about its own axis.
    fn turning(fps: f64, seconds: f64) -> Clip {
        let count = (fps * seconds) as usize + 1;
        let frame = |index: usize| {
            let t = index as f64 / fps;
            let mut pose =
                BodyPose::rest(DVec3::new(0.5 * t.sin(), 1.0, 0.3 * (2.0 * t).cos()).as_vec3());
            for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                let phase = joint as f64;
                let angle = 0.4 * (1.5 * t + phase).sin();
                let axis = DVec3::new(phase.cos(), phase.sin(), 0.5).normalize();
                *rotation = DQuat::from_axis_angle(axis, angle).as_quat();
                if index.is_multiple_of(3) {
                    *rotation = -*rotation;
                }
            }
            pose
        };
        Clip {
            name: "turning".to_owned(),
            subject: "nobody".to_owned(),
            split: "train".to_owned(),
            fps,
            skeleton: Skeleton::of_height(1.7),
            frames: (0..count).map(frame).collect(),
        }
    }

    #[test]
    fn frames_are_met_with_forward_kinematics() {
        let clip = turning(30.0, 2.0);
        let trajectory = Trajectory::new(&clip);
        assert!((trajectory.duration() - 2.0).abs() < 1e-9);
        for (index, frame) in clip.frames.iter().enumerate() {
            let t = index as f64 / clip.fps;
            let joints = clip.skeleton.forward(frame);
            for joint in Joint::ALL {
                let motion = trajectory.joint(joint, t);
                let position = joints.position(joint).as_dvec3();
                assert!((motion.position - position).length() < 1e-5, "{joint:?}");
                let rotation = joints.rotation(joint).as_dquat();
                assert!(
                    motion.rotation.dot(rotation).abs() > 1.0 - 1e-6,
                    "{joint:?}"
                );
            }
            assert!(trajectory.pose(t).is_sound());
        }
    }

    #[test]
    fn a_clip_without_frames_rests() {
        let mut clip = turning(30.0, 0.0);
        clip.frames.clear();
        let trajectory = Trajectory::new(&clip);
        assert_eq!(trajectory.duration(), 0.0);
        assert_eq!(trajectory.pose(1.0), BodyPose::rest(Vec3::ZERO));
        assert!(trajectory.joint(Joint::Head, 1.0).position.is_finite());
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_the_pose(t in 0.1f64..1.9, joint in 0usize..JOINTS) {
            let trajectory = Trajectory::new(&turning(60.0, 2.0));
            let place = (DVec3::new(0.1, 0.05, -0.1), DQuat::from_rotation_x(0.5));
            let at = |t| trajectory.joint(Joint::ALL[joint], t).carry(place.0, place.1);
            let h = 1e-5;
            let (before, now, after) = (at(t - h), at(t), at(t + h));
            let velocity = (after.position - before.position) / (2.0 * h);
            prop_assert!((velocity - now.velocity).length() < 1e-5);
            let acceleration = (after.velocity - before.velocity) / (2.0 * h);
            // The third derivative jumps at knots.
            prop_assert!((acceleration - now.acceleration).length() < 0.02);
            let turn = after.rotation * before.rotation.conjugate();
            // Not `to_scaled_axis`, which takes turns of less than 1e-8 rad for none.
            let spin = turn.xyz() / h;
            prop_assert!((spin - now.angular_velocity).length() < 1e-4);
            let spin_up = (after.angular_velocity - before.angular_velocity) / (2.0 * h);
            prop_assert!((spin_up - now.angular_acceleration).length() < 0.05);
        }
    }
}
