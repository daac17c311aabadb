//! The skeleton: 22 joints, SMPL topology and order, and poses of it.
//!
//! In the rest pose every rotation is the identity: a T-pose that faces -Z with the wearer's left
//! at -X, the pelvis at the origin.

use glam::{Quat, Vec3};

/// Number of joints.
pub const JOINTS: usize = 22;

/// The joints, in SMPL order; `joint as usize` indexes every per-joint array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names are SMPL's and say everything")]
pub enum Joint {
    Pelvis,
    LeftHip,
    RightHip,
    Spine1,
    LeftKnee,
    RightKnee,
    Spine2,
    LeftAnkle,
    RightAnkle,
    Spine3,
    LeftFoot,
    RightFoot,
    Neck,
    LeftCollar,
    RightCollar,
    Head,
    LeftShoulder,
    RightShoulder,
    LeftElbow,
    RightElbow,
    LeftWrist,
    RightWrist,
}

impl Joint {
    /// Every joint, in order; a joint's parent always comes before it.
    pub const ALL: [Self; JOINTS] = [
        Self::Pelvis,
        Self::LeftHip,
        Self::RightHip,
        Self::Spine1,
        Self::LeftKnee,
        Self::RightKnee,
        Self::Spine2,
        Self::LeftAnkle,
        Self::RightAnkle,
        Self::Spine3,
        Self::LeftFoot,
        Self::RightFoot,
        Self::Neck,
        Self::LeftCollar,
        Self::RightCollar,
        Self::Head,
        Self::LeftShoulder,
        Self::RightShoulder,
        Self::LeftElbow,
        Self::RightElbow,
        Self::LeftWrist,
        Self::RightWrist,
    ];

    /// SMPL's name, for example `left_hip`.
    #[must_use]
    pub fn name(self) -> &'static str {
        NAMES[self as usize]
    }

    /// The joint that this one hangs on; `None` for the pelvis.
    #[must_use]
    pub fn parent(self) -> Option<Self> {
        PARENTS[self as usize].map(|index| Self::ALL[index])
    }
}

/// SMPL's joint names, in order.
pub const NAMES: [&str; JOINTS] = [
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
];

/// Index of each joint's parent.
pub const PARENTS: [Option<usize>; JOINTS] = [
    None,
    Some(0),
    Some(0),
    Some(0),
    Some(1),
    Some(2),
    Some(3),
    Some(4),
    Some(5),
    Some(6),
    Some(7),
    Some(8),
    Some(9),
    Some(9),
    Some(9),
    Some(12),
    Some(13),
    Some(14),
    Some(16),
    Some(17),
    Some(18),
    Some(19),
];

/// A body pose: where the pelvis is, and each joint's rotation against its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyPose {
    /// Position of the pelvis in the world, metres.
    pub root: Vec3,
    /// Local rotations, child to parent, unit; that of the pelvis is pelvis to world.
    pub rotations: [Quat; JOINTS],
}

impl BodyPose {
    /// The rest pose with the pelvis at `root`.
    #[must_use]
    pub fn rest(root: Vec3) -> Self {
        Self {
            root,
            rotations: [Quat::IDENTITY; JOINTS],
        }
    }

    /// Whether every number is finite and every rotation unit within 1 %.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let unit = |q: &Quat| (q.length_squared() - 1.0).abs() < 0.02;
        self.root.is_finite() && self.rotations.iter().all(unit)
    }
}

/// A pose's joints in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joints {
    /// Positions, metres.
    pub positions: [Vec3; JOINTS],
    /// Rotations, joint to world.
    pub rotations: [Quat; JOINTS],
}

impl Joints {
    /// A joint's position.
    #[must_use]
    pub fn position(&self, joint: Joint) -> Vec3 {
        self.positions[joint as usize]
    }

    /// A joint's rotation, joint to world.
    #[must_use]
    pub fn rotation(&self, joint: Joint) -> Quat {
        self.rotations[joint as usize]
    }
}

/// Bone offsets of one person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skeleton {
    /// Each joint's position in its parent's frame, metres; the pelvis's is zero.
    pub offsets: [Vec3; JOINTS],
}

/// Offsets over the height of the head joint above the toe joints: left side and middle, mean of
/// the two sides of 16 people (CMU motion capture, subjects with their own skeletons).
const PROPORTIONS: [(Joint, [f32; 3]); 13] = [
    (Joint::LeftHip, [-0.0639, -0.0695, -0.0290]),
    (Joint::Spine1, [0.0, 0.0, 0.0]),
    (Joint::LeftKnee, [0.0, -0.2831, 0.0]),
    (Joint::Spine2, [0.0, 0.0820, 0.0074]),
    (Joint::LeftAnkle, [0.0, -0.3033, 0.0]),
    (Joint::Spine3, [0.0, 0.0825, 0.0]),
    (Joint::LeftFoot, [0.0, -0.0224, -0.0800]),
    (Joint::Neck, [0.0, 0.0836, -0.0037]),
    (Joint::LeftCollar, [0.0, 0.0836, -0.0037]),
    (Joint::Head, [0.0, 0.0681, -0.0067]),
    (Joint::LeftShoulder, [-0.1281, 0.0467, 0.0091]),
    (Joint::LeftElbow, [-0.2071, 0.0, 0.0]),
    (Joint::LeftWrist, [-0.1323, 0.0, 0.0]),
];

