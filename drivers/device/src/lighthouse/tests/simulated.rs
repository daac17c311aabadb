//! Simulated devices, whose true poses are known.

use std::{collections::BTreeMap, f64::consts::TAU};

use glam::{DQuat, DVec3};
use posed_signal::{HostTime, Pose, PoseHow};

use super::{
    super::{
        Settings, Variant,
        base_station::{BaseStation, Source},
        decoder,
        inspect::Inspector,
        room::Handle,
    },
    Tracked, quantile,
};
use crate::{
    decode::Decoder,
    simulate::{
        Device, Model, Move, Options, Path, Placement, Simulator, default_stations,
        generation_one_stations,
    },
    usb::{Packet, Port},
};

/// Someone who walks in a circle at 0.8 m/s, looks around and swings the arms: hands reach 3 m/s,
/// 17 m/s^2 and 5 rad/s.
pub(super) fn body(seconds: f64) -> (DVec3, DQuat) {
    let turn = DQuat::from_rotation_y(0.8 * seconds);
    (turn * DVec3::X, turn)
}

fn head(seconds: f64) -> Placement {
    let (place, turn) = body(seconds);
    let step = TAU * 0.95 * seconds;
    let sway = DVec3::new(0.015 * step.sin(), 1.65 + 0.025 * (2.0 * step).sin(), 0.0);
    let look = DQuat::from_rotation_y(0.4 * (0.9 * seconds).sin())
        * DQuat::from_rotation_x(0.25 * (1.3 * seconds).sin());
    Placement {
        position: place + turn * sway,
        rotation: turn * look,
    }
}

fn hand(side: f64) -> impl Path {
    move |seconds: f64| {
        let (place, turn) = body(seconds);
        let swing = DQuat::from_rotation_x(side * 0.6 * (TAU * 0.95 * seconds).sin());
        let arm = DVec3::new(side * 0.2, 1.4, 0.0) + swing * DVec3::new(side * 0.05, -0.5, -0.25);
        let wrist = DQuat::from_rotation_y(side * 0.3 + 0.5 * (2.0 * seconds).sin())
            * DQuat::from_rotation_z(0.6 * (3.1 * seconds).sin());
        Placement {
            position: place + turn * arm,
            rotation: turn * swing * wrist,
        }
    }
}

pub(super) struct Walk {
    start: HostTime,
    pub(super) devices: Vec<(Model, Tracked)>,
}

/// Tracks the walk for some seconds; packets that `pass` refuses (by seconds and packet) are lost.
fn walk(seconds: f64, pass: impl Fn(f64, &Packet) -> bool) -> Walk {
    walk_under(default_stations(), seconds, pass)
}

fn walk_under(
    stations: Vec<BaseStation>,
    seconds: f64,
    pass: impl Fn(f64, &Packet) -> bool,
) -> Walk {
    let options = Options {
        duration_s: seconds,
        stations,
        ..Options::default()
    };
    walk_with(options, pass)
}

/// Tracks the walk with base stations that are given.
pub(super) fn walk_with(options: Options, pass: impl Fn(f64, &Packet) -> bool) -> Walk {
    let start = options.start;
    let models = [
        Model::Headset,
        Model::LeftController,
        Model::RightController,
    ];
    let devices = vec![
        Device::new(models[0], head),
        Device::new(models[1], hand(-1.0)),
        Device::new(models[2], hand(1.0)),
    ];
    let simulator = Simulator::new(options, devices).unwrap();
    let settings = Settings {
        base_stations: simulator.stations().to_vec(),
        ..Settings::default()
    };
    let mut found = BTreeMap::<Port, (Box<dyn Decoder>, Tracked)>::new();
    for packet in simulator.filter(|packet| pass(packet.at.since_secs(start), packet)) {
        let fresh = || (decoder(Variant::Watchman, &settings), Tracked::default());
        let (decoder, tracked) = found.entry(packet.port).or_insert_with(fresh);
        decoder.packet(&packet, tracked).unwrap();
    }
    let tracked = found.into_values().map(|(_, tracked)| tracked);
    Walk {
        start,
        devices: models.into_iter().zip(tracked).collect(),
    }
}

