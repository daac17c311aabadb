//! Golden vectors of the training side replayed, and what must hold whatever the weights say.

use std::path::Path;

use glam::{Quat, Vec3};
use posed_body::{JOINTS, Joint};
use posed_signal::{Lookup, Orientation, Pose, PoseHow};
use serde::Deserialize;

use super::{
    features::FEATURES,
    sensors::{Reading, SENSORS, Seen},
    *,
};
use crate::{golden::close, inference::shared_runtime, tracker::NO_INERTIAL};

/// Untrained networks of the smallest size, and what PyTorch makes of a made-up motion with them;
/// written by policy/training/fixtures/tiny_pip.py.
const TINY: &[u8] = include_bytes!("../../tests/data/pip_tiny.onnx");
const TINY_GOLDEN: &str = include_str!("../../tests/data/pip_tiny.golden.json");

#[derive(Deserialize)]
struct Golden {
    frames: usize,
    head_height: f32,
    sensor_rotation: Vec<f32>,
    sensor_acceleration: Vec<f32>,
    seen: Vec<u8>,
    features: Vec<f32>,
    first_leaves: Vec<f32>,
    rotations: Vec<f32>,
    velocities: Vec<f32>,
    contact: Vec<f32>,
}

impl Golden {
    fn seen(&self, frame: usize) -> Seen {
        Seen(std::array::from_fn(|sensor| {
            let index = SENSORS * frame + sensor;
            (self.seen[index] == 1).then(|| Reading {
                turn: Quat::from_slice(&self.sensor_rotation[4 * index..]),
                accel: Vec3::from_slice(&self.sensor_acceleration[3 * index..]),
            })
        }))
    }
}

/// Largest differences may grow over a recurrent run, so the bound is on each number's size.
fn replay(model: &[u8], golden: &str) {
    let golden: Golden = serde_json::from_str(golden).unwrap();
    let mut network = Step::load(&shared_runtime(), "golden", model).unwrap();
    let mut first = [0.0; features::LEAF_NUMBERS];
    first.copy_from_slice(&golden.first_leaves);
    network.begin(first);
    for frame in 0..golden.frames {
        let seen = golden.seen(frame);
        let mut features = [0.0; FEATURES];
        features::write(&seen, golden.head_height, &mut features);
        let wanted = &golden.features[FEATURES * frame..FEATURES * (frame + 1)];
        close("feature", frame, &features, wanted, 1e-3);
        let answer = network.run(&seen, golden.head_height).unwrap();
        let pelvis = seen.pelvis();
        let turns = world_rotations(&answer.pose);
        for (index, joint) in network::PREDICTED.into_iter().enumerate() {
            let wanted = Quat::from_slice(&golden.rotations[(15 * frame + index) * 4..]);
            let found = turns[joint as usize];
            let off = found.angle_between((pelvis * wanted).normalize());
            assert!(off < 5e-3, "{joint:?} of frame {frame} is {off} rad off");
        }
        for joint in 0..JOINTS {
            let wanted = Vec3::from_slice(&golden.velocities[(JOINTS * frame + joint) * 3..]);
            let found = pelvis.inverse() * answer.velocities[joint] / golden.head_height;
            close(
                "velocity",
                frame,
                &found.to_array(),
                &wanted.to_array(),
                2e-3,
            );
        }
        close(
            "contact",
            frame,
            &answer.contact,
            &golden.contact[2 * frame..],
            2e-3,
        );
    }
}

fn world_rotations(pose: &BodyPose) -> [Quat; JOINTS] {
    let mut world = pose.rotations;
    for joint in Joint::ALL {
        if let Some(parent) = joint.parent() {
            world[joint as usize] = world[parent as usize] * pose.rotations[joint as usize];
        }
    }
    world
}

#[test]
fn the_small_example_agrees_with_pytorch() {
    replay(TINY, TINY_GOLDEN);
}

#[test]
fn the_models_that_ship_agree_with_pytorch() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    for name in ["pip_small", "pip_full"] {
        let Ok(model) = std::fs::read(folder.join(format!("{name}.onnx"))) else {
            continue;
        };
        let golden = std::fs::read_to_string(folder.join(format!("{name}.golden.json")));
        replay(
            &model,
            &golden.expect("a model ships with its golden vectors"),
        );
    }
}

/// A wearer of six sensors in front of the tracker.
struct Stage {
    tracker: Pip,
    wearer: Wearer,
    parts: [Lookup<Pose>; Role::COUNT],
    inertial: [Lookup<Orientation>; Role::COUNT],
}

const WORN: [Role; SENSORS] = [
    Role::LeftWrist,
    Role::RightWrist,
    Role::LeftKnee,
    Role::RightKnee,
    Role::Head,
    Role::Waist,
];

impl Stage {
    fn new(options: Options) -> Self {
        Self {
            tracker: Pip::load(&shared_runtime(), "tiny", TINY, options).unwrap(),
            wearer: Wearer::of_height(1.75),
            parts: [Lookup::Empty; Role::COUNT],
            inertial: NO_INERTIAL,
        }
    }

    /// Somebody who turns about and swings the arms, `t` seconds in.
    fn show(&mut self, t: f32) {
        let turn = Quat::from_rotation_y(0.5 * t.sin());
        for role in WORN {
            let swing = match role {
                Role::LeftWrist => Quat::from_rotation_z(1.2 + 0.3 * (3.0 * t).sin()),
                Role::RightWrist => Quat::from_rotation_z(-1.2 + 0.3 * (3.0 * t).sin()),
                Role::LeftKnee => Quat::from_rotation_x(0.2 * (2.0 * t).sin()),
                _ => Quat::IDENTITY,
            };
            self.inertial[role as usize] = Lookup::Exact(Orientation {
                at: HostTime(0),
                rotation: (turn * swing).normalize(),
                accel: Vec3::new(0.3 * (5.0 * t).sin(), 0.1, 0.0),
                angular_velocity: Vec3::ZERO,
            });
        }
    }

