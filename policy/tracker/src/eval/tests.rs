//! The stage shows what was done, and measures nothing but the tracker.

use super::*;
use crate::{
    Ik,
    tracker::{Tracked, TrackerKind},
};
use glam::{Quat, Vec3};
use posed_body::{Joint, Joints, Skeleton};

/// A person who turns, sways and moves both arms.
fn clip(frames: usize, fps: f64) -> Clip {
    let pose = |frame: usize| {
        let t = (frame as f64 / fps) as f32;
        let mut pose = BodyPose::rest(Vec3::new(0.1 * t.sin(), 0.88, 0.2 * t));
        pose.rotations[Joint::Pelvis as usize] = Quat::from_rotation_y(0.5 * t);
        for (joint, side) in [(Joint::LeftShoulder, 1.0), (Joint::RightShoulder, -1.0)] {
            let lift = Quat::from_rotation_z(side * (0.9 + 0.4 * (2.0 * t).sin()));
            pose.rotations[joint as usize] = lift;
        }
        pose
    };
    Clip {
        name: "test_sway_1".to_owned(),
        subject: "nobody".to_owned(),
        split: "train".to_owned(),
        fps,
        skeleton: Skeleton::of_height(1.7),
        frames: (0..frames).map(pose).collect(),
    }
}

/// Knows the answer, and checks the question.
struct Oracle<'a> {
    trajectory: &'a Trajectory,
    skeleton: Skeleton,
    sensors: Sensors,
    heard: usize,
    lost: usize,
}

impl Tracker for Oracle<'_> {
    fn kind(&self) -> TrackerKind {
        TrackerKind::Pip
    }

    fn reset(&mut self) {}

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let pose = self.trajectory.pose(input.target.since_secs(START));
        let joints = self.skeleton.forward(&pose);
        let pairs = [
            (Role::Head, Joint::Head),
            (Role::LeftHand, Joint::LeftWrist),
            (Role::RightHand, Joint::RightWrist),
        ];
        for (role, joint) in pairs {
            let worn = role == Role::Head || self.sensors != Sensors::Hmd;
            let worn = worn && self.sensors != Sensors::Imu6;
            assert_eq!(input.part(role).value().is_some(), worn, "{role}");
            let Some(part) = input.part(role).value() else {
                continue;
            };
            assert!(part.position.distance(joints.position(joint)) < 1e-5);
            assert!(part.rotation.angle_between(joints.rotation(joint)) < 2e-3);
            self.lost += usize::from(part.how == PoseHow::Lost);
        }
        self.check_inertial(input, &joints);
        Tracked {
            pose,
            quality: Quality::Full,
            kind: TrackerKind::Pip,
            forces: None,
        }
    }
}

impl Oracle<'_> {
    fn check_inertial(&mut self, input: &Input<'_>, joints: &Joints) {
        for (role, joint) in SIX {
            let Some(bone) = input.inertial(role).value() else {
                continue;
            };
            assert!(bone.rotation.angle_between(joints.rotation(joint)) < 2e-3);
            assert!(bone.accel.length() < 8.0, "{role}: {bone:?}");
            self.heard += 1;
        }
    }
}

fn run_oracle(options: &Options) -> (ClipResult, usize, usize) {
    let clip = clip(181, 60.0);
    let trajectory = Trajectory::new(&clip);
    let mut oracle = Oracle {
        trajectory: &trajectory,
        skeleton: clip.skeleton,
        sensors: options.sensors,
        heard: 0,
        lost: 0,
    };
    let result = evaluate(&clip, &mut oracle, options);
    (result, oracle.heard, oracle.lost)
}

#[test]
fn devices_say_where_the_parts_are_and_the_truth_scores_nothing() {
    for sensors in [Sensors::Hmd, Sensors::HmdControllers, Sensors::HmdHands] {
        for lookahead in [0, 3] {
            let options = Options {
                sensors,
                lookahead,
                ..Options::default()
            };
            let (result, heard, _) = run_oracle(&options);
            assert_eq!((result.frames, heard), (180, 0));
            assert_eq!(result.class, "test");
            for metric in [Metric::MpjpeWorld, Metric::MpjreGeodesic, Metric::Mpjve] {
                let value = result.scores.get(metric).unwrap();
                assert!(value < 1e-3, "{}: {value}", metric.name());
            }
        }
    }
}

#[test]
fn hands_out_of_view_are_said_to_be_lost() {
    let options = Options {
        sensors: Sensors::HmdHands,
        ..Options::default()
    };
    let (result, _, lost) = run_oracle(&options);
    let seen: f64 = result.hands_seen.iter().sum();
    assert!(lost > 0 && seen < 1.9, "{lost} lost, {seen} seen");
    let frustum = Frustum::default();
    assert!(
        frustum.sees(Vec3::new(0.1, -0.2, -0.3)),
        "in front of the chest"
    );
    assert!(
        !frustum.sees(Vec3::new(0.15, -0.5, 0.0)),
        "hanging at the side"
    );
    assert!(!frustum.sees(Vec3::new(0.0, 0.0, 0.3)), "behind the head");
}