pub(super) fn truth(model: Model, seconds: f64) -> Placement {
    match model {
        Model::Headset => head(seconds),
        Model::LeftController => hand(-1.0).at(seconds),
        Model::RightController => hand(1.0).at(seconds),
    }
}

impl Walk {
    /// Seconds after the walk's start.
    pub(super) fn seconds(&self, pose: &Pose) -> f64 {
        pose.at.since_secs(self.start)
    }

    /// Poses from the given second on, each with its errors: metres, degrees.
    pub(super) fn errors(&self, index: usize, from: f64) -> Vec<(&Pose, f64, f64)> {
        let (model, tracked) = &self.devices[index];
        let late = tracked
            .poses
            .iter()
            .filter(|pose| pose.at.since_secs(self.start) >= from);
        let error = |pose| {
            let pose: &Pose = pose;
            let truth = truth(*model, pose.at.since_secs(self.start));
            let metres = (pose.position.as_dvec3() - truth.position).length();
            let degrees = pose
                .rotation
                .as_dquat()
                .angle_between(truth.rotation)
                .to_degrees();
            (pose, metres, degrees)
        };
        late.map(error).collect()
    }
}

#[test]
fn a_walk_is_tracked() {
    let walk = walk(10.0, |_, _| true);
    for index in 0..3 {
        let errors = walk.errors(index, 2.0);
        assert!(errors.len() > 1_900, "{index}: {}", errors.len());
        assert!(errors.iter().all(|(pose, ..)| pose.how == PoseHow::Optical));
        let metres = |q| quantile(errors.iter().map(|error| error.1), q);
        let degrees = |q| quantile(errors.iter().map(|error| error.2), q);
        assert!(
            metres(0.5) < 1e-3 && metres(0.99) < 6e-3,
            "{index}: {}",
            metres(0.99)
        );
        assert!(
            degrees(0.5) < 0.15 && degrees(0.99) < 0.6,
            "{index}: {}",
            degrees(0.99)
        );
        // The poses neither lag nor lead, and their velocities are good for 30 ms.
        let model = walk.devices[index].0;
        let (mut along, mut speed, mut ahead) = (0.0, 0.0, Vec::new());
        for (pose, ..) in &errors {
            let seconds = pose.at.since_secs(walk.start);
            let at = |dt: f64| truth(model, seconds + dt).position;
            let velocity = (at(1e-4) - at(-1e-4)) / 2e-4;
            along += (pose.position.as_dvec3() - at(0.0)).dot(velocity);
            speed += velocity.length_squared();
            let foretold = pose.position.as_dvec3() + 0.03 * pose.velocity.as_dvec3();
            ahead.push((foretold - at(0.03)).length());
        }
        assert!((along / speed).abs() < 1e-3, "{index}: {} s", along / speed);
        assert!(quantile(ahead.into_iter(), 0.95) < 1e-2);
    }
}

/// A headset's light comes on an endpoint of its own, so that it can be taken away alone.
#[test]
fn a_headset_in_the_dark_is_carried_on_by_its_imu() {
    const LIGHT: u8 = 0x83;
    let dark = |seconds: f64| seconds > 3.0 && seconds % 1.0 < 0.2;
    let walk = walk(8.0, |seconds, packet| {
        packet.endpoint != LIGHT || !dark(seconds)
    });
    let errors = walk.errors(0, 2.0);
    let worst = errors.iter().map(|error| error.1).fold(0.0, f64::max);
    assert!(worst < 0.015, "{worst}");
    assert!(
        errors
            .iter()
            .any(|(pose, ..)| pose.how == PoseHow::Inertial)
    );
    assert!(errors.iter().all(|(pose, ..)| pose.how != PoseHow::Lost));
}

