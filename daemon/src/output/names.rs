//! What other programs call the joints.

use posed_body::{JOINTS, Joint, skeleton};

/// A set of joint names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Names {
    /// SMPL's, posed's own: `left_hip`.
    #[default]
    Smpl,
    /// Unity's `HumanBodyBones`, which VMC uses too: `LeftUpperLeg`.
    Unity,
    /// VRM 1.0's human bones: `leftUpperLeg`.
    Vrm,
    /// Mixamo's and MotionBuilder's, without a namespace: `LeftUpLeg`.
    Mixamo,
    /// Those of `XR_FB_body_tracking` and `XR_META_body_tracking_full_body`, without prefix and
    /// vendor: `LEFT_UPPER_LEG`.
    OpenXr,
}

impl Names {
    /// Every set.
    pub const ALL: [Self; 5] = [
        Self::Smpl,
        Self::Unity,
        Self::Vrm,
        Self::Mixamo,
        Self::OpenXr,
    ];

    /// The word on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Smpl => "smpl",
            Self::Unity => "unity",
            Self::Vrm => "vrm",
            Self::Mixamo => "mixamo",
            Self::OpenXr => "openxr",
        }
    }

    /// The inverse of [`Names::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|names| names.name() == name)
    }

    /// What a joint is called.
    #[must_use]
    pub fn of(self, joint: Joint) -> &'static str {
        let names = match self {
            Self::Smpl => &skeleton::NAMES,
            Self::Unity => &UNITY,
            Self::Vrm => &VRM,
            Self::Mixamo => &MIXAMO,
            Self::OpenXr => &OPENXR,
        };
        names[joint as usize]
    }
}

const UNITY: [&str; JOINTS] = [
    "Hips",
    "LeftUpperLeg",
    "RightUpperLeg",
    "Spine",
    "LeftLowerLeg",
    "RightLowerLeg",
    "Chest",
    "LeftFoot",
    "RightFoot",
    "UpperChest",
    "LeftToes",
    "RightToes",
    "Neck",
    "LeftShoulder",
    "RightShoulder",
    "Head",
    "LeftUpperArm",
    "RightUpperArm",
    "LeftLowerArm",
    "RightLowerArm",
    "LeftHand",
    "RightHand",
];

const VRM: [&str; JOINTS] = [
    "hips",
    "leftUpperLeg",
    "rightUpperLeg",
    "spine",
    "leftLowerLeg",
    "rightLowerLeg",
    "chest",
    "leftFoot",
    "rightFoot",
    "upperChest",
    "leftToes",
    "rightToes",
    "neck",
    "leftShoulder",
    "rightShoulder",
    "head",
    "leftUpperArm",
    "rightUpperArm",
    "leftLowerArm",
    "rightLowerArm",
    "leftHand",
    "rightHand",
];

const MIXAMO: [&str; JOINTS] = [
    "Hips",
    "LeftUpLeg",
    "RightUpLeg",
    "Spine",
    "LeftLeg",
    "RightLeg",
    "Spine1",
    "LeftFoot",
    "RightFoot",
    "Spine2",
    "LeftToeBase",
    "RightToeBase",
    "Neck",
    "LeftShoulder",
    "RightShoulder",
    "Head",
    "LeftArm",
    "RightArm",
    "LeftForeArm",
    "RightForeArm",
    "LeftHand",
    "RightHand",
];

const OPENXR: [&str; JOINTS] = [
    "HIPS",
    "LEFT_UPPER_LEG",
    "RIGHT_UPPER_LEG",
    "SPINE_LOWER",
    "LEFT_LOWER_LEG",
    "RIGHT_LOWER_LEG",
    "SPINE_UPPER",
    "LEFT_FOOT_ANKLE",
    "RIGHT_FOOT_ANKLE",
    "CHEST",
    "LEFT_FOOT_BALL",
    "RIGHT_FOOT_BALL",
    "NECK",
    "LEFT_SHOULDER",
    "RIGHT_SHOULDER",
    "HEAD",
    "LEFT_ARM_UPPER",
    "RIGHT_ARM_UPPER",
    "LEFT_ARM_LOWER",
    "RIGHT_ARM_LOWER",
    "LEFT_HAND_WRIST",
    "RIGHT_HAND_WRIST",
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_unique_and_keep_their_side() {
        for names in Names::ALL {
            assert_eq!(Names::from_name(names.name()), Some(names));
            let all: BTreeSet<_> = Joint::ALL.map(|joint| names.of(joint)).into();
            assert_eq!(all.len(), JOINTS, "{}", names.name());
            for joint in Joint::ALL {
                let side = |name: &str| {
                    let name = name.to_lowercase();
                    (name.starts_with("left"), name.starts_with("right"))
                };
                assert_eq!(
                    side(names.of(joint)),
                    side(joint.name()),
                    "{}",
                    joint.name()
                );
            }
        }
        assert_eq!(Names::from_name("biped"), None);
    }

    #[test]
    fn vrm_differs_from_unity_by_one_letter() {
        for joint in Joint::ALL {
            let (unity, vrm) = (Names::Unity.of(joint), Names::Vrm.of(joint));
            assert_eq!(unity[..1].to_lowercase() + &unity[1..], vrm);
        }
    }
}
