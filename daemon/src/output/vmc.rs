//! Virtual Motion Capture protocol 3.1, as a performer: the finished motion for VSeeFace, Warudo,
//! Blender, Unity, Unreal, Godot.
//!
//! <https://protocol.vmc.info>, specification and marionette-spec. Bones are local to their parent,
//! in Unity's axes, their names are `HumanBodyBones`; with every rotation the identity the model
//! stands in a T-pose.

use glam::{Quat, Vec3};
use posed_body::Joint;
use posed_signal::HostTime;
use posed_tracker::Quality;
use rosc::{OscMessage, OscType};

use super::{
    motion,
    names::Names,
    osc::{self, Bundle, Encode},
};
use crate::published::PublishedPose;

/// The port that receivers of finished motion listen on.
pub const PORT: u16 = 39539;

/// `loaded`: bones are being sent.
const LOADED: i32 = 1;
/// Calibration state "calibrated".
const CALIBRATED: i32 = 3;
/// Calibration mode "normal".
const NORMAL: i32 = 0;

/// The encoder.
#[derive(Debug)]
pub struct Vmc {
    bundles: Vec<Bundle>,
    /// The target time that `/VMC/Ext/T` counts from: seconds since boot would leave a 32-bit float
    /// no milliseconds.
    origin: Option<HostTime>,
}

impl Default for Vmc {
    fn default() -> Self {
        Self::new()
    }
}

impl Vmc {
    /// Lays the bundles out.
    #[must_use]
    pub fn new() -> Self {
        let mut messages = vec![transform("/VMC/Ext/Root/Pos", "root")];
        let bone = |joint| transform("/VMC/Ext/Bone/Pos", Names::Unity.of(joint));
        messages.extend(Joint::ALL.map(bone));
        messages.push(OscMessage {
            addr: "/VMC/Ext/OK".into(),
            args: ok(Quality::Held),
        });
        messages.push(osc::message("/VMC/Ext/T", &[], 1));
        Self {
            bundles: Bundle::split(messages),
            origin: None,
        }
    }
}

impl Encode for Vmc {
    fn encode(&mut self, pose: &PublishedPose, send: &mut dyn FnMut(&[u8])) {
        // A replay that is wound back starts to count anew.
        let origin = self.origin.filter(|origin| *origin <= pose.target_at);
        let seconds = pose
            .target_at
            .since_secs(*self.origin.insert(origin.unwrap_or(pose.target_at)));
        let mut places = motion::skeleton_of(&pose.joints).offsets;
        // The hips hang on the root, which stays at the world's origin.
        places[Joint::Pelvis as usize] = pose.pose.root;
        let mut messages = self.bundles.iter_mut().flat_map(Bundle::messages);
        if let Some(root) = messages.next() {
            set_transform(root, Vec3::ZERO, Quat::IDENTITY);
        }
        for (place, rotation) in places.iter().zip(&pose.pose.rotations) {
            if let Some(bone) = messages.next() {
                set_transform(bone, *place, *rotation);
            }
        }
        if let Some(status) = messages.next() {
            status.args = ok(pose.quality);
        }
        if let Some(time) = messages.next() {
            osc::set(time, 0, &[seconds as f32]);
        }
        drop(messages);
        for bundle in &mut self.bundles {
            send(bundle.encode());
        }
    }
}

/// Loaded, calibrated, normal mode, and whether tracking works (version 2.7).
fn ok(quality: Quality) -> Vec<OscType> {
    let tracking = i32::from(quality > Quality::Held);
    [LOADED, CALIBRATED, NORMAL, tracking]
        .map(OscType::Int)
        .to_vec()
}

/// A name, a position and a quaternion.
fn transform(address: &str, name: &str) -> OscMessage {
    osc::message(address, &[OscType::String(name.into())], 7)
}