#[test]
fn a_controller_out_of_reach_is_found_again() {
    const RADIO: u8 = 0x81;
    let away = |seconds: f64| (3.0..3.4).contains(&seconds) || (5.0..5.1).contains(&seconds);
    let radio = |packet: &Packet| packet.endpoint == RADIO && packet.data.len() != 52;
    let walk = walk(7.0, |seconds, packet| !radio(packet) || !away(seconds));
    for index in 1..3 {
        let errors = walk.errors(index, 2.0);
        let optical = errors
            .iter()
            .filter(|(pose, ..)| pose.how == PoseHow::Optical);
        let worst = optical.clone().map(|error| error.1).fold(0.0, f64::max);
        assert!(worst < 0.03, "{index}: {worst}");
        assert!(optical.count() as f64 > 0.85 * errors.len() as f64);
        let back = errors.iter().find(|(pose, ..)| {
            pose.how == PoseHow::Optical && pose.at.since_secs(walk.start) > 3.4
        });
        let after = back.unwrap().0.at.since_secs(walk.start) - 3.4;
        assert!(after < 0.15, "{index}: found after {after} s");
    }
}

/// A headset that reports pulses. The first device has the lowest port.
#[test]
fn a_walk_under_generation_one_is_tracked() {
    const HEADSET: u16 = 10;
    let walk = walk_under(generation_one_stations(), 8.0, |_, packet| {
        packet.port.address == HEADSET
    });
    let errors = walk.errors(0, 2.0);
    assert!(errors.len() > 1_400, "{}", errors.len());
    let optical = errors
        .iter()
        .filter(|(pose, ..)| pose.how == PoseHow::Optical);
    assert!(optical.count() as f64 > 0.95 * errors.len() as f64);
    let metres = |q| quantile(errors.iter().map(|error| error.1), q);
    let degrees = |q| quantile(errors.iter().map(|error| error.2), q);
    assert!(
        metres(0.5) < 3e-3 && metres(0.99) < 2e-2,
        "{}",
        metres(0.99)
    );
    assert!(
        degrees(0.5) < 0.3 && degrees(0.99) < 1.5,
        "{}",
        degrees(0.99)
    );
}

#[test]
fn simulated_stations_say_what_they_are() {
    for (stations, seconds) in [(generation_one_stations(), 5.0), (default_stations(), 12.0)] {
        let options = Options {
            duration_s: seconds,
            stations: stations.clone(),
            ..Options::default()
        };
        // In a free corner of the room, looking at its middle, with a station on either side.
        let device = Device::new(Model::Headset, |_: f64| Placement {
            position: DVec3::new(2.0, 1.6, -2.0),
            rotation: DQuat::from_rotation_y(135f64.to_radians()),
        });
        let mut inspector = Inspector::new(None);
        for packet in Simulator::new(options, vec![device]).unwrap() {
            inspector.packet(&packet);
        }
        let report = inspector.report();
        assert_eq!((report.errors, report.stations.len()), (0, 2));
        for station in &stations {
            let heard = &report.stations[&station.source];
            let broadcast = heard.broadcast.unwrap();
            assert!(heard.sweeps > 500, "{:?}: {}", station.source, heard.sweeps);
            assert_eq!(broadcast.id, station.id);
            let up = station.rotation.conjugate() * DVec3::Y;
            assert!(broadcast.up.angle_between(up) < 0.01);
            let pairs = broadcast.calibration.iter().zip(&station.calibration);
            for (heard, sent) in pairs {
                assert!((heard.tilt - sent.tilt).abs() < 1e-5, "{heard:?} {sent:?}");
                assert_eq!((heard.curve, heard.gibmag), (sent.curve, sent.gibmag));
            }
            if let Source::Slot(slot) = station.source {
                assert_eq!(broadcast.mode, slot);
            }
        }
    }
}

/// Somebody who walks and looks about, and stops every two seconds.
pub(super) fn halting(path: impl Path) -> impl Path {
    move |seconds: f64| path.at(seconds - (TAU * 0.5 * seconds).sin() / (TAU * 0.5))
}

