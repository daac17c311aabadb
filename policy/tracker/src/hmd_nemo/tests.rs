//! Golden vectors of the training side replayed, and what must hold whatever the weights say.

use std::{f32::consts::FRAC_PI_2, path::Path};

use glam::{Quat, Vec3};
use posed_body::{Joint, Joints};
use posed_signal::{Lookup, Pose, PoseHow};
use serde::Deserialize;

use super::{features::Builder, *};
use crate::{
    golden::close,
    inference::shared_runtime,
    tracker::{NO_INERTIAL, Quality, Wearer},
};

/// An untrained network of the smallest size, and what PyTorch makes of a made-up motion with it;
/// written by policy/training/fixtures/tiny_hmd_nemo.py.
const TINY: &[u8] = include_bytes!("../../tests/data/hmd_nemo_tiny.onnx");
const TINY_GOLDEN: &str = include_str!("../../tests/data/hmd_nemo_tiny.golden.json");

#[derive(Deserialize)]
struct Golden {
    frames: usize,
    head_height: f32,
    sensor_position: Vec<f32>,
    sensor_rotation: Vec<f32>,
    visible: Vec<u8>,
    yaw: Vec<f32>,
    features: Vec<f32>,
    rotation: Vec<f32>,
    root: Vec<f32>,
    contact: Vec<f32>,
}

impl Golden {
    fn seen(&self, frame: usize) -> Seen {
        let place = |part: usize| Place {
            position: Vec3::from_slice(&self.sensor_position[(3 * frame + part) * 3..]),
            rotation: Quat::from_slice(&self.sensor_rotation[(3 * frame + part) * 4..]),
        };
        let hand = |side: usize| (self.visible[2 * frame + side] == 1).then(|| place(side + 1));
        Seen {
            head: place(0),
            hands: [hand(0), hand(1)],
        }
    }
}

fn replay(model: &[u8], golden: &str) {
    let golden: Golden = serde_json::from_str(golden).unwrap();
    let mut network = Step::load(&shared_runtime(), "golden", model).unwrap();
    let mut memory = network.memory();
    let mut before = None;
    for frame in 0..golden.frames {
        let seen = golden.seen(frame);
        let first = seen;
        let builder = Builder::new(
            &seen,
            Some(before.as_ref().unwrap_or(&first)),
            1.0 / 60.0,
            golden.head_height,
        );
        close("yaw", frame, &[builder.yaw()], &golden.yaw[frame..], 1e-4);
        let mut features = [0.0; features::STREAMS * features::STREAM];
        builder.write(&mut features);
        // Velocities are differences of numbers that were written with six or seven digits.
        close(
            "feature",
            frame,
            &features,
            &golden.features[75 * frame..],
            2e-3,
        );
        let visible = seen.hands.map(|hand| hand.is_some());
        let answer = network.run(&mut memory, &builder, visible).unwrap();
        let heading = Quat::from_rotation_y(builder.yaw());
        for joint in 0..22 {
            let wanted = Quat::from_slice(&golden.rotation[(22 * frame + joint) * 4..]);
            let wanted = if joint == 0 { heading * wanted } else { wanted };
            let off = answer.rotations[joint].angle_between(wanted.normalize());
            assert!(
                off < 5e-3,
                "joint {joint} of frame {frame} is {off} rad off"
            );
        }
        let root = heading.inverse() * answer.root_from_head / golden.head_height;
        close(
            "root",
            frame,
            &root.to_array(),
            &golden.root[3 * frame..],
            2e-3,
        );
        close(
            "contact",
            frame,
            &answer.contact,
            &golden.contact[4 * frame..],
            2e-3,
        );
        before = Some(seen);
    }
}

#[test]
fn the_small_example_agrees_with_pytorch() {
    replay(TINY, TINY_GOLDEN);
}

#[test]
fn the_models_that_ship_agree_with_pytorch() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    for name in ["hmd_nemo_small", "hmd_nemo_full"] {
        let model = std::fs::read(folder.join(format!("{name}.onnx")));
        let golden = std::fs::read_to_string(folder.join(format!("{name}.golden.json")));
        let (Ok(model), Ok(golden)) = (model, golden) else {
            continue;
        };
        replay(&model, &golden);
    }
}