/// What the means above add up to from toe to head: not quite one, each being a mean of its own.
const PROPORTIONS_HEIGHT: f32 = 0.9945;

/// Height of the head joint (skull base) over stature in those people.
const HEAD_JOINT_OVER_STATURE: f32 = 0.823;

impl Skeleton {
    /// A person of average proportions and the given stature (crown of the head, metres).
    #[must_use]
    pub fn of_height(stature: f32) -> Self {
        let scale = stature * HEAD_JOINT_OVER_STATURE / PROPORTIONS_HEIGHT;
        let mut offsets = [Vec3::ZERO; JOINTS];
        for (joint, offset) in PROPORTIONS {
            let offset = Vec3::from_array(offset) * scale;
            offsets[joint as usize] = offset;
            if joint.name().starts_with("left_") {
                // In SMPL's order every right joint follows its left one.
                offsets[joint as usize + 1] = offset * Vec3::new(-1.0, 1.0, 1.0);
            }
        }
        Self { offsets }
    }

    /// Height of the head joint above the lower toe joint in the rest pose, metres.
    #[must_use]
    pub fn head_height(&self) -> f32 {
        let joints = self.forward(&BodyPose::rest(Vec3::ZERO));
        let toe = |joint| joints.position(joint).y;
        joints.position(Joint::Head).y - toe(Joint::LeftFoot).min(toe(Joint::RightFoot))
    }

    /// The stature that the proportions give for this head height, metres.
    #[must_use]
    pub fn stature(&self) -> f32 {
        self.head_height() / HEAD_JOINT_OVER_STATURE
    }

    /// Forward kinematics.
    #[must_use]
    pub fn forward(&self, pose: &BodyPose) -> Joints {
        let mut joints = Joints {
            positions: [pose.root; JOINTS],
            rotations: [pose.rotations[0]; JOINTS],
        };
        for index in 1..JOINTS {
            let Some(parent) = PARENTS[index] else {
                continue;
            };
            let turn = joints.rotations[parent];
            joints.rotations[index] = turn * pose.rotations[index];
            joints.positions[index] = joints.positions[parent] + turn * self.offsets[index];
        }
        joints
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parents_come_first_and_names_fit() {
        for (index, joint) in Joint::ALL.into_iter().enumerate() {
            assert_eq!(joint as usize, index);
            assert!(joint.parent().is_none_or(|parent| parent < joint));
        }
        assert_eq!(Joint::LeftWrist.parent(), Some(Joint::LeftElbow));
        assert_eq!(Joint::RightAnkle.name(), "right_ankle");
    }

    #[test]
    fn the_rest_pose_faces_forward() {
        let skeleton = Skeleton::of_height(1.75);
        let joints = skeleton.forward(&BodyPose::rest(Vec3::ZERO));
        assert!(joints.position(Joint::LeftWrist).x < -0.5, "left is at -X");
        assert!(
            joints.position(Joint::LeftFoot).z < -0.1,
            "toes point to -Z"
        );
        assert!(joints.position(Joint::Head).y > 0.3);
        assert!((skeleton.stature() - 1.75).abs() < 1e-4);
        for (index, joint) in Joint::ALL.into_iter().enumerate() {
            if joint.name().starts_with("right_") {
                let mirrored = joints.positions[index - 1] * Vec3::new(-1.0, 1.0, 1.0);
                assert!(
                    (mirrored - joints.positions[index]).length() < 1e-6,
                    "{}",
                    joint.name()
                );
            }
        }
    }

    #[test]
    fn a_turned_joint_carries_its_children() {
        let skeleton = Skeleton::of_height(1.75);
        let mut pose = BodyPose::rest(Vec3::Y);
        pose.rotations[Joint::LeftElbow as usize] =
            Quat::from_rotation_y(-std::f32::consts::FRAC_PI_2);
        let joints = skeleton.forward(&pose);
        let forearm = joints.position(Joint::LeftWrist) - joints.position(Joint::LeftElbow);
        // Bending the left elbow about -Y brings the hand forward.
        assert!(forearm.z < -0.15 && forearm.x.abs() < 1e-5, "{forearm}");
    }
}