/// What the light alone tells: the room and every device's poses.
fn found(options: Options, pass: impl Fn(f64, &Packet) -> bool) -> (Handle, Vec<Tracked>) {
    let start = options.start;
    let devices = vec![
        Device::new(Model::Headset, halting(head)),
        Device::new(Model::LeftController, halting(hand(-1.0))),
    ];
    let settings = Settings::default();
    let mut found = BTreeMap::<Port, (Box<dyn Decoder>, Tracked)>::new();
    let simulator = Simulator::new(options, devices).unwrap();
    for packet in simulator.filter(|packet| pass(packet.at.since_secs(start), packet)) {
        let fresh = || (decoder(Variant::Watchman, &settings), Tracked::default());
        let (decoder, tracked) = found.entry(packet.port).or_insert_with(fresh);
        decoder.packet(&packet, tracked).unwrap();
    }
    let tracked = found.into_values().map(|(_, tracked)| tracked).collect();
    (settings.room, tracked)
}

/// The first station in the second one's frame.
fn relative(stations: &[BaseStation]) -> (DVec3, DQuat) {
    let [first, second] = stations else {
        panic!("two stations, not {}", stations.len())
    };
    let back = second.rotation.conjugate();
    (
        back * (first.position - second.position),
        back * first.rotation,
    )
}

#[test]
fn base_stations_are_found_by_their_light() {
    // A few times as long as a station takes to say what it is: some turns are not seen.
    let options = Options {
        duration_s: 32.0,
        ..Options::default()
    };
    let (start, stations) = (options.start, options.stations.clone());
    let (room, tracked) = found(options, |_, _| true);
    let found: Vec<BaseStation> = room.with(|room| room.stations().copied().collect());
    let ((place, turn), (truth, true_turn)) = (relative(&found), relative(&stations));
    assert!((place - truth).length() < 0.02, "{place} {truth}");
    assert!(turn.angle_between(true_turn) < 0.5f64.to_radians());
    for (found, truth) in found.iter().zip(&stations) {
        assert_eq!((found.id, found.calibration), (truth.id, truth.calibration));
        let up = |station: &BaseStation| station.rotation.conjugate() * DVec3::Y;
        let lean = up(found).angle_between(up(truth)).to_degrees();
        assert!(lean < 0.5, "{lean} degrees off the level");
    }
    // The headset is tracked from the wearer's second halt on, long before the stations have said
    // what shape their light has.
    let poses = &tracked[0].poses;
    let first = poses[0].at.since_secs(start);
    assert!(first < 2.2, "{first} s");
    let optical = poses.iter().filter(|pose| pose.how == PoseHow::Optical);
    assert!(optical.count() as f64 > 0.95 * poses.len() as f64);
}

#[test]
fn a_station_that_is_moved_is_found_again() {
    let mut stations = default_stations();
    let moved = BaseStation {
        position: stations[1].position + DVec3::new(-0.3, 0.1, 0.0),
        rotation: DQuat::from_rotation_y(0.1) * stations[1].rotation,
        ..stations[1]
    };
    let options = Options {
        duration_s: 30.0,
        moves: vec![Move {
            at_s: 14.0,
            source: moved.source,
            position: moved.position,
            rotation: moved.rotation,
        }],
        ..Options::default()
    };
    let start = options.start;
    let (room, tracked) = found(options, |_, _| true);
    stations[1] = moved;
    let found: Vec<BaseStation> = room.with(|room| room.stations().copied().collect());
    assert_eq!(room.with(|room| room.moved()), 1);
    let ((place, turn), (truth, true_turn)) = (relative(&found), relative(&stations));
    let off = (
        (place - truth).length(),
        turn.angle_between(true_turn).to_degrees(),
    );
    assert!(
        off.0 < 0.02 && off.1 < 0.5,
        "{} m, {} degrees",
        off.0,
        off.1
    );
    let late = tracked[0]
        .poses
        .iter()
        .filter(|pose| pose.at.since_secs(start) > 20.0);
    assert!(late.clone().count() > 4_000);
    let optical = late
        .clone()
        .filter(|pose| pose.how == PoseHow::Optical)
        .count();
    assert!(optical as f64 > 0.95 * late.count() as f64);
}
