//! The sixteen links and the thirty-three hinges between them.

use glam::DVec3;

use super::{HINGES, LINKS};
use crate::skeleton::Joint;

/// The links, each one segment of de Leva's table; a link's parent always comes before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names say everything")]
pub enum Link {
    Pelvis,
    Spine,
    Chest,
    Head,
    LeftUpperArm,
    LeftForearm,
    LeftHand,
    RightUpperArm,
    RightForearm,
    RightHand,
    LeftThigh,
    LeftShank,
    LeftFoot,
    RightThigh,
    RightShank,
    RightFoot,
}

impl Link {
    /// Every link, in order.
    pub const ALL: [Self; LINKS] = [
        Self::Pelvis,
        Self::Spine,
        Self::Chest,
        Self::Head,
        Self::LeftUpperArm,
        Self::LeftForearm,
        Self::LeftHand,
        Self::RightUpperArm,
        Self::RightForearm,
        Self::RightHand,
        Self::LeftThigh,
        Self::LeftShank,
        Self::LeftFoot,
        Self::RightThigh,
        Self::RightShank,
        Self::RightFoot,
    ];

    /// The name of the link's body in MJCF.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pelvis => "pelvis",
            Self::Spine => "spine",
            Self::Chest => "chest",
            Self::Head => "head",
            Self::LeftUpperArm => "left_upper_arm",
            Self::LeftForearm => "left_forearm",
            Self::LeftHand => "left_hand",
            Self::RightUpperArm => "right_upper_arm",
            Self::RightForearm => "right_forearm",
            Self::RightHand => "right_hand",
            Self::LeftThigh => "left_thigh",
            Self::LeftShank => "left_shank",
            Self::LeftFoot => "left_foot",
            Self::RightThigh => "right_thigh",
            Self::RightShank => "right_shank",
            Self::RightFoot => "right_foot",
        }
    }

    /// The link that this one hangs on; `None` for the pelvis.
    #[must_use]
    pub fn parent(self) -> Option<Self> {
        match self {
            Self::Pelvis => None,
            Self::Spine | Self::LeftThigh | Self::RightThigh => Some(Self::Pelvis),
            Self::Chest => Some(Self::Spine),
            Self::Head | Self::LeftUpperArm | Self::RightUpperArm => Some(Self::Chest),
            _ => Some(Self::ALL[self as usize - 1]),
        }
    }

    /// The joint of the skeleton that the link turns about, whose frame it carries.
    #[must_use]
    pub fn anchor(self) -> Joint {
        match self {
            Self::Pelvis => Joint::Pelvis,
            Self::Spine => Joint::Spine1,
            Self::Chest => Joint::Spine3,
            Self::Head => Joint::Neck,
            Self::LeftUpperArm => Joint::LeftShoulder,
            Self::LeftForearm => Joint::LeftElbow,
            Self::LeftHand => Joint::LeftWrist,
            Self::RightUpperArm => Joint::RightShoulder,
            Self::RightForearm => Joint::RightElbow,
            Self::RightHand => Joint::RightWrist,
            Self::LeftThigh => Joint::LeftHip,
            Self::LeftShank => Joint::LeftKnee,
            Self::LeftFoot => Joint::LeftAnkle,
            Self::RightThigh => Joint::RightHip,
            Self::RightShank => Joint::RightKnee,
            Self::RightFoot => Joint::RightAnkle,
        }
    }

    /// The same link of the other side; a link of the middle is its own mirror.
    #[must_use]
    pub fn mirrored(self) -> Self {
        match self as usize {
            4..7 | 10..13 => Self::ALL[self as usize + 3],
            7..10 | 13..16 => Self::ALL[self as usize - 3],
            _ => self,
        }
    }
}