    fn lose(&mut self, roles: &[Role]) {
        for &role in roles {
            self.inertial[role as usize] = Lookup::Empty;
        }
    }

    fn tick(&mut self, seconds: f64) -> Tracked {
        let input = Input {
            target: HostTime::from_secs_f64(10.0 + seconds),
            parts: &self.parts,
            inertial: &self.inertial,
            wearer: &self.wearer,
        };
        let tracked = self.tracker.track(&input);
        assert!(tracked.pose.is_sound());
        tracked
    }
}

fn farthest(a: &BodyPose, b: &BodyPose) -> f32 {
    let turns = a.rotations.iter().zip(&b.rotations);
    turns
        .map(|(a, b)| a.angle_between(*b))
        .fold(a.root.distance(b.root), f32::max)
}

#[test]
fn six_sensors_make_a_body_with_forces() {
    let mut stage = Stage::new(Options::default());
    for frame in 0..120u16 {
        let t = f64::from(frame) / 60.0;
        stage.show(t as f32);
        let tracked = stage.tick(t);
        assert_eq!(
            (tracked.kind, tracked.quality),
            (TrackerKind::Pip, Quality::Full)
        );
        assert!(tracked.forces.is_some_and(|forces| forces.is_sound()));
    }
}

#[test]
fn between_steps_the_motion_has_no_jumps() {
    for rate in [72.0, 90.0, 144.0, 500.0] {
        let mut stage = Stage::new(Options::default());
        let mut last: Option<BodyPose> = None;
        let mut moved = 0.0f32;
        for frame in 0..(rate as u32 * 2) {
            let t = f64::from(frame) / rate;
            stage.show(t as f32);
            let pose = stage.tick(t).pose;
            if let Some(last) = last.filter(|_| t > 0.5) {
                moved = moved.max(farthest(&last, &pose) * rate as f32);
            }
            last = Some(pose);
        }
        assert!(
            moved < 12.0,
            "at {rate} Hz something moves at {moved} a second"
        );
    }
}

#[test]
fn silent_sensors_are_bridged_and_too_few_give_way_to_ik() {
    let mut stage = Stage::new(Options::default());
    let mut last: Option<BodyPose> = None;
    for frame in 0..300u16 {
        let t = f64::from(frame) / 60.0;
        stage.show(t as f32);
        let (quality, kind) = match frame {
            100..150 => {
                stage.lose(&[Role::Waist, Role::LeftWrist]);
                (Quality::Partial, TrackerKind::Pip)
            }
            200..250 => {
                stage.lose(&[Role::LeftKnee, Role::RightKnee, Role::Head]);
                (Quality::Held, TrackerKind::Ik)
            }
            _ => (Quality::Full, TrackerKind::Pip),
        };
        let tracked = stage.tick(t);
        assert_eq!(
            (tracked.quality, tracked.kind),
            (quality, kind),
            "frame {frame}"
        );
        if let Some(last) = last
            && frame < 200
        {
            let step = farthest(&last, &tracked.pose);
            assert!(step < 0.35, "{step} in frame {frame}");
        }
        last = Some(tracked.pose);
    }
}

#[test]
fn a_headset_holds_the_body_where_it_is() {
    let mut stage = Stage::new(Options::default());
    let place = |t: f32| Vec3::new(0.3 * t, 1.45, -0.2);
    for frame in 0..180u16 {
        let t = f64::from(frame) / 60.0;
        stage.show(t as f32);
        let head = Pose {
            position: place(t as f32),
            rotation: stage.inertial[Role::Head as usize]
                .value()
                .unwrap()
                .rotation,
            how: PoseHow::Optical,
            ..Pose::unknown(HostTime(0))
        };
        stage.parts[Role::Head as usize] = Lookup::Exact(head);
        let tracked = stage.tick(t);
        let joints = stage.wearer.skeleton.forward(&tracked.pose);
        if frame > 60 {
            let off = joints.position(Joint::Head).distance(place(t as f32));
            assert!(off < 0.1, "{off} m in frame {frame}");
        }
    }
}

#[test]
fn the_same_input_gives_the_same_poses_and_a_reset_forgets() {
    let run = |stage: &mut Stage| {
        let poses: Vec<BodyPose> = (0..60u16)
            .map(|frame| {
                let t = f64::from(frame) / 60.0;
                stage.show(t as f32);
                stage.tick(t).pose
            })
            .collect();
        poses
    };
    let mut stage = Stage::new(Options::default());
    let first = run(&mut stage);
    stage.tracker.reset();
    assert_eq!(first, run(&mut stage));
}

#[test]
fn a_known_pose_is_where_the_body_begins() {
    for physics in [Physics::DualPd, Physics::RotationsOnly, Physics::Off] {
        let mut stage = Stage::new(Options { physics });
        stage.show(0.0);
        let mut known = BodyPose::rest(Vec3::new(2.0, 0.0, -1.0));
        known.root.y = -lowest(&stage.wearer, &known) + 0.02;
        stage.tracker.begin(&known);
        let pose = stage.tick(0.0).pose;
        let flat = Vec3::new(1.0, 0.0, 1.0);
        assert!((pose.root * flat).distance(known.root * flat) < 1e-3);
    }
}

fn lowest(wearer: &Wearer, pose: &BodyPose) -> f32 {
    let joints = wearer.skeleton.forward(pose);
    let heights = joints.positions.iter().map(|place| place.y);
    heights.fold(f32::INFINITY, f32::min)
}
