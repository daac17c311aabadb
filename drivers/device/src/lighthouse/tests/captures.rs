//! The shared captures: what they hold, and how well their devices are tracked.

use std::{
    collections::BTreeMap,
    env,
    fs::{self, File},
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use flate2::read::MultiGzDecoder;
use glam::{DQuat, DVec3};
use posed_signal::{Pose, PoseHow};
use serde_json::Value;

use super::{
    super::{
        ImuClass, Settings, Variant,
        base_station::{from_z_up, parse_libsurvive},
        decoder,
        inspect::{Inspector, Report},
        model::{DeviceModel, ImuRange},
        reader::{Event, Reader},
    },
    Tracked, quantile,
};
use crate::{
    capture::{Item, open},
    decode::Decoder,
    usb::{Packet, Port},
};

/// The captures under `$POSED_SHARED/captures/lighthouse`, or `None` where there are none.
pub(super) fn captures(test: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = env::var_os("POSED_SHARED").map_or_else(beside, PathBuf::from);
    let captures = shared.join("captures/lighthouse");
    if !captures.is_dir() {
        println!("SKIPPED (needs shared data): {test}");
        return None;
    }
    Some(captures)
}

pub(super) fn packets(path: &Path) -> Vec<Packet> {
    let items = open(File::open(path).unwrap()).unwrap();
    items
        .filter_map(|item| match item {
            Item::Packet(packet) => Some(packet),
            _ => None,
        })
        .collect()
}

/// Reports of the devices that have inertial samples, by serial number.
fn inspected(path: &Path) -> BTreeMap<String, Report> {
    let mut inspectors = BTreeMap::<Port, Inspector>::new();
    for packet in packets(path) {
        let fresh = || Inspector::new(None);
        inspectors
            .entry(packet.port)
            .or_insert_with(fresh)
            .packet(&packet);
    }
    let reports = inspectors.values().map(Inspector::report);
    reports
        .filter(|report| report.imu_samples > 0)
        .map(|report| (report.serial.clone().unwrap_or_default(), report))
        .collect()
}

/// Every device of a capture, tracked; time counts from the capture's first packet.
pub(super) fn tracked(path: &Path, stations: &Path) -> (f64, Vec<Tracked>) {
    let base_stations = parse_libsurvive(&fs::read_to_string(stations).unwrap()).unwrap();
    let settings = Settings {
        base_stations,
        ..Settings::default()
    };
    let mut devices = BTreeMap::<Port, (Box<dyn Decoder>, Tracked)>::new();
    let packets = packets(path);
    for packet in &packets {
        let variant = Variant::Wired(ImuClass::Headset);
        let fresh = || (decoder(variant, &settings), Tracked::default());
        let (decoder, tracked) = devices.entry(packet.port).or_insert_with(fresh);
        let _ = decoder.packet(packet, tracked);
    }
    let found = devices.into_values().map(|(_, tracked)| tracked);
    let begin = packets[0].at.as_secs_f64();
    (
        begin,
        found.filter(|tracked| !tracked.imu.is_empty()).collect(),
    )
}

#[test]
fn the_index_headset_is_inspected() {
    let Some(captures) = captures("the_index_headset_is_inspected") else {
        return;
    };
    let reports = inspected(&captures.join("vive-index-cal.pcap.gz"));
    let report = &reports["LHR-DFCF00EE"];
    // SOURCES.md counts slot by slot; where a report has its newest sample first that loses two.
    assert_eq!(report.imu_samples_in_slot_order, 19_239);
    assert_eq!(report.imu_samples, 19_409);
    assert_eq!(report.imu_samples_out_of_slot_order(), 170);
    assert!((report.median_accel_g.unwrap() - 1.002).abs() < 0.005);
    assert!((report.clock_hz.unwrap() / 48e6 - 1.0).abs() < 1e-3);
    assert_eq!(report.sweeps, 37_929);
    assert_eq!(report.channels.keys().copied().collect::<Vec<_>>(), [6, 9]);
    assert!((report.channels[&6].rotor_hz.unwrap() - 51.009_6).abs() < 1e-3);
    assert_eq!(report.errors, 0);
    let json = |text: &str| serde_json::from_str::<Value>(text).unwrap();
    let published = captures.join("device-config/config_LHR-DFCF00EE.json");
    let published = json(&fs::read_to_string(published).unwrap());
    assert!(same(
        &json(report.configuration.as_ref().unwrap()),
        &published
    ));
}

/// Equality of JSON in which -0 equals 0.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.as_f64() == b.as_f64(),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
        }
        (Value::Object(a), Value::Object(b)) => {
            let equal = |(key, value): (&String, _)| b.get(key).is_some_and(|b| same(value, b));
            a.len() == b.len() && a.iter().all(equal)
        }
        _ => a == b,
    }
}

