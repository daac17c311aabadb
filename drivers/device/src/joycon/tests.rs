//! Recordings of real devices, with the figures of `captures/SOURCES.md`.

use std::{fs::File, path::PathBuf};

use posed_signal::{Imu, Orientation, Sample};

use super::{decoder::Device, inspect::Inspector, wire};
use crate::{
    capture::{Item, open},
    decode::{Decoder as _, Emit, Identity},
    usb::{Packet, Port, Transfer},
};

/// The recording's path, or `None` (and a line that says so) where the shared data is missing.
fn recording(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("POSED_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = shared.join("captures/joycon/trace").join(name);
    if !path.exists() {
        println!("SKIPPED (needs shared data): {}", path.display());
        return None;
    }
    Some(path)
}

fn packets(path: &PathBuf) -> Vec<Packet> {
    open(File::open(path).unwrap())
        .unwrap()
        .filter_map(|item| match item {
            Item::Packet(packet) => Some(packet),
            Item::Device(..) | Item::Warning(_) => None,
        })
        .collect()
}

#[derive(Default)]
struct Found {
    identities: Vec<Identity>,
    imu: Vec<Imu>,
    orientations: Vec<Orientation>,
}

impl Emit for Found {
    fn identity(&mut self, _unit: usize, identity: Identity) {
        self.identities.push(identity);
    }

    fn sample(&mut self, _unit: usize, sample: Sample) {
        match sample {
            Sample::Imu(imu) => self.imu.push(imu),
            Sample::Orientation(orientation) => self.orientations.push(orientation),
            _ => {}
        }
    }
}

fn decode(packets: &[Packet]) -> Found {
    let (mut device, mut found) = (Device::default(), Found::default());
    for packet in packets {
        device.packet(packet, &mut found).unwrap();
    }
    found
}

/// yamakaky-joy's `procontroller.log` (MIT), 704 reports of 0x30.
#[test]
fn a_pro_controller_measures_gravity() {
    let Some(path) = recording("procontroller.log") else {
        return;
    };
    let packets = packets(&path);
    let mut inspector = Inspector::default();
    packets.iter().for_each(|packet| inspector.packet(packet));
    let report = inspector.report();
    assert_eq!((report.full_reports, report.errors), (704, 0));
    assert!((report.rate_hz.unwrap() - 68.4).abs() < 0.1, "{report:?}");
    assert!(
        (report.median_accel_g.unwrap() - 1.0188).abs() < 5e-5,
        "{report:?}"
    );
    assert_eq!(report.calibration, super::calibration::Origin::User);
    assert_eq!(report.model, Some("Pro Controller"));

    let found = decode(&packets);
    assert_eq!(found.identities[0].serial.as_str(), "0403D6C517DC");
    assert_eq!(found.imu.len() as u64, report.imu_samples);
    assert_eq!(found.imu.len(), found.orientations.len());
    for pair in found.imu.windows(2) {
        let step = pair[1].at.since_ns(pair[0].at);
        assert!((1..80_000_000).contains(&step), "{step} ns");
    }
    // It lies still in somebody's hand: what is left of gravity is small, and up is up.
    let mut left: Vec<f32> = found
        .orientations
        .iter()
        .map(|o| o.accel.length())
        .collect();
    left.sort_unstable_by(f32::total_cmp);
    assert!(left[left.len() / 2] < 0.6, "{}", left[left.len() / 2]);
}

/// All the others set packed rotations: their accelerometers are at 1 g, and nothing of theirs is
/// taken for a gyroscope.
#[test]
fn packed_rotations_are_no_gyroscope() {
    for (name, reports) in [
        ("joycon_l.log", 317),
        ("homescreen.log", 219),
        ("ringcon.log", 555),
        ("ringcon-longer.log", 11_759),
        ("ringfit-multiple-connect.log", 5_990),
        ("ringfit-save-offline-steps.log", 4_110),
    ] {
        let Some(path) = recording(name) else { return };
        let packets = packets(&path);
        let mut inspector = Inspector::default();
        packets.iter().for_each(|packet| inspector.packet(packet));
        let report = inspector.report();
        assert_eq!(
            (report.full_reports, report.imu_samples),
            (reports, 0),
            "{name}"
        );
        let g = report.median_accel_g.unwrap();
        assert!((g - 1.0).abs() < 0.03, "{name}: {g}");
        let found = decode(&packets);
        assert!(
            found.imu.is_empty() && found.orientations.is_empty(),
            "{name}"
        );
        assert_eq!(found.identities.len(), 1, "{name}");
    }
}

fn report(id: u8, timer: u8, tail: &[u8]) -> Packet {
    let mut data = vec![id, timer, 0x8e];
    data.resize(13, 0);
    data.extend(tail);
    data.resize(49, 0);
    Packet {
        at: posed_signal::HostTime(u64::from(timer) * 5_000_000 + 1_000_000_000),
        port: Port { bus: 1, address: 1 },
        endpoint: 0x81,
        transfer: Transfer::Interrupt,
        data,
    }
}

#[test]
fn the_mode_counts_from_the_devices_answer_on() {
    let output = |mode: u8| Packet {
        endpoint: 0x01,
        data: wire::subcommand(1, wire::SET_IMU, &[mode]),
        ..report(0x21, 0, &[])
    };
    let answer = |timer| report(0x21, timer, &[0x80, wire::SET_IMU]);
    let one = [0, 0, 0, 16, 0, 0, 1, 0, 2, 0, 3, 0];
    let full = |timer| report(0x30, timer, &[one, one, one].concat());
    let sequence = [
        (full(3), 0),
        (output(1), 0),
        (full(6), 0),
        (answer(8), 0),
        (full(9), 3),
        (output(3), 3),
        (full(12), 3),
        (answer(13), 3),
        (full(15), 3),
    ];
    let (mut device, mut found) = (Device::default(), Found::default());
    for (index, (packet, samples)) in sequence.iter().enumerate() {
        device.packet(packet, &mut found).unwrap();
        assert_eq!(found.imu.len(), *samples, "after packet {index}");
    }
}

#[test]
fn a_device_is_asked_until_it_reports() {
    let mut device = Device::default();
    let mut commands = Vec::new();
    let at = |ms: u64| posed_signal::HostTime(1_000_000_000 + ms * 1_000_000);
    device.tick(at(0), &mut commands);
    assert!(commands.is_empty(), "over the air it speaks by itself");
    device.tick(at(700), &mut commands);
    assert_eq!(commands.len(), 2, "on a cable it waits to be greeted");
    let mut asked = Vec::new();
    let answers: [&[u8]; 4] = [
        &[0x82, 0x02, 4, 7, 1, 2, 1, 2, 3, 4, 5, 6, 1, 1],
        &[0x90, 0x10, 0x20, 0x60, 0, 0, 24],
        &[0x90, 0x10, 0x26, 0x80, 0, 0, 26],
        &[0x80, 0x40],
    ];
    device
        .packet(&report(0x3f, 0, &[]), &mut Found::default())
        .unwrap();
    for (step, answer) in answers.iter().enumerate() {
        commands.clear();
        device.tick(at(1_000 + 200 * step as u64), &mut commands);
        let crate::decode::Command::Output { data, .. } = &commands[0] else {
            panic!("{commands:?}")
        };
        asked.push(data[10]);
        let output = Packet {
            endpoint: 0x01,
            data: data.clone(),
            ..report(0x21, 0, &[])
        };
        device.packet(&output, &mut Found::default()).unwrap();
        let mut reply = answer.to_vec();
        reply.resize(36, 0xff);
        device
            .packet(&report(0x21, 0, &reply), &mut Found::default())
            .unwrap();
    }
    assert_eq!(
        asked,
        [
            wire::DEVICE_INFO,
            wire::FLASH_READ,
            wire::FLASH_READ,
            wire::SET_IMU
        ]
    );
    commands.clear();
    device.tick(at(3_000), &mut commands);
    assert_eq!(commands.len(), 1, "full reports are still missing");
    device
        .packet(&report(0x30, 9, &[0; 36]), &mut Found::default())
        .unwrap();
    commands.clear();
    device.tick(at(4_000), &mut commands);
    assert!(commands.is_empty());
}