/// A hinge of an average person, 1.75 m tall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hinge {
    /// Name in MJCF.
    pub name: &'static str,
    /// The link that it turns against its parent. A link's hinges turn one after the other, each
    /// in the frame that the ones before it have made.
    pub link: Link,
    /// Axis in the link's frame in the rest pose, unit.
    pub axis: DVec3,
    /// Least and greatest angle, radians.
    pub range: [f64; 2],
    /// Greatest torque, N m.
    pub torque: f64,
    /// Damping, N m s / rad.
    pub damping: f64,
}

const FRAC_1_SQRT_2: f64 = std::f64::consts::FRAC_1_SQRT_2;
const X: DVec3 = DVec3::X;
const Y: DVec3 = DVec3::Y;
const Z: DVec3 = DVec3::Z;
/// Singular direction of a left shoulder: backwards and outwards. A three-hinge joint cannot
/// tell the first hinge from the last where the arm lies along the first; people point the upper
/// arm to within 15° of this line in 0.006 % of the frames of the training motion (31 % for the
/// vertical, 1.1 % for the lateral and the fore-aft axis).
const LEFT_SHOULDER_SWING: DVec3 = DVec3::new(-FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2);
const RIGHT_SHOULDER_SWING: DVec3 = DVec3::new(-FRAC_1_SQRT_2, 0.0, -FRAC_1_SQRT_2);

const fn hinge(
    name: &'static str,
    link: Link,
    axis: DVec3,
    degrees: [f64; 2],
    torque: f64,
    damping: f64,
) -> Hinge {
    let range = [degrees[0].to_radians(), degrees[1].to_radians()];
    Hinge {
        name,
        link,
        axis,
        range,
        torque,
        damping,
    }
}

const fn neg(v: DVec3) -> DVec3 {
    DVec3::new(-v.x, -v.y, -v.z)
}

/// The hinges in the order of the generalised coordinates. Positive angles are flexion (forwards
/// at hip, trunk and neck), abduction, internal rotation and, in the middle, bending and turning
/// to the left. Limits enclose both the anatomical range and what a rig with fewer degrees of
/// freedom needs to follow a person.
#[rustfmt::skip]
pub const HINGE_TABLE: [Hinge; HINGES] = [
    hinge("spine_flexion", Link::Spine, neg(X), [-50.0, 90.0], 200.0, 5.0),
    hinge("spine_bend", Link::Spine, Z, [-50.0, 50.0], 200.0, 5.0),
    hinge("spine_turn", Link::Spine, Y, [-60.0, 60.0], 200.0, 5.0),
    hinge("chest_flexion", Link::Chest, neg(X), [-60.0, 70.0], 200.0, 5.0),
    hinge("chest_bend", Link::Chest, Z, [-50.0, 50.0], 200.0, 5.0),
    hinge("chest_turn", Link::Chest, Y, [-60.0, 60.0], 200.0, 5.0),
    hinge("head_flexion", Link::Head, neg(X), [-90.0, 80.0], 50.0, 2.0),
    hinge("head_bend", Link::Head, Z, [-60.0, 60.0], 50.0, 2.0),
    hinge("head_turn", Link::Head, Y, [-100.0, 100.0], 50.0, 2.0),
    hinge("left_shoulder_swing", Link::LeftUpperArm, LEFT_SHOULDER_SWING, [-170.0, 170.0], 100.0, 3.0),
    hinge("left_shoulder_raise", Link::LeftUpperArm, neg(Y), [-40.0, 130.0], 100.0, 3.0),
    hinge("left_shoulder_twist", Link::LeftUpperArm, neg(X), [-170.0, 170.0], 60.0, 2.0),
    hinge("left_elbow_flexion", Link::LeftForearm, neg(Y), [-2.0, 160.0], 60.0, 2.0),
    hinge("left_wrist_pronation", Link::LeftHand, X, [-150.0, 150.0], 20.0, 1.0),
    hinge("left_wrist_flexion", Link::LeftHand, Z, [-90.0, 90.0], 20.0, 1.0),
    hinge("right_shoulder_swing", Link::RightUpperArm, RIGHT_SHOULDER_SWING, [-170.0, 170.0], 100.0, 3.0),
    hinge("right_shoulder_raise", Link::RightUpperArm, Y, [-40.0, 130.0], 100.0, 3.0),
    hinge("right_shoulder_twist", Link::RightUpperArm, neg(X), [-170.0, 170.0], 60.0, 2.0),
    hinge("right_elbow_flexion", Link::RightForearm, Y, [-2.0, 160.0], 60.0, 2.0),
    hinge("right_wrist_pronation", Link::RightHand, X, [-150.0, 150.0], 20.0, 1.0),
    hinge("right_wrist_flexion", Link::RightHand, neg(Z), [-90.0, 90.0], 20.0, 1.0),
    hinge("left_hip_flexion", Link::LeftThigh, X, [-60.0, 150.0], 200.0, 5.0),
    hinge("left_hip_abduction", Link::LeftThigh, neg(Z), [-60.0, 75.0], 200.0, 5.0),
    hinge("left_hip_rotation", Link::LeftThigh, neg(Y), [-75.0, 75.0], 120.0, 5.0),
    hinge("left_knee_flexion", Link::LeftShank, neg(X), [-2.0, 165.0], 200.0, 5.0),
    hinge("left_ankle_flexion", Link::LeftFoot, X, [-75.0, 60.0], 120.0, 3.0),
    hinge("left_ankle_inversion", Link::LeftFoot, Z, [-50.0, 50.0], 60.0, 3.0),
    hinge("right_hip_flexion", Link::RightThigh, X, [-60.0, 150.0], 200.0, 5.0),
    hinge("right_hip_abduction", Link::RightThigh, Z, [-60.0, 75.0], 200.0, 5.0),
    hinge("right_hip_rotation", Link::RightThigh, Y, [-75.0, 75.0], 120.0, 5.0),
    hinge("right_knee_flexion", Link::RightShank, neg(X), [-2.0, 165.0], 200.0, 5.0),
    hinge("right_ankle_flexion", Link::RightFoot, X, [-75.0, 60.0], 120.0, 3.0),
    hinge("right_ankle_inversion", Link::RightFoot, neg(Z), [-50.0, 50.0], 60.0, 3.0),
];