/// Inertial samples of every capture: as SOURCES.md counts them where the device is wired, and at
/// least as many by radio, where those counts leave out packets with metadata.
#[test]
fn every_capture_has_its_inertial_samples() {
    let Some(captures) = captures("every_capture_has_its_inertial_samples") else {
        return;
    };
    for (name, serial, wired, counted) in [
        ("vive-index-cal", "LHR-DFCF00EE", true, 19_239),
        ("vive_cal", "LHR-D8EC5307", true, 21_582),
        ("vive_cal", "LHR-FFEFF945", false, 1_489),
        ("index-lhv1", "LHR-A824C054", true, 10_173),
        ("wand-wired-all-buttons", "LHR-FFEFF945", true, 4_325),
        ("tracker-gen1-wired-buttons", "LHR-01B7ABC0", true, 1_152),
        ("tracker-cal-attempt", "LHR-BAB3D7B1", false, 15_219),
        ("wireless-tracker", "LHR-01B7ABC0", false, 3_083),
        ("knuckles_all_buttons", "LHR-6CEC0524", false, 8_689),
        ("index-hmd-and-two-knuckles", "LHR-A824C054", true, 22_131),
        ("index-hmd-and-two-knuckles", "LHR-EF5A905D", false, 5_000),
        ("index-hmd-and-two-knuckles", "LHR-48A54FB6", false, 5_000),
    ] {
        let reports = inspected(&captures.join(format!("{name}.pcap.gz")));
        let report = &reports[serial];
        if wired {
            assert_eq!(report.imu_samples_in_slot_order, counted, "{name} {serial}");
        } else {
            let share = report.imu_samples as f64 / counted as f64;
            assert!(
                (1.0..1.1).contains(&share),
                "{name} {serial}: {}",
                report.imu_samples
            );
        }
        let clock = report.clock_hz.unwrap();
        assert!(
            (clock / 48e6 - 1.0).abs() < 1e-3,
            "{name} {serial}: {clock}"
        );
        assert!(
            (report.median_accel_g.unwrap() - 1.0).abs() < 0.02,
            "{name} {serial}"
        );
        assert_eq!(
            report.errors, 0,
            "{name} {serial}: {:?}",
            report.first_error
        );
    }
}

/// The mean of what a resting headset's accelerometer reads, in the head frame, m/s^2. Its factory
/// bias is left out: the base stations' file was levelled by this accelerometer without it.
fn force_at_rest(path: &Path) -> DVec3 {
    let (mut reader, mut events) = (Reader::default(), Vec::new());
    let mut model = None;
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for packet in packets(path) {
        let _ = reader.packet(&packet, &mut events);
        for event in events.drain(..) {
            match event {
                Event::Configuration(text) => model = Some(DeviceModel::from_json(&text).unwrap()),
                Event::Imu { raw, .. } => {
                    let force = DVec3::from(raw.accel.map(f64::from)) * ImuRange::headset().accel;
                    let Some(model) = &model else { continue };
                    sum += model.head.rotation.conjugate() * force;
                    count += 1.0;
                }
                _ => {}
            }
        }
    }
    sum / count
}

#[test]
fn a_headset_at_rest_stays_where_it_is() {
    let Some(captures) = captures("a_headset_at_rest_stays_where_it_is") else {
        return;
    };
    let path = captures.join("vive-index-cal.pcap.gz");
    let (_, devices) = tracked(&path, &captures.join("vive-index-cal.json"));
    let [device] = &devices[..] else {
        panic!("one device")
    };
    let first = device.poses[0].at;
    let settled = || {
        device
            .poses
            .iter()
            .filter(|pose| pose.at.since_secs(first) > 1.0)
    };
    assert!(settled().all(|pose| pose.how == PoseHow::Optical));
    assert!(settled().count() > 8_000);
    assert!(settled().all(|pose| pose.residual_rad < 2e-4));
    let count = settled().count() as f64;
    let mean = settled()
        .map(|pose| pose.position.as_dvec3())
        .sum::<DVec3>()
        / count;
    let off = |pose: &Pose| (pose.position.as_dvec3() - mean).length();
    assert!(settled().map(off).fold(0.0, f64::max) < 5e-4);
    let square = settled().map(|pose| off(pose).powi(2)).sum::<f64>() / count;
    assert!(square.sqrt() < 1.5e-4, "{}", square.sqrt());
    // The accelerometer knows nothing of the light: turned by the pose, it points up.
    let force = force_at_rest(&path);
    let up = settled()
        .map(|pose| pose.rotation.as_dquat() * force)
        .sum::<DVec3>();
    let tilt = up.angle_between(DVec3::Y).to_degrees();
    assert!(tilt < 0.15, "{tilt}");
    // So do the calibrated samples, whose bias is estimated.
    let turn = device.poses[device.poses.len() / 2].rotation;
    let late = device
        .imu
        .iter()
        .filter(|imu| imu.at.since_secs(first) > 1.0);
    let up = late.map(|imu| (turn * imu.accel).as_dvec3()).sum::<DVec3>();
    let tilt = up.angle_between(DVec3::Y).to_degrees();
    assert!(tilt < 0.3, "{tilt}");
}