fn set_transform(message: &mut OscMessage, position: Vec3, rotation: Quat) {
    let [px, py, pz] = osc::unity_position(position).to_array();
    let [qx, qy, qz, qw] = osc::unity_rotation(rotation).to_array();
    osc::set(message, 1, &[px, py, pz, qx, qy, qz, qw]);
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use open_sound_control::{OscArgument, OscMessage};
    use posed_body::{BodyPose, JOINTS, Skeleton};
    use posed_signal::time::SECOND_NS;

    use super::*;
    use crate::{
        output::osc::tests::{decode, encoded, floats},
        published::tests::pose_at,
    };

    fn messages(encoder: &mut Vmc, pose: &PublishedPose) -> Vec<OscMessage> {
        encoded(encoder, pose)
            .iter()
            .flat_map(|datagram| decode(datagram))
            .collect()
    }

    /// Bones by name: position and quaternion.
    fn bones(messages: &[OscMessage]) -> BTreeMap<String, Vec<f32>> {
        let bone = |message: &OscMessage| match &message.arguments[0] {
            OscArgument::String(name) => (name.clone(), floats(message, 1)),
            other => panic!("{other:?} is no name"),
        };
        messages
            .iter()
            .filter(|m| m.address == "/VMC/Ext/Bone/Pos")
            .map(bone)
            .collect()
    }

    /// The wearer at 1.75 m, hips at (0.3, 0.9, -0.2), with one joint turned.
    fn turned(joint: Joint, rotation: Quat) -> PublishedPose {
        let mut pose = BodyPose::rest(Vec3::new(0.3, 0.9, -0.2));
        pose.rotations[joint as usize] = rotation;
        let joints = Skeleton::of_height(1.75).forward(&pose);
        PublishedPose {
            pose,
            joints,
            ..pose_at(1, HostTime(SECOND_NS))
        }
    }

    // The axes, on a pose that every reader can picture: the left forearm is raised straight up
    // from a T-pose. The left arm points along -X in posed's world and in Unity's, up is +Y in both,
    // so that the movement takes -X to +Y in both. About +Z that is a turn by -90° by the algebra
    // of quaternions, which knows nothing of handedness: q = (0, 0, -sin 45°, cos 45°). (What
    // differs is how it looks: Unity's +Z points forward, posed's backward.)
    #[test]
    fn a_raised_forearm_is_raised_in_unity() {
        let quarter = -std::f32::consts::FRAC_PI_2;
        let pose = turned(Joint::LeftElbow, Quat::from_rotation_z(quarter));
        let bones = bones(&messages(&mut Vmc::new(), &pose));
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let expected = [0.0, 0.0, -half, half];
        let elbow = &bones["LeftLowerArm"];
        for (number, expected) in elbow[3..].iter().zip(expected) {
            assert!((number - expected).abs() < 1e-6, "{elbow:?}");
        }
        let q = Quat::from_xyzw(elbow[3], elbow[4], elbow[5], elbow[6]);
        assert!((q * Vec3::NEG_X - Vec3::Y).length() < 1e-6);
        // Where the forearm starts does not depend on its own rotation.
        let upper_arm = Skeleton::of_height(1.75).offsets[Joint::LeftElbow as usize];
        let start = Vec3::from_slice(elbow);
        assert!(
            (start - upper_arm).length() < 1e-5 && start.x < -0.2,
            "{elbow:?}"
        );
    }

    // Handedness off the mirror plane: bending the hips forward is a turn about the X axis. In a
    // right-handed world -X is the axis that takes up (+Y) to forward (-Z); in Unity +X takes +Y to
    // forward (+Z).
    #[test]
    fn a_bow_goes_forward_in_unity() {
        let pose = turned(Joint::Pelvis, Quat::from_rotation_x(-0.5));
        let bones = bones(&messages(&mut Vmc::new(), &pose));
        let hips = &bones["Hips"];
        assert_eq!(hips[..3], [0.3, 0.9, 0.2], "only z is mirrored");
        let q = Quat::from_xyzw(hips[3], hips[4], hips[5], hips[6]);
        assert!(q.angle_between(Quat::from_rotation_x(0.5)) < 1e-3);
        assert!(
            (q * Vec3::Y).z > 0.4,
            "the spine leans to +Z, Unity's forward"
        );
    }

    #[test]
    fn a_receiver_that_walks_the_hierarchy_ends_up_where_the_joints_are() {
        let pose = pose_at(37, HostTime(SECOND_NS));
        let bones = bones(&messages(&mut Vmc::new(), &pose));
        assert_eq!(bones.len(), JOINTS);
        let mut world = [(Vec3::ZERO, Quat::IDENTITY); JOINTS];
        for joint in Joint::ALL {
            let [px, py, pz, qx, qy, qz, qw] = bones[Names::Unity.of(joint)][..] else {
                panic!("a position and a quaternion");
            };
            let (origin, turn) = joint
                .parent()
                .map_or((Vec3::ZERO, Quat::IDENTITY), |parent| {
                    world[parent as usize]
                });
            let place = origin + turn * Vec3::new(px, py, pz);
            world[joint as usize] = (place, turn * Quat::from_xyzw(qx, qy, qz, qw));
            let expected = pose.joints.position(joint) * Vec3::new(1.0, 1.0, -1.0);
            assert!((place - expected).length() < 1e-5, "{}", joint.name());
        }
    }

    #[test]
    fn status_time_and_root_are_there_once() {
        let mut encoder = Vmc::new();
        let first = messages(&mut encoder, &pose_at(1, HostTime(100 * SECOND_NS)));
        let later = pose_at(2, HostTime(102 * SECOND_NS + SECOND_NS / 2));
        let lost = PublishedPose {
            quality: Quality::Held,
            ..later
        };
        let second = messages(&mut encoder, &lost);
        let one = |messages: &[OscMessage], address: &str| {
            let mut found = messages.iter().filter(|message| message.address == address);
            let arguments = found.next().map(|m| format!("{:?}", m.arguments)).unwrap();
            assert!(found.next().is_none(), "{address} once");
            arguments
        };
        let int = |numbers: [i32; 4]| format!("{:?}", numbers.map(OscArgument::Int32));
        assert_eq!(one(&first, "/VMC/Ext/OK"), int([1, 3, 0, 1]));
        assert_eq!(one(&second, "/VMC/Ext/OK"), int([1, 3, 0, 0]));
        assert_eq!(one(&first, "/VMC/Ext/T"), "[Float32(0.0)]");
        assert_eq!(one(&second, "/VMC/Ext/T"), "[Float32(2.5)]");
        let root = "[String(\"root\"), Float32(0.0), Float32(0.0), Float32(-0.0), Float32(-0.0), \
                    Float32(-0.0), Float32(0.0), Float32(1.0)]";
        assert_eq!(one(&first, "/VMC/Ext/Root/Pos"), root);
        let rewound = messages(&mut encoder, &pose_at(3, HostTime(SECOND_NS)));
        assert_eq!(one(&rewound, "/VMC/Ext/T"), "[Float32(0.0)]");
        assert_eq!(first.len(), 1 + JOINTS + 2);
    }
}