/// Rotor inertia added to every hinge of a person 1.75 m tall, kg m²: with it direct torques
/// stay stable at four substeps of 1/144 s.
pub const ARMATURE: f64 = 0.1;

/// The hinges of a link, as a range of [`HINGE_TABLE`].
#[must_use]
pub fn hinges_of(link: Link) -> std::ops::Range<usize> {
    let first = HINGE_TABLE
        .iter()
        .position(|hinge| hinge.link == link)
        .unwrap_or(0);
    let count = HINGE_TABLE
        .iter()
        .filter(|hinge| hinge.link == link)
        .count();
    first..first + count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_ordered_and_mirrored() {
        let mut next = 0;
        for link in Link::ALL {
            assert!(link.parent().is_none_or(|parent| parent < link));
            let range = hinges_of(link);
            assert_eq!(range.start, if range.is_empty() { 0 } else { next });
            next += range.len();
            assert_eq!(link.mirrored().mirrored(), link);
        }
        assert_eq!(next, HINGES);
        for hinge in HINGE_TABLE
            .iter()
            .filter(|hinge| hinge.name.starts_with("left_"))
        {
            let name = hinge.name.replace("left_", "right_");
            let right = HINGE_TABLE.iter().find(|other| other.name == name);
            let right = right.expect("every left hinge has a right one");
            assert_eq!((hinge.range, hinge.torque), (right.range, right.torque));
            assert_eq!(hinge.link.mirrored(), right.link);
            // A rotation vector mirrored at the sagittal plane keeps x and turns y and z round.
            let mirrored = hinge.axis * DVec3::new(1.0, -1.0, -1.0);
            assert!(mirrored.abs_diff_eq(right.axis, 1e-12), "{name}");
        }
    }
}