/// A wearer in front of the tracker.
struct Stage {
    tracker: HmdNemo,
    wearer: Wearer,
    parts: [Lookup<Pose>; Role::COUNT],
}

impl Stage {
    fn new() -> Self {
        let options = Options::default();
        let tracker = HmdNemo::load(&shared_runtime(), "tiny", TINY, options).unwrap();
        let wearer = Wearer::of_height(1.75);
        Self {
            tracker,
            wearer,
            parts: [Lookup::Empty; Role::COUNT],
        }
    }

    fn set(&mut self, role: Role, position: Vec3, rotation: Quat) {
        let pose = Pose::unknown(HostTime(0));
        self.parts[role as usize] = Lookup::Exact(Pose {
            position,
            rotation,
            how: PoseHow::Optical,
            ..pose
        });
    }

    fn lose(&mut self, role: Role) {
        self.parts[role as usize] = Lookup::Empty;
    }

    /// Somebody who turns about and moves the hands, `t` seconds in.
    fn show(&mut self, t: f32) -> [(Vec3, Quat); 3] {
        let turn = Quat::from_rotation_y(0.6 * t.sin());
        let head = Vec3::new(0.2 * t.sin(), 1.42 + 0.03 * (2.0 * t).sin(), 0.1 * t);
        let hand = |side: f32| {
            let offset = Vec3::new(0.2 * side, -0.35 + 0.05 * (3.0 * t).sin(), -0.25);
            (
                head + turn * offset,
                turn * Quat::from_rotation_z(-0.8 * side),
            )
        };
        let parts = [(head, turn), hand(-1.0), hand(1.0)];
        let roles = [Role::Head, Role::LeftHand, Role::RightHand];
        for (role, (position, rotation)) in roles.into_iter().zip(parts) {
            self.set(role, position, rotation);
        }
        parts
    }

    fn tick(&mut self, seconds: f64) -> (Tracked, Joints) {
        let target = HostTime::from_secs_f64(10.0 + seconds);
        let input = Input {
            target,
            parts: &self.parts,
            inertial: &NO_INERTIAL,
            wearer: &self.wearer,
        };
        let tracked = self.tracker.track(&input);
        assert!(tracked.pose.is_sound());
        (tracked, self.wearer.skeleton.forward(&tracked.pose))
    }
}

#[test]
fn head_and_hands_are_met_at_any_rate() {
    for hz in [30.0, 45.0, 60.0, 72.0, 90.0, 120.0] {
        let mut stage = Stage::new();
        for n in 0..(3.0 * hz) as usize {
            let seconds = n as f64 / hz;
            let [head, left, right] = stage.show(seconds as f32);
            let (tracked, joints) = stage.tick(seconds);
            assert_eq!(
                (tracked.kind, tracked.quality),
                (TrackerKind::HmdNemo, Quality::Full)
            );
            assert!(joints.position(Joint::Head).distance(head.0) < 1e-4);
            assert!(joints.rotation(Joint::Head).angle_between(head.1) < 2e-3);
            for (joint, hand) in [(Joint::LeftWrist, left), (Joint::RightWrist, right)] {
                let off = joints.position(joint).distance(hand.0);
                // An untrained body may hold its shoulder where the arm does not reach from.
                let shoulder = Joint::ALL[joint as usize - 4];
                let way = joints.position(shoulder).distance(hand.0);
                assert!(
                    off < 2e-3 || way > 0.48,
                    "{hz} Hz: {} is {off} m off",
                    joint.name()
                );
                assert!(joints.rotation(joint).angle_between(hand.1) < 2e-3);
            }
        }
    }
}

#[test]
fn rates_agree() {
    let at_two_seconds = [30.0, 60.0, 90.0, 120.0].map(|hz| {
        let mut stage = Stage::new();
        let mut joints = None;
        for n in 0..=(2.0 * hz) as usize {
            let seconds = n as f64 / hz;
            stage.show(seconds as f32);
            joints = Some(stage.tick(seconds).1);
        }
        joints.unwrap()
    });
    for joints in &at_two_seconds {
        for joint in Joint::ALL {
            let off = joints
                .position(joint)
                .distance(at_two_seconds[1].position(joint));
            assert!(off < 0.02, "{} is {off} m off", joint.name());
        }
    }
}

