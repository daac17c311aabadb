//! The embedded capture, whose truth is known, through the whole of posed.

use std::io::{BufRead as _, BufReader};

use flate2::read::GzDecoder;
use glam::{Quat, Vec3};
use posed::{
    assemble::{Assembly, Options, assemble},
    commands::demo::{options, replay},
    pipeline::source::Taken,
};
use posed_body::scene::Scene;
use posed_device::{lighthouse::base_station::parse_libsurvive, transport::Event};
use posed_signal::{HostTime, PoseHow, Role, VirtualClock};
use posed_tracker::TrackerKind;
use serde_json::Value;

use crate::{
    allocation::armed,
    shared::models,
    stage::{Run, quantile},
};

/// True poses of the devices and the body, beside the embedded capture.
static TRUTH: &[u8] = include_bytes!("../assets/demo-truth.jsonl.gz");

/// The base stations of the simulation: with them, poses are in the truth's world.
static BASE_STATIONS: &str = include_str!("../assets/demo-base-stations.json");

/// What tracks the embedded capture where base stations and floor are known.
pub(crate) fn in_a_known_room() -> Options {
    let mut options = options();
    let stations = parse_libsurvive(BASE_STATIONS).expect("the base stations hold");
    options.rig.devices.lighthouse.base_stations = stations;
    options
}

fn run() -> Run {
    Run::of(replay().expect("embedded"), options())
}

/// The lines of the truth.
fn truth() -> Vec<Value> {
    let lines = BufReader::new(GzDecoder::new(TRUTH)).lines();
    let parse = |line: std::io::Result<String>| {
        serde_json::from_str(&line.expect("the truth is whole")).expect("the truth is JSON")
    };
    lines.map(parse).collect()
}

fn numbers<const N: usize>(value: &Value) -> [f32; N] {
    let all = value.as_array().expect("a list");
    std::array::from_fn(|index| all[index].as_f64().expect("a number") as f32)
}

#[test]
fn the_same_capture_gives_the_same_poses() {
    let (first, second) = (run(), run());
    assert!(first.poses.len() > 1_000);
    assert_eq!(first.poses, second.poses);
}

/// Nobody tells where the base stations stand, nor where the floor is.
#[test]
fn the_room_is_found_by_its_light() {
    let run = run();
    assert!(run.warnings.is_empty(), "{:?}", run.warnings);
    for role in [Role::Head, Role::LeftHand, Role::RightHand] {
        let device = run.devices.iter().find(|device| device.role == role);
        let device = device.expect("all are there");
        let from = run.span.start.plus_secs(3.0);
        let poses = run.device_poses(device.id).filter(|pose| pose.at > from);
        let (mut all, mut optical) = (0u32, 0u32);
        for pose in poses {
            all += 1;
            optical += u32::from(pose.how == PoseHow::Optical);
        }
        let share = f64::from(optical) / f64::from(all);
        println!("{role}: {share:.4} of the time tracked");
        assert!(share > 0.99, "{role}: {share}");
    }
    // The wearer stands at first, so that the eyes tell the floor.
    let head = run.devices.iter().find(|device| device.role == Role::Head);
    let at = run.span.start.plus_secs(5.0);
    let mut poses = run.device_poses(head.expect("a headset").id);
    let found = poses
        .find(|pose| pose.at > at)
        .expect("it has poses")
        .position
        .y;
    let truth = truth();
    let later = |line: &&Value| line["role"] == "head" && line["t_ns"].as_u64() > Some(at.0);
    let [_, height, _] = numbers(&truth.iter().find(later).expect("a pose")["position"]);
    println!("headset {found:.3} m up, in truth {height:.3} m");
    assert!((found - height).abs() < 0.05, "{found} {height}");
}

#[test]
fn devices_are_where_they_truly_are() {
    let run = Run::of(replay().expect("embedded"), in_a_known_room());
    let truth = truth();
    for role in [Role::Head, Role::LeftHand, Role::RightHand] {
        let device = run
            .devices
            .iter()
            .find(|device| device.role == role)
            .expect("all are there");
        let poses = run.optical(device.id, 1.0);
        let (mut positions, mut rotations) = (Vec::new(), Vec::new());
        for line in truth.iter().filter(|line| line["role"] == role.name()) {
            let time = HostTime(line["t_ns"].as_u64().expect("a time"));
            let next = poses.partition_point(|pose| pose.at < time);
            let (Some(before), Some(after)) =
                (next.checked_sub(1).map(|n| poses[n]), poses.get(next))
            else {
                continue;
            };
            let span = after.at.since_ns(before.at);
            if span > 20_000_000 {
                continue;
            }
            let share = time.since_ns(before.at) as f32 / span as f32;
            let position = before.position.lerp(after.position, share);
            let rotation = before.rotation.slerp(after.rotation, share);
            let true_position = Vec3::from_array(numbers(&line["position"]));
            let true_rotation = Quat::from_array(numbers(&line["rotation"]));
            positions.push(f64::from((position - true_position).length()) * 1e3);
            rotations.push(f64::from(
                rotation.angle_between(true_rotation).to_degrees(),
            ));
        }
        assert!(
            positions.len() > 1_000,
            "{role}: {} can be compared",
            positions.len()
        );
        let [p50, p99] = [0.5, 0.99].map(|share| quantile(&mut positions, share));
        let [r50, r99] = [0.5, 0.99].map(|share| quantile(&mut rotations, share));
        println!("{role}: median {p50:.2} mm {r50:.3} deg, p99 {p99:.2} mm {r99:.3} deg");
        assert!(p50 < 2.0 && p99 < 10.0, "{role}: {p50} mm, {p99} mm");
        assert!(
            r50 < 0.2 && r99 < 1.0,
            "{role}: {r50} degrees, {r99} degrees"
        );
    }
}

#[test]
fn the_tracker_loop_does_not_allocate() {
    ticks_without_allocating(options());
    // ONNX Runtime allocates in C++, out of this allocator's sight; the rest of the tracker is
    // Rust.
    let tracker = models()
        .tracker(TrackerKind::HmdNemo, &Scene::default())
        .expect("the model fits")
        .expect("built in");
    ticks_without_allocating(Options {
        trackers: vec![tracker],
        tracker: TrackerKind::HmdNemo,
        ..options()
    });
}

/// Replays the embedded capture and looks at every tick of the tracker loop.
fn ticks_without_allocating(options: Options) {
    let kind = options.tracker;
    let Assembly {
        mut source,
        mut tracker,
        ..
    } = assemble(Box::new(replay().expect("embedded")), options);
    let (mut ticks, mut full, mut next) = (0u32, 0u32, None);
    loop {
        let event = source.next(0);
        if let Event::Packet(packet) = &event {
            let due = *next.get_or_insert(packet.at);
            if packet.at > due {
                next = Some(due.plus_secs(1.0 / 90.0));
                source.tick(due);
                let clock = VirtualClock::new(due);
                let (pose, allocations) = armed(|| tracker.tick(&clock, &mut |_, _| {}));
                assert_eq!(allocations, 0, "{kind:?}, tick {ticks}, {:?}", pose.quality);
                ticks += 1;
                full += u32::from(pose.kind == kind);
            }
        }
        if source.take(event) == Taken::End {
            break;
        }
    }
    assert!(ticks > 1_000, "{ticks} ticks");
    assert!(full > ticks / 2, "{kind:?} made {full} of {ticks} poses");
}
