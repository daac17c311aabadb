//! VRChat's OSC trackers: up to eight points of the body, which VRChat's own inverse kinematics
//! follows.
//!
//! <https://docs.vrchat.com/docs/osc-trackers>: positions in metres and Euler angles in degrees, in
//! Unity's world. Which number is which part is not VRChat's matter (it looks where they are at
//! calibration), but other programs rely on SlimeVR's numbers, so these are the same.

use std::fmt;

use glam::{EulerRot, Quat, Vec3};
use posed_body::Joint;
use posed_signal::{HostTime, time::SECOND_NS};
use rosc::OscMessage;

use super::osc::{self, Bundle, Encode};
use crate::published::PublishedPose;

/// The port that VRChat listens on.
pub const PORT: u16 = 9000;

/// How long after the start and after a reset each bundle says which way the head faces. VRChat
/// turns slowly towards it, and a single datagram may be lost.
const FACING_NS: i64 = SECOND_NS as i64;

/// A body part, or a pair of them, that VRChat can follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The pelvis.
    Hip,
    /// Both ankles, turned as the feet are.
    Feet,
    /// Both knees, turned as the thighs are.
    Knees,
    /// The upper end of the spine.
    Chest,
    /// Both elbows, turned as the upper arms are.
    Elbows,
}

impl Part {
    /// Every part, in the order of SlimeVR's numbers.
    pub const ALL: [Self; 5] = [
        Self::Hip,
        Self::Feet,
        Self::Knees,
        Self::Chest,
        Self::Elbows,
    ];

