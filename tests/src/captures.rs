//! Real captures, from USB bytes to published poses. Where they come from, and what is known about
//! them, is in the shared folder's `captures/SOURCES.md`.

use std::{fs::File, io::Read as _, path::PathBuf};

use flate2::read::MultiGzDecoder;
use glam::{Quat, Vec3};
use posed::commands::inspect::inspect;
use posed_signal::{HostTime, Role, Sample};
use serde_json::Value;

use crate::{
    shared::shared,
    stage::{Run, quantile},
};

const LIGHTHOUSE: &str = "captures/lighthouse";

fn lighthouse(name: &str) -> Option<PathBuf> {
    shared(&format!("{LIGHTHOUSE}/{name}"))
}

fn run(capture: &str, base_stations: &str) -> Option<Run> {
    Some(Run::of_file(
        &lighthouse(capture)?,
        &lighthouse(base_stations)?,
    ))
}

#[test]
fn inspection_tells_what_the_index_capture_holds() {
    let Some(path) = lighthouse("vive-index-cal.pcap.gz") else {
        return;
    };
    let json = inspect(&path).expect("the capture is read").json(&path);
    let devices = json["devices"].as_array().expect("a list of devices");
    let [device] = &devices[..] else {
        panic!("one device, not {}", devices.len())
    };
    assert_eq!(device["serial"], "LHR-DFCF00EE");
    let number = |key: &str| {
        device[key]
            .as_f64()
            .unwrap_or_else(|| panic!("{key} is known"))
    };
    assert!((number("median_accel_g") - 1.002).abs() < 0.005);
    assert!((number("clock_mhz") / 48.0 - 1.0).abs() < 1e-3);
    assert!((number("sweeps") / 37_929.0 - 1.0).abs() < 0.01);
    let config = lighthouse("device-config/config_LHR-DFCF00EE.json").expect("beside the capture");
    let text = std::fs::read_to_string(config).expect("the configuration can be read");
    let expected: Value = serde_json::from_str(&text).expect("the configuration is JSON");
    assert!(
        same(&device["configuration"], &expected),
        "the configuration is the device's own"
    );
}

/// Whether two JSON values are equal, numbers by value: the device writes `-0` where Valve's tool
/// prints `0`.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.as_f64() == b.as_f64(),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
        }
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len()
                && a.iter()
                    .all(|(key, a)| b.get(key).is_some_and(|b| same(a, b)))
        }
        _ => a == b,
    }
}

#[test]
fn a_headset_at_rest_stays_where_it_is() {
    let Some(run) = run("vive-index-cal.pcap.gz", "vive-index-cal.json") else {
        return;
    };
    let device = run.device("LHR-DFCF00EE");
    let poses = run.optical(device.id, 1.0);
    assert!(poses.len() > 3_000, "{} poses", poses.len());
    let squares: f64 = poses
        .iter()
        .map(|pose| f64::from(pose.residual_rad).powi(2))
        .sum();
    let rms = (squares / poses.len() as f64).sqrt();
    let mean = poses.iter().map(|pose| pose.position).sum::<Vec3>() / poses.len() as f32;
    let stray = poses
        .iter()
        .map(|pose| (pose.position - mean).length())
        .fold(0.0, f32::max);
    let up = accelerations_turned(&run, device.id, 1.0);
    let tilt = up.normalize().angle_between(Vec3::Y).to_degrees();
    println!(
        "at rest: residual {rms:.2e} rad, strays {:.3} mm, tilt {tilt:.3} deg",
        stray * 1e3
    );
    assert!(rms < 2e-4, "residual {rms}");
    assert!(stray < 0.5e-3, "strays {stray} m");
    assert!(tilt < 0.3, "tilt {tilt} degrees");
}