#[test]
fn parts_come_and_go_without_a_jump() {
    let mut stage = Stage::new();
    let mut last: Option<Joints> = None;
    for n in 0..900u32 {
        let seconds = f64::from(n) / 60.0;
        stage.show(0.2 * seconds as f32);
        let lost = match n {
            100..200 => Some(Role::LeftHand),
            300..500 => Some(Role::Head),
            600..700 => Some(Role::RightHand),
            _ => None,
        };
        if let Some(role) = lost {
            stage.lose(role);
        }
        let (tracked, joints) = stage.tick(seconds);
        match lost {
            Some(Role::Head) => assert_eq!(tracked.quality, Quality::Held),
            Some(_) => assert_eq!(tracked.quality, Quality::Partial),
            None => {}
        }
        // An untrained memory takes a few steps to settle.
        if let Some(last) = last.filter(|_| n > 10) {
            for joint in Joint::ALL {
                let step = joints.position(joint).distance(last.position(joint));
                assert!(step < 0.13, "{} jumps {step} m at tick {n}", joint.name());
            }
        }
        last = Some(joints);
    }
}

#[test]
fn a_reset_forgets() {
    let mut stage = Stage::new();
    stage.show(0.0);
    let first = stage.tick(0.0).0;
    for n in 1..100u32 {
        stage.show(n as f32 / 60.0);
        stage.tick(f64::from(n) / 60.0);
    }
    stage.tracker.reset();
    stage.show(0.0);
    assert_eq!(stage.tick(5.0).0, first);
}

#[test]
fn starts_from_any_pose() {
    let up = Quat::IDENTITY;
    let poses = [
        (1.6, up),
        (0.7, Quat::from_rotation_x(-0.9)),
        (0.2, Quat::from_rotation_x(FRAC_PI_2)),
        (0.25, Quat::from_rotation_z(FRAC_PI_2)),
        (
            1.2,
            Quat::from_rotation_y(3.0) * Quat::from_rotation_x(-1.4),
        ),
    ];
    for (height, rotation) in poses {
        let mut stage = Stage::new();
        let head = Vec3::new(3.0, height, -2.0);
        stage.set(Role::Head, head, rotation);
        let mut last: Option<Joints> = None;
        for n in 0..90u32 {
            // The left hand is never there.
            let hand = head + rotation * Vec3::new(0.3, -0.2, -0.3);
            stage.set(Role::RightHand, hand, rotation);
            let (tracked, joints) = stage.tick(f64::from(n) / 60.0);
            assert_eq!(tracked.kind, TrackerKind::HmdNemo);
            assert!(joints.position(Joint::Head).distance(head) < 1e-4);
            assert!(joints.rotation(Joint::Head).angle_between(rotation) < 2e-3);
            // An untrained memory takes a few steps to settle.
            if let Some(last) = last.filter(|_| n > 10) {
                for joint in Joint::ALL {
                    let step = joints.position(joint).distance(last.position(joint));
                    assert!(step < 0.13, "{} jumps {step} m at tick {n}", joint.name());
                }
            }
            last = Some(joints);
        }
    }
}

#[test]
fn a_model_of_another_shape_is_refused() {
    let other = include_bytes!("../../tests/data/running_sum.onnx");
    let load = HmdNemo::load(&shared_runtime(), "sum", other, Options::default());
    let text = load.err().unwrap().to_string();
    assert!(
        text.contains("model sum") && text.contains("input"),
        "{text}"
    );
}

#[test]
fn a_robust_hand_is_pulled_less_the_farther_it_is_off() {
    let shares = [0.0, 0.05, 0.3].map(|residual| Energy::Robust.pull(residual));
    assert!(
        shares[0] == 1.0 && shares[1] > 0.8 && shares[2] < 0.25,
        "{shares:?}"
    );
    assert_eq!(Energy::Plain.pull(5.0), 1.0);
}
