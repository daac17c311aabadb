//! Forward kinematics of the character.

use glam::{DQuat, DVec3};

use super::{Character, HINGES, LINKS, Link, hinges_of};
use crate::skeleton::{BodyPose, JOINTS, Joint, Joints};

/// Where the character's free coordinates are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CharacterPose {
    /// Position of the pelvis joint in the world, metres.
    pub root: DVec3,
    /// Rotation of the pelvis, pelvis to world.
    pub rotation: DQuat,
    /// Hinge angles, radians, in the order of [`super::HINGE_TABLE`].
    pub angles: [f64; HINGES],
}

impl CharacterPose {
    /// The rest pose (a T-pose that faces -Z) with the pelvis at `root`.
    #[must_use]
    pub fn rest(root: DVec3) -> Self {
        Self {
            root,
            rotation: DQuat::IDENTITY,
            angles: [0.0; HINGES],
        }
    }
}

/// The links and hinge axes of a pose in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkFrames {
    /// Position of the joint that each link turns about, metres.
    pub positions: [DVec3; LINKS],
    /// Rotation of each link, link to world.
    pub rotations: [DQuat; LINKS],
    /// Axis of each hinge, unit.
    pub axes: [DVec3; HINGES],
}

impl Character {
    /// Places every link.
    #[must_use]
    pub fn forward(&self, pose: &CharacterPose) -> LinkFrames {
        let mut frames = LinkFrames {
            positions: [pose.root; LINKS],
            rotations: [pose.rotation; LINKS],
            axes: [DVec3::ZERO; HINGES],
        };
        for link in Link::ALL {
            let Some(parent) = link.parent() else {
                continue;
            };
            let mut turn = frames.rotations[parent as usize];
            frames.positions[link as usize] =
                frames.positions[parent as usize] + turn * self.links[link as usize].offset;
            for index in hinges_of(link) {
                let axis = self.hinges[index].axis;
                frames.axes[index] = turn * axis;
                turn *= DQuat::from_axis_angle(axis, pose.angles[index]);
            }
            frames.rotations[link as usize] = turn;
        }
        frames
    }

    /// The skeleton's joints, as the links carry them.
    #[must_use]
    pub fn joints(&self, frames: &LinkFrames) -> Joints {
        let place = |joint: Joint| {
            let (link, offset) = self.joints[joint as usize];
            frames.positions[link as usize] + frames.rotations[link as usize] * offset
        };
        let turn = |joint: Joint| frames.rotations[self.joints[joint as usize].0 as usize];
        Joints {
            positions: Joint::ALL.map(|joint| place(joint).as_vec3()),
            rotations: Joint::ALL.map(|joint| turn(joint).as_quat()),
        }
    }

    /// The pose of the skeleton that has every joint where the links carry it.
    #[must_use]
    pub fn body_pose(&self, pose: &CharacterPose) -> BodyPose {
        let frames = self.forward(pose);
        let mut body = BodyPose::rest(pose.root.as_vec3());
        for index in 0..JOINTS {
            let joint = Joint::ALL[index];
            let turn = frames.rotations[self.joints[index].0 as usize];
            let parent = joint.parent().map_or(DQuat::IDENTITY, |parent| {
                frames.rotations[self.joints[parent as usize].0 as usize]
            });
            body.rotations[index] = (parent.inverse() * turn).normalize().as_quat();
        }
        body
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent(seed: f64) -> CharacterPose {
        let mut pose = CharacterPose::rest(DVec3::new(0.3, 1.0, -2.0));
        pose.rotation = DQuat::from_rotation_y(seed);
        for (index, angle) in pose.angles.iter_mut().enumerate() {
            *angle = 0.6 * (seed + index as f64 * 1.7).sin();
        }
        pose
    }

    #[test]
    fn links_and_skeleton_agree() {
        let character = Character::of_height(1.8).expect("a stature in range");
        for seed in 0..20 {
            let pose = bent(f64::from(seed));
            let by_links = character.joints(&character.forward(&pose));
            let by_bones = character.skeleton.forward(&character.body_pose(&pose));
            for joint in Joint::ALL {
                let apart = by_links.position(joint) - by_bones.position(joint);
                assert!(apart.length() < 1e-5, "{}: {apart}", joint.name());
                let turn = by_links.rotation(joint).dot(by_bones.rotation(joint)).abs();
                assert!(turn > 1.0 - 1e-5, "{}", joint.name());
            }
        }
    }

    #[test]
    fn positive_angles_are_anatomical() {
        let character = Character::of_height(1.75).expect("a stature in range");
        let moved = |name: &str, joint: Joint| {
            let index = character.hinges.iter().position(|hinge| hinge.name == name);
            let mut pose = CharacterPose::rest(DVec3::ZERO);
            let place = |pose| character.joints(&character.forward(&pose)).position(joint);
            let before = place(pose);
            pose.angles[index.expect("a hinge of that name")] = 0.4;
            place(pose) - before
        };
        assert!(
            moved("left_hip_flexion", Joint::LeftKnee).z < -0.1,
            "forwards is -Z"
        );
        assert!(
            moved("left_hip_abduction", Joint::LeftKnee).x < -0.1,
            "outwards is -X"
        );
        assert!(moved("right_hip_abduction", Joint::RightKnee).x > 0.1);
        assert!(
            moved("left_hip_rotation", Joint::LeftFoot).x > 0.02,
            "toes turn inwards"
        );
        assert!(
            moved("right_knee_flexion", Joint::RightAnkle).z > 0.1,
            "the shank goes back"
        );
        assert!(
            moved("left_ankle_flexion", Joint::LeftFoot).y > 0.02,
            "toes rise"
        );
        assert!(moved("spine_flexion", Joint::Head).z < -0.1);
        assert!(moved("spine_bend", Joint::Head).x < -0.1);
        assert!(moved("left_elbow_flexion", Joint::LeftWrist).z < -0.05);
        assert!(moved("right_elbow_flexion", Joint::RightWrist).z < -0.05);
        assert!(
            moved("left_shoulder_raise", Joint::LeftElbow).z < -0.05,
            "swings forwards"
        );
        assert!(moved("right_shoulder_raise", Joint::RightElbow).z < -0.05);
    }
}