/// libsurvive's own poses of a device in a recording: time (s), position and rotation in posed's
/// world.
fn survive_poses(path: &Path, device: &str) -> Vec<(f64, DVec3, DQuat)> {
    let lines = BufReader::new(MultiGzDecoder::new(File::open(path).unwrap())).lines();
    let mut poses = Vec::new();
    for line in lines.map_while(Result::ok) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [time, name, "EXTERNAL_POSE", numbers @ ..] = &words[..] else {
            continue;
        };
        if *name != device {
            continue;
        }
        let numbers: Vec<f64> = numbers.iter().map(|word| word.parse().unwrap()).collect();
        let [x, y, z, qw, qx, qy, qz] = numbers[..] else {
            panic!("{line}")
        };
        let turn = from_z_up();
        let rotation = turn * DQuat::from_xyzw(qx, qy, qz, qw);
        poses.push((time.parse().unwrap(), turn * DVec3::new(x, y, z), rotation));
    }
    poses
}

#[test]
fn a_tracker_by_radio_is_where_libsurvive_has_it() {
    let Some(captures) = captures("a_tracker_by_radio_is_where_libsurvive_has_it") else {
        return;
    };
    let path = captures.join("tracker-cal-attempt.pcap.gz");
    let (begin, devices) = tracked(&path, &captures.join("tracker-cal-attempt.rec.json"));
    let [device] = &devices[..] else {
        panic!("one device")
    };
    let poses = survive_poses(&captures.join("tracker-cal-attempt.rec.gz"), "replay_WM0");
    let time = |pose: &Pose| pose.at.as_secs_f64() - begin;
    let (mut metres, mut degrees) = (Vec::new(), Vec::new());
    for (at, position, rotation) in poses {
        let after = device.poses.partition_point(|pose| time(pose) < at);
        let Some(ours) = device
            .poses
            .get(after)
            .filter(|ours| time(ours) - at < 0.02)
        else {
            continue;
        };
        metres.push((ours.position.as_dvec3() - position).length());
        degrees.push(
            ours.rotation
                .as_dquat()
                .angle_between(rotation)
                .to_degrees(),
        );
    }
    assert!(metres.len() > 7_000, "{}", metres.len());
    let (metres, degrees) = (
        quantile(metres.into_iter(), 0.5),
        quantile(degrees.into_iter(), 0.5),
    );
    assert!(
        metres < 1.2e-3 && degrees < 0.5,
        "{metres} m, {degrees} degrees"
    );
}

#[test]
fn a_headset_and_two_controllers_are_tracked_to_the_end() {
    let test = "a_headset_and_two_controllers_are_tracked_to_the_end";
    let Some(captures) = captures(test) else {
        return;
    };
    let path = captures.join("index-hmd-and-two-knuckles.pcap.gz");
    let stations = captures.join("index-hmd-and-two-knuckles.json");
    let (begin, devices) = tracked(&path, &stations);
    let serials: Vec<_> = devices
        .iter()
        .map(|device| device.serial.as_str())
        .collect();
    assert_eq!(serials, ["LHR-A824C054", "LHR-EF5A905D", "LHR-48A54FB6"]);
    for device in &devices {
        let late = |pose: &&Pose| pose.at.as_secs_f64() - begin > 3.0;
        let poses: Vec<&Pose> = device.poses.iter().filter(late).collect();
        assert!(poses.last().unwrap().at.as_secs_f64() - begin > 22.9);
        assert!(
            poses.iter().all(|pose| pose.how == PoseHow::Optical),
            "{}",
            device.serial
        );
        for pair in poses.windows(2) {
            let dt = pair[1].at.since_secs(pair[0].at) as f32;
            assert!(dt < 0.1, "{}: a gap of {dt} s", device.serial);
            let moved = 0.5 * dt * (pair[0].velocity + pair[1].velocity);
            let jump = (pair[1].position - pair[0].position - moved).length();
            assert!(
                jump < 2e-3,
                "{}: a jump of {jump} m at {}",
                device.serial,
                pair[1].at.0
            );
        }
    }
    // The same bytes give the same poses.
    let (_, again) = tracked(&path, &stations);
    for (device, again) in devices.iter().zip(&again) {
        assert!(device.poses == again.poses && device.imu == again.imu);
    }
}