    /// The word in the configuration.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hip => "hip",
            Self::Feet => "feet",
            Self::Knees => "knees",
            Self::Chest => "chest",
            Self::Elbows => "elbows",
        }
    }

    /// The inverse of [`Part::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|part| part.name() == name)
    }

    /// SlimeVR's number of each tracker, the joint where it is, and the joint whose bone it is on.
    fn trackers(self) -> &'static [(u8, Joint, Joint)] {
        match self {
            Self::Hip => &[(1, Joint::Pelvis, Joint::Pelvis)],
            Self::Feet => &[
                (2, Joint::LeftAnkle, Joint::LeftAnkle),
                (3, Joint::RightAnkle, Joint::RightAnkle),
            ],
            Self::Knees => &[
                (4, Joint::LeftKnee, Joint::LeftHip),
                (5, Joint::RightKnee, Joint::RightHip),
            ],
            Self::Chest => &[(6, Joint::Spine3, Joint::Spine3)],
            Self::Elbows => &[
                (7, Joint::LeftElbow, Joint::LeftShoulder),
                (8, Joint::RightElbow, Joint::RightShoulder),
            ],
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The encoder.
#[derive(Debug)]
pub struct VrChat {
    trackers: Vec<(u8, Joint, Joint)>,
    aligns_head: bool,
    /// Without and with the direction that the head faces.
    bundles: [Bundle; 2],
    facing_until: Option<HostTime>,
}

impl VrChat {
    /// Sends `parts`. With `aligns_head` VRChat is told where the head is, and moves the trackers'
    /// space so that it coincides with the avatar's head: needed unless VRChat's and posed's
    /// worlds are the same.
    #[must_use]
    pub fn new(parts: &[Part], aligns_head: bool) -> Self {
        let chosen = Part::ALL.into_iter().filter(|part| parts.contains(part));
        let trackers: Vec<_> = chosen
            .flat_map(|part| part.trackers().iter().copied())
            .collect();
        let point =
            |who: &str, what| osc::message(&format!("/tracking/trackers/{who}/{what}"), &[], 3);
        let mut messages = Vec::new();
        for (number, _, _) in &trackers {
            let who = number.to_string();
            messages.extend([point(&who, "position"), point(&who, "rotation")]);
        }
        if aligns_head {
            messages.push(point("head", "position"));
        }
        let without = Bundle::new(messages.clone());
        messages.push(point("head", "rotation"));
        let bundles = [without, Bundle::new(messages)];
        Self {
            trackers,
            aligns_head,
            bundles,
            facing_until: None,
        }
    }

    fn is_facing(&mut self, now: HostTime) -> bool {
        let until = *self
            .facing_until
            .get_or_insert_with(|| now.plus_ns(FACING_NS));
        // A replay that is wound back has not left the second.
        self.aligns_head && now <= until
    }
}

impl Encode for VrChat {
    /// Nothing is sent for a pose that is only held: VRChat then shows its trackers as lost.
    fn encode(&mut self, pose: &PublishedPose, send: &mut dyn FnMut(&[u8])) {
        if !pose.has_input() {
            return;
        }
        let is_facing = self.is_facing(pose.target_at);
        let bundle = &mut self.bundles[usize::from(is_facing)];
        let joints = &pose.joints;
        let mut messages = bundle.messages();
        for (_, place, bone) in &self.trackers {
            set(
                messages.next(),
                osc::unity_position(joints.position(*place)),
            );
            set(
                messages.next(),
                euler_degrees(osc::unity_rotation(joints.rotation(*bone))),
            );
        }
        if self.aligns_head {
            set(
                messages.next(),
                osc::unity_position(joints.position(Joint::Head)),
            );
        }
        let head = euler_degrees(osc::unity_rotation(joints.rotation(Joint::Head)));
        set(messages.next(), Vec3::new(0.0, head.y, 0.0));
        drop(messages);
        send(bundle.encode());
    }

    fn reset(&mut self) {
        self.facing_until = None;
    }
}

fn set(message: Option<&mut OscMessage>, vector: Vec3) {
    if let Some(message) = message {
        osc::set(message, 0, &vector.to_array());
    }
}

/// Unity's Euler angles: the rotation is that about Z, then X, then Y, about the axes of the
/// parent, so that the matrix is Y X Z.
fn euler_degrees(rotation: Quat) -> Vec3 {
    // In 64 bits: near 90° about X the angles lose half of their digits.
    let (y, x, z) = rotation.as_dquat().normalize().to_euler(EulerRot::YXZ);
    Vec3::new(
        x.to_degrees() as f32,
        y.to_degrees() as f32,
        z.to_degrees() as f32,
    )
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use posed_body::{BodyPose, Skeleton};
    use posed_tracker::Quality;
    use proptest::prelude::*;

    use super::*;
    use crate::{
        output::osc::tests::{decode, encoded, floats},
        published::tests::pose_at,
    };

    /// What the one datagram says, by address; empty where none was sent.
    fn points(encoder: &mut VrChat, pose: &PublishedPose) -> BTreeMap<String, Vec3> {
        let datagrams = encoded(encoder, pose);
        assert!(datagrams.len() <= 1, "one bundle");
        let messages = datagrams.iter().flat_map(|datagram| decode(datagram));
        messages
            .map(|message| {
                (
                    message.address.clone(),
                    Vec3::from_slice(&floats(&message, 0)),
                )
            })
            .collect()
    }

    fn tracker(number: u8, what: &str) -> String {
        format!("/tracking/trackers/{number}/{what}")
    }

    // Unity's own definition: Quaternion.Euler(x, y, z) = Qy * Qx * Qz, with the same product of
    // quaternions as everywhere.
    fn unity_quaternion(degrees: Vec3) -> Quat {
        Quat::from_rotation_y(degrees.y.to_radians())
            * Quat::from_rotation_x(degrees.x.to_radians())
            * Quat::from_rotation_z(degrees.z.to_radians())
    }

    proptest! {
        #[test]
        fn euler_angles_are_unitys(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, w in -1.0f32..1.0,
        ) {
            let q = Quat::from_xyzw(x, y, z, w);
            prop_assume!(q.length() > 0.1);
            let q = q.normalize();
            let back = unity_quaternion(euler_degrees(q));
            prop_assert!(q.dot(back).abs() > 1.0 - 1e-5, "{q} {back}");
        }
    }

    #[test]
    fn looking_straight_up_is_no_singularity_worth_noticing() {
        for angle in [89.99f32, 90.0, -90.0] {
            let q = unity_quaternion(Vec3::new(angle, 30.0, 0.0));
            let back = unity_quaternion(euler_degrees(q));
            assert!(q.angle_between(back) < 2e-3, "{angle}");
        }
    }

    // A wearer who has turned left by 30° and stands in a T-pose at the origin. In posed's
    // right-handed world turning left is +30° about Y. Unity's world is left-handed: seen from
    // above, positive angles turn right there, so that VRChat must hear -30°. Facing 30° to the
    // left of -Z, the wearer's left points to -X turned by the same angle: the left foot is at
    // x < 0, and behind the right one in posed (z > 0), hence z < 0 in Unity.
    #[test]
    fn a_turn_to_the_left_is_negative_in_unity() {
        let mut body = BodyPose::rest(Vec3::new(0.0, 0.9, 0.0));
        body.rotations[0] = Quat::from_rotation_y(30f32.to_radians());
        let joints = Skeleton::of_height(1.75).forward(&body);
        let pose = PublishedPose {
            pose: body,
            joints,
            ..pose_at(1, HostTime(1))
        };
        let points = points(&mut VrChat::new(&Part::ALL, true), &pose);
        for number in 1..=8 {
            let degrees = points[&tracker(number, "rotation")];
            assert!(
                (degrees - Vec3::new(0.0, -30.0, 0.0)).length() < 1e-3,
                "{number} {degrees}"
            );
        }
        let facing = points["/tracking/trackers/head/rotation"];
        assert!(
            (facing - Vec3::new(0.0, -30.0, 0.0)).length() < 1e-3,
            "{facing}"
        );
        let (hip, left, right) = (1, 2, 3);
        let at = |number| points[&tracker(number, "position")];
        assert!((at(hip) - Vec3::new(0.0, 0.9, 0.0)).length() < 1e-6);
        assert!(at(left).x < -0.05 && at(right).x > 0.05);
        assert!(
            at(left).y < 0.2 && at(7).y > 1.2 && at(6).y > at(hip).y,
            "feet low, elbows high"
        );
        assert!(at(4).y > at(left).y && at(4).y < at(hip).y, "knees between");
        assert!(at(left).z < at(right).z, "the left foot is behind");
        let head = points["/tracking/trackers/head/position"];
        assert!((head - at(6)).y > 0.2);
    }

    #[test]
    fn the_head_tells_its_direction_at_the_start_and_after_a_reset() {
        let mut encoder = VrChat::new(&Part::ALL, true);
        let at = |seconds: f64| pose_at(9, HostTime(SECOND_NS).plus_secs(seconds));
        let turns = |encoder: &mut VrChat, seconds| {
            let points = points(encoder, &at(seconds));
            assert!(points.contains_key("/tracking/trackers/head/position"));
            points.contains_key("/tracking/trackers/head/rotation")
        };
        assert!(turns(&mut encoder, 0.0) && turns(&mut encoder, 0.9));
        assert!(!turns(&mut encoder, 1.1) && !turns(&mut encoder, 60.0));
        encoder.reset();
        assert!(turns(&mut encoder, 61.0) && turns(&mut encoder, 61.9));
        assert!(!turns(&mut encoder, 62.1));
        let mut blind = VrChat::new(&[Part::Hip], false);
        let points = points(&mut blind, &at(0.0));
        assert!(
            points.keys().all(|address| address.contains("/1/")),
            "{points:?}"
        );
    }

    #[test]
    fn parts_can_be_left_out_and_a_held_pose_is_not_sent() {
        let pose = pose_at(3, HostTime(1));
        let mut encoder = VrChat::new(&[Part::Feet, Part::Hip, Part::Feet], false);
        let addresses: Vec<_> = points(&mut encoder, &pose).into_keys().collect();
        let expected =
            [1, 2, 3].map(|number| [tracker(number, "position"), tracker(number, "rotation")]);
        assert_eq!(addresses, expected.concat());
        let held = PublishedPose {
            quality: Quality::Held,
            ..pose
        };
        assert!(encoded(&mut encoder, &held).is_empty());
        for part in Part::ALL {
            assert_eq!(Part::from_name(part.name()), Some(part));
        }
    }
}