/// Sum of the accelerometer's readings, each turned by the pose next in time.
fn accelerations_turned(run: &Run, device: posed_signal::DeviceId, seconds: f64) -> Vec3 {
    let begin = run.span.start.plus_secs(seconds);
    let mut rotation: Option<Quat> = None;
    let mut sum = Vec3::ZERO;
    for (id, sample) in &run.samples {
        match sample {
            Sample::Pose(pose) if *id == device => rotation = Some(pose.rotation),
            Sample::Imu(imu) if *id == device && imu.at >= begin => {
                sum += rotation.map_or(Vec3::ZERO, |rotation| rotation * imu.accel);
            }
            _ => {}
        }
    }
    sum
}

#[test]
fn a_headset_and_two_controllers_are_tracked_to_the_end() {
    let name = "index-hmd-and-two-knuckles";
    let Some(run) = run(&format!("{name}.pcap.gz"), &format!("{name}.json")) else {
        return;
    };
    let [head, left, right] =
        [Role::Head, Role::LeftHand, Role::RightHand].map(|role| run.tracked(role, 3.0));
    println!("tracked: head {head:.4}, left {left:.4}, right {right:.4}");
    assert!(head > 0.99, "head {head}");
    assert!(left > 0.9 && right > 0.9, "left {left}, right {right}");
    let ticks = run.span.seconds() * 90.0;
    assert!(
        (run.poses.len() as f64 - ticks).abs() < 2.0,
        "a pose at every tick to the end"
    );
    assert!(
        run.poses
            .iter()
            .all(posed::published::PublishedPose::is_sound)
    );
}

/// A pose line of a libsurvive recording, in posed's frame: its world is Z-up, so that it is
/// turned by -90 degrees about X.
struct Recorded {
    seconds: f64,
    position: Vec3,
    rotation: Quat,
}

fn recorded_poses(path: &PathBuf, key: &str) -> Vec<Recorded> {
    let mut bytes = Vec::new();
    // The recording is torn: what was read up to there counts.
    let _ = MultiGzDecoder::new(File::open(path).expect("the recording is there"))
        .read_to_end(&mut bytes);
    let turn = Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2);
    let text = String::from_utf8_lossy(&bytes);
    let line = |line: &str| {
        let (head, tail) = line.split_once(key)?;
        let n: Vec<f32> = tail
            .split_whitespace()
            .filter_map(|n| n.parse().ok())
            .collect();
        let &[px, py, pz, qw, qx, qy, qz] = &n[..] else {
            return None;
        };
        Some(Recorded {
            seconds: head.trim().parse().ok()?,
            position: turn * Vec3::new(px, py, pz),
            rotation: turn * Quat::from_xyzw(qx, qy, qz, qw).normalize(),
        })
    };
    text.lines().filter_map(line).collect()
}

#[test]
fn a_tracker_is_where_libsurvive_found_it() {
    let Some(run) = run(
        "tracker-cal-attempt.pcap.gz",
        "tracker-cal-attempt.rec.json",
    ) else {
        return;
    };
    let Some(recording) = lighthouse("tracker-cal-attempt.rec.gz") else {
        return;
    };
    let recorded = recorded_poses(&recording, " replay_WM0 EXTERNAL_POSE ");
    assert!(recorded.len() > 7_000, "{} recorded poses", recorded.len());
    let device = run.device("LHR-BAB3D7B1");
    let poses = run.optical(device.id, 0.0);
    let (mut positions, mut rotations) = (Vec::new(), Vec::new());
    for truth in &recorded {
        let time: HostTime = run.span.start.plus_secs(truth.seconds);
        let next = poses.partition_point(|pose| pose.at < time);
        let Some(pose) = poses.get(next) else {
            continue;
        };
        if pose.at.since_ns(time) < 20_000_000 {
            positions.push(f64::from((pose.position - truth.position).length()) * 1e3);
            rotations.push(f64::from(
                pose.rotation.angle_between(truth.rotation).to_degrees(),
            ));
        }
    }
    assert!(
        positions.len() > recorded.len() / 2,
        "{} can be compared",
        positions.len()
    );
    let [position, rotation] = [&mut positions, &mut rotations].map(|all| quantile(all, 0.5));
    println!("against libsurvive: {position:.2} mm, {rotation:.2} deg in the median");
    assert!(position < 3.0, "{position} mm");
    assert!(rotation < 1.0, "{rotation} degrees");
}