#[test]
fn six_inertial_sensors_report_rotations_and_forces() {
    let options = Options {
        sensors: Sensors::Imu6,
        ..Options::default()
    };
    let (result, heard, _) = run_oracle(&options);
    assert_eq!(heard, 6 * (result.frames + 1));
}

const SIX: [(Role, Joint); 6] = [
    (Role::LeftWrist, Joint::LeftElbow),
    (Role::RightWrist, Joint::RightElbow),
    (Role::LeftKnee, Joint::LeftKnee),
    (Role::RightKnee, Joint::RightKnee),
    (Role::Head, Joint::Head),
    (Role::Waist, Joint::Pelvis),
];

#[test]
fn the_six_measure_what_their_bones_do() {
    let clip = clip(181, 60.0);
    let trajectory = Trajectory::new(&clip);
    let mut shown = Shown::new(&trajectory, &clip, Sensors::Imu6, Straps::Exact);
    for (role, _) in SIX {
        let bone = shown.orientation(role, 1.5, START).unwrap();
        assert!(shown.pose(role, 1.5, START).is_none());
        assert!(bone.accel.length() < 3.0, "{role}: {bone:?}");
        let turning = bone.angular_velocity;
        assert!((turning.y - 0.5).abs() < 0.9, "{role}: {turning}");
    }
    // The pelvis turns at 0.5 rad/s and glides; its sensor sits 10 cm behind the joint.
    let bone = shown.orientation(Role::Waist, 1.5, START).unwrap();
    let turning = bone.angular_velocity;
    assert!(turning.distance(Vec3::Y * 0.5) < 1e-4, "{turning}");
    let inward = Quat::from_rotation_y(0.75) * Vec3::new(0.0, 0.0, -0.1 * 0.25);
    let expected = inward - Vec3::X * (0.1 * 1.5_f32.sin());
    assert!(
        bone.accel.distance(expected) < 2e-3,
        "{} {expected}",
        bone.accel
    );
    assert!(shown.orientation(Role::LeftHand, 1.5, START).is_none());
}

#[test]
fn worn_straps_are_a_little_off_and_the_same_every_time() {
    let clip = clip(181, 60.0);
    let trajectory = Trajectory::new(&clip);
    let [mut exact, mut worn, mut again] = [Straps::Exact, Straps::Worn, Straps::Worn]
        .map(|straps| Shown::new(&trajectory, &clip, Sensors::Imu6, straps));
    for (role, _) in SIX {
        let [exact, worn, again] = [&mut exact, &mut worn, &mut again]
            .map(|shown| shown.orientation(role, 2.0, START).unwrap());
        assert_eq!(worn, again);
        let off = exact.rotation.angle_between(worn.rotation);
        assert!((0.005..0.16).contains(&off), "{role}: {off}");
        let apart = exact.accel.distance(worn.accel);
        assert!((1e-3..1.0).contains(&apart), "{role}: {apart}");
    }
}

#[test]
fn the_same_run_gives_the_same_numbers() {
    let clip = clip(91, 30.0);
    for bones in [Bones::Clip, Bones::Height] {
        let options = Options {
            bones,
            dump: true,
            ..Options::default()
        };
        let [a, b] = [0, 1].map(|_| evaluate(&clip, &mut Ik::default(), &options));
        assert_eq!(a, b);
        assert_eq!(a.frames, 180, "resampled to the tick's rate");
        let dump = a.dump.as_ref().unwrap();
        let curve = error_curve(dump);
        let mean = curve.iter().sum::<f64>() / curve.len() as f64;
        let whole = a.scores.get(Metric::MpjpeHead).unwrap();
        assert!((mean - whole).abs() < 1e-9 && whole > 0.1, "{mean} {whole}");
        let standing = contact_curve(&dump.truth);
        assert_eq!(standing.len(), 180);
        let frames_down = standing.iter().filter(|feet| feet[0]).count();
        // The whole body glides at 0.2 m/s and turns: the feet stand now and then only.
        assert!((1..180).contains(&frames_down), "{frames_down}");
        let report = Report::of(&[a.clone(), b]);
        assert_eq!(
            (report.all.clips, report.classes.len(), report.clips.len()),
            (2, 1, 2)
        );
        assert_eq!(report.all.scores.get(Metric::MpjpeHead), Some(whole));
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["all"]["scores"]["mpjpe_head_cm"].as_f64(), Some(whole));
    }
}

#[test]
fn one_frame_is_a_clip_too() {
    let result = evaluate(&clip(1, 60.0), &mut Ik::default(), &Options::default());
    assert_eq!(result.frames, 1);
    assert!(result.scores.get(Metric::MpjpeHead).is_some());
    assert_eq!(result.scores.get(Metric::Mpjve), None);
}
