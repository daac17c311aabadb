//! Six simulated SlimeVR trackers without a role get theirs from how the wearer moves.

use std::{f32::consts::PI, io::Cursor};

use glam::{Quat, Vec3};
use posed::{
    assemble::{Options, assemble},
    pipeline::{
        replay::{Watcher, replay},
        source::Source,
    },
    published::PublishedPose,
    simulated::{self, Person},
};
use posed_body::{BodyPose, Joint, Skeleton, motion::Clip};
use posed_device::{
    capture::open,
    rig::DeviceInfo,
    simulate::slimevr,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{DeviceId, Role, Sample, Serial};

use crate::trackers::{PORT, usbmon};

const FPS: f64 = 60.0;
/// Where the trackers are worn, in an order that nobody would guess.
const SHUFFLED: [Role; 6] = [
    Role::RightKnee,
    Role::Waist,
    Role::LeftWrist,
    Role::Head,
    Role::LeftKnee,
    Role::RightWrist,
];

/// One movement: joints and how far each turns about its axis, radians.
type Move = &'static [(Joint, Vec3, f32)];

const LEFT_ELBOW: Move = &[(Joint::LeftElbow, Vec3::NEG_Y, 1.7)];
const RIGHT_ELBOW: Move = &[(Joint::RightElbow, Vec3::Y, 1.7)];
/// The hip gives a little as the heel comes up.
const LEFT_HEEL: Move = &[
    (Joint::LeftKnee, Vec3::NEG_X, 1.4),
    (Joint::LeftHip, Vec3::X, 0.2),
];
const RIGHT_HEEL: Move = &[
    (Joint::RightKnee, Vec3::NEG_X, 1.4),
    (Joint::RightHip, Vec3::X, 0.2),
];
const LOOK: Move = &[(Joint::Neck, Vec3::Y, 0.5), (Joint::Head, Vec3::Y, 0.4)];
const BOTH_ELBOWS: Move = &[
    (Joint::LeftElbow, Vec3::NEG_Y, 1.7),
    (Joint::RightElbow, Vec3::Y, 1.7),
];

/// Stands with hanging arms, swaying as people do, and moves as told: 1.4 s each, with 1.2 s of
/// rest between.
fn clip(moves: &[Move]) -> Clip {
    let skeleton = Skeleton::of_height(1.75);
    let [lead, way, rest] = [2.0, 1.4, 1.2].map(|seconds: f64| (seconds * FPS) as usize);
    let count = lead + moves.len() * (way + rest);
    let frame = |index: usize| {
        let seconds = (index as f64 / FPS) as f32;
        let mut pose = BodyPose::rest(Vec3::new(0.0, 0.93, 0.0));
        let mut turn = |joint: Joint, by: Quat| {
            let slot = &mut pose.rotations[joint as usize];
            *slot = (*slot * by).normalize();
        };
        let sway = 0.03 * (1.9 * seconds).sin();
        turn(
            Joint::Pelvis,
            Quat::from_euler(glam::EulerRot::YXZ, 0.7 + sway, sway, 0.5 * sway),
        );
        turn(Joint::LeftShoulder, Quat::from_rotation_z(0.5 * PI - 0.1));
        turn(Joint::RightShoulder, Quat::from_rotation_z(0.1 - 0.5 * PI));
        let passed = index.saturating_sub(lead);
        if let Some(joints) = moves.get(passed / (way + rest)).filter(|_| index >= lead) {
            let share = (passed % (way + rest)) as f32 / way as f32;
            let bent = (PI * share.min(1.0)).sin().powi(2);
            for &(joint, axis, angle) in *joints {
                turn(joint, Quat::from_axis_angle(axis, bent * angle));
            }
        }
        pose
    };
    Clip {
        name: "shows where the trackers are".into(),
        subject: "procedural".into(),
        split: "test".into(),
        fps: FPS,
        frames: (0..count).map(frame).collect(),
        skeleton,
    }
}

#[derive(Default)]
struct Told(Vec<String>);

impl Watcher for Told {
    fn pace(&mut self, _time: posed_signal::HostTime) -> bool {
        true
    }

    fn sample(&mut self, _device: DeviceId, _sample: &Sample) {}

    fn pose(&mut self, _pose: &PublishedPose, _source: &Source) {}

    fn warning(&mut self, text: &str) {
        self.0.push(text.to_owned());
    }
}

/// The trackers' roles at the end, in the order of their numbers, and what the wearer was told.
fn watch(moves: &[Move], given: &[(usize, Role)]) -> (Vec<Role>, Vec<String>) {
    let clip = clip(moves);
    let person = Person::new(&clip);
    let receiver = slimevr::Options {
        duration_s: clip.duration(),
        loss: 0.05,
        ..slimevr::Options::default()
    };
    let trackers = person.trackers(&SHUFFLED, 5);
    let packets = slimevr::Receiver::new(receiver, PORT, trackers).expect("six are not too many");
    let recording = Recording {
        name: "simulated".into(),
        reader: open(Cursor::new(usbmon(packets))).expect("a capture"),
        devices: Vec::new(),
    };
    let mut options = Options::default();
    let serial = |index: usize| Serial::new(&simulated::tracker_serial(index));
    options.rig.roles = given
        .iter()
        .map(|&(index, role)| (serial(index), role))
        .collect();
    let transport = Replay::new(vec![recording], Merge::OneSession);
    let mut parts = assemble(Box::new(transport), options);
    let mut told = Told::default();
    replay(&mut parts.source, &mut parts.tracker, 90.0, &mut told);
    let devices = parts.source.rig().devices();
    let role = |index| {
        let is = |device: &&DeviceInfo| device.identity.serial == serial(index);
        devices
            .iter()
            .find(is)
            .expect("every tracker is there")
            .role
    };
    ((0..SHUFFLED.len()).map(role).collect(), told.0)
}

#[test]
fn six_trackers_show_where_they_are_worn() {
    let (roles, told) = watch(&[LEFT_ELBOW, RIGHT_ELBOW, LEFT_HEEL, RIGHT_HEEL, LOOK], &[]);
    assert_eq!(roles, SHUFFLED, "{told:?}");
    assert!(
        matches!(&told[..], [text] if text.contains("bend the left elbow")),
        "{told:?}"
    );
}

#[test]
fn limbs_that_move_together_are_refused_in_words() {
    let (roles, told) = watch(&[LEFT_ELBOW, BOTH_ELBOWS, LEFT_HEEL, RIGHT_HEEL, LOOK], &[]);
    assert_eq!(roles, [Role::None; 6]);
    assert!(
        told.iter().any(|text| text.contains("one limb at a time")),
        "{told:?}"
    );
}

#[test]
fn what_the_user_named_stays_and_the_rest_is_asked_for() {
    // Named by the user: head and waist. Four are left: four roles, three movements.
    let given = [(3, Role::Head), (1, Role::Waist)];
    let (roles, told) = watch(&[LEFT_ELBOW, RIGHT_ELBOW, LEFT_HEEL], &given);
    assert_eq!(roles, SHUFFLED, "{told:?}");
    // Left out by the user: five are left for six roles, and nobody guesses.
    let (roles, told) = watch(&[LEFT_ELBOW, RIGHT_ELBOW, LEFT_HEEL], &[(0, Role::None)]);
    assert_eq!((roles, told.len()), (vec![Role::None; 6], 0));
}
