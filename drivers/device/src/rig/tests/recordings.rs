//! Shared real captures, replayed into a rig: which devices come of them, and that two replays
//! give the same.

use std::{fs, path::Path};

use super::super::*;
use crate::{
    capture::{
        identity::parse_usbdevs,
        open,
        tests::shared::{captures, file},
    },
    transport::{Event, Merge, Recording, Replay, Transport},
};

/// A capture, and the serial numbers and roles of the devices in it, in the order in which they
/// tell their configuration.
struct Expected(&'static str, &'static [(&'static str, Role)]);

const CAPTURES: &[Expected] = &[
    Expected(
        "lighthouse/vive-index-cal.pcap.gz",
        &[("LHR-DFCF00EE", Role::Head)],
    ),
    Expected(
        "lighthouse/tracker-cal-attempt.pcap.gz",
        &[("LHR-BAB3D7B1", Role::None)],
    ),
    Expected(
        "lighthouse/index-hmd-and-two-knuckles.pcap.gz",
        &[
            ("LHR-48A54FB6", Role::RightHand),
            ("LHR-EF5A905D", Role::LeftHand),
            ("LHR-A824C054", Role::Head),
        ],
    ),
    Expected(
        "lighthouse/vive_cal.pcap.gz",
        &[("LHR-D8EC5307", Role::Head), ("LHR-FFEFF945", Role::None)],
    ),
    Expected(
        "lighthouse/wand-wired-all-buttons.pcap.gz",
        &[("LHR-FFEFF945", Role::None)],
    ),
    // These do not say which devices they hold: their reports have to.
    Expected(
        "lighthouse-redox/system--03",
        &[("LHR-C5C0BC88", Role::Head)],
    ),
    Expected(
        "lighthouse-redox/system--04",
        &[("LHR-F7EFD942", Role::None), ("LHR-FDE71D46", Role::None)],
    ),
];

fn replay(path: &Path) -> (Rig, Vec<Sample>) {
    let name = path.to_string_lossy().into_owned();
    let list = name
        .split(".pcap")
        .next()
        .map(|stem| format!("{stem}.usbdevs"));
    let list = list
        .and_then(|list| fs::read_to_string(list).ok())
        .unwrap_or_default();
    let reader = open(fs::File::open(path).unwrap()).unwrap();
    let recording = Recording {
        name,
        reader,
        devices: parse_usbdevs(&list),
    };
    let mut replay = Replay::new(vec![recording], Merge::OneSession);
    let (mut rig, mut rings) = Rig::new(Settings::default());
    let mut samples = Vec::new();
    loop {
        match replay.next(0) {
            Event::Attached { port, id } => rig.attach(port, id),
            Event::Packet(packet) => rig.packet(&packet),
            Event::End => return (rig, samples),
            event => panic!("{path:?}: {event:?}"),
        }
        for ring in &mut rings {
            samples.extend(std::iter::from_fn(|| ring.pop()));
        }
    }
}

#[test]
fn recorded_devices_are_found_with_their_roles() {
    let Some(captures) = captures() else {
        println!("SKIPPED (needs shared data): recorded_devices_are_found_with_their_roles");
        return;
    };
    for Expected(prefix, expected) in CAPTURES {
        let (rig, samples) = replay(&file(&captures, prefix));
        let devices = rig.devices();
        let found: Vec<_> = devices
            .iter()
            .map(|d| (d.identity.serial, d.role))
            .collect();
        let expected: Vec<_> = expected
            .iter()
            .map(|(s, role)| (Serial::new(s), *role))
            .collect();
        assert_eq!(found, expected, "{prefix}");
        for Counters {
            decode_errors,
            imu,
            unsound,
            dropped,
            ..
        } in devices.iter().map(|device| &device.counters)
        {
            assert_eq!((*decode_errors, *unsound, *dropped), (0, 0, 0), "{prefix}");
            assert!(*imu > 1_000, "{prefix}: {imu} inertial samples");
        }
        let counted: u64 = devices.iter().map(|device| device.counters.samples).sum();
        assert_eq!(samples.len() as u64, counted, "{prefix}");
    }
}

#[test]
fn two_replays_give_the_same_samples() {
    let Some(captures) = captures() else {
        println!("SKIPPED (needs shared data): two_replays_give_the_same_samples");
        return;
    };
    let path = file(&captures, "lighthouse/index-hmd-and-two-knuckles.pcap.gz");
    assert!(
        replay(&path).1 == replay(&path).1,
        "a replay depends on more than its capture"
    );
}
