//! What is wrong with a room, as a headset's quality tells it: from USB traffic to the rig's list.

use glam::{DQuat, DVec3};
use posed_signal::{PoseHow, Role, ring::Consumer};

use super::{super::base_station::BaseStation, super::room::Handle, simulated::halting};
use crate::{
    decode::Command,
    haptic::{Haptic, HapticError},
    lighthouse,
    rig::{self, Rig},
    simulate::{
        Absence, Device, Model, Move, Options, Placement, Simulator, default_stations,
        four_stations,
    },
    trouble::Trouble,
    usb::Port,
};

/// Ticks of the rig are this far apart, s.
const TICK_S: f64 = 0.05;

/// Where somebody looks, rad: towards the fourth base station, with the first and the second at the sides.
const TURN: f64 = 2.0;

/// A rig in front of simulated devices.
struct Bench {
    rig: Rig,
    rings: Vec<Consumer<posed_signal::Sample>>,
    room: Handle,
    /// At every tick: seconds, the headset's troubles, and whether it is tracked by light.
    seen: Vec<(f64, Vec<Trouble>, bool)>,
}

impl Bench {
    fn run(options: Options, given: &[BaseStation]) -> Self {
        let lighthouse = lighthouse::Settings {
            base_stations: given.to_vec(),
            ..lighthouse::Settings::default()
        };
        let room = lighthouse.room.clone();
        let (rig, rings) = Rig::new(rig::Settings {
            devices: crate::catalog::Settings { lighthouse },
            ring_samples: 16,
            ..rig::Settings::default()
        });
        let mut bench = Self {
            rig,
            rings,
            room,
            seen: Vec::new(),
        };
        let start = options.start;
        // Somebody who stands in the middle of the room, shifts about, looks around and stops.
        let head = |seconds: f64| Placement {
            position: DVec3::new(0.3 * seconds.sin(), 1.6, 0.2 * (0.7 * seconds).cos()),
            rotation: DQuat::from_rotation_y(TURN + 0.5 * (0.6 * seconds).sin()),
        };
        let hand = move |seconds: f64| {
            let head = head(seconds);
            Placement {
                position: head.position - DVec3::Y * 0.4 + head.rotation * DVec3::NEG_Z * 0.3,
                rotation: head.rotation,
            }
        };
        let devices = vec![
            Device::new(Model::Headset, halting(head)),
            Device::new(Model::RightController, halting(hand)),
        ];
        let mut next = start;
        let mut commands = Vec::new();
        for packet in Simulator::new(options, devices).unwrap() {
            while next <= packet.at {
                bench.rig.tick(next, &mut commands);
                commands.clear();
                bench.look(next.since_secs(start));
                next = next.plus_secs(TICK_S);
            }
            bench.rig.packet(&packet);
            for ring in &mut bench.rings {
                while ring.pop().is_some() {}
            }
        }
        bench
    }

    fn look(&mut self, seconds: f64) {
        let devices = self.rig.devices();
        if let Some(headset) = devices.iter().find(|device| device.role == Role::Head) {
            let pose = headset.pose.as_ref();
            let tracked = pose.is_some_and(|pose| pose.how == PoseHow::Optical);
            self.seen.push((seconds, headset.troubles.clone(), tracked));
        }
    }

    /// Share of the ticks in a span at which `holds`.
    fn share(&self, span: [f64; 2], holds: impl Fn(&[Trouble], bool) -> bool) -> f64 {
        let inside = |seconds: f64| (span[0]..span[1]).contains(&seconds);
        let ticks = self.seen.iter().filter(|(seconds, ..)| inside(*seconds));
        let (mut all, mut held) = (0, 0);
        for (_, troubles, tracked) in ticks {
            all += 1;
            held += u32::from(holds(troubles, *tracked));
        }
        assert!(all > 0, "no tick in {span:?}");
        f64::from(held) / f64::from(all)
    }

    fn placed(&self) -> usize {
        self.room.with(|room| room.stations().count())
    }
}

fn options(seconds: f64) -> Options {
    Options {
        duration_s: seconds,
        ..Options::default()
    }
}

#[test]
fn a_room_without_trouble_shows_none() {
    let bench = Bench::run(options(12.0), &default_stations());
    assert_eq!(
        bench.share([0.0, 12.0], |troubles, _| troubles.is_empty()),
        1.0
    );
    assert!(bench.share([3.0, 12.0], |_, tracked| tracked) > 0.95);
}

#[test]
fn a_shared_channel_is_told_and_the_other_stations_go_on() {
    let mut stations = four_stations();
    // Both in front of the headset; of the others one is.
    stations[3].source = stations[0].source;
    let shared = stations[0].source;
    let good = stations[1].source;
    let bench = Bench::run(
        Options {
            stations,
            ..options(16.0)
        },
        &[],
    );
    let told = |troubles: &[Trouble], _| troubles.contains(&Trouble::Shared(shared));
    let share = bench.share([5.0, 16.0], told);
    assert!(share > 0.95, "{share}");
    assert!(bench.share([5.0, 16.0], |_, tracked| tracked) > 0.95);
    let placed = bench.room.with(|room| room.placed());
    assert!(placed[good.index()].is_some());
    assert!(placed[shared.index()].is_none(), "its light tells nothing");
}

#[test]
fn a_station_that_appears_late_is_told_of_until_it_has_its_place() {
    let stations = default_stations();
    let late = stations[1].source;
    let bench = Bench::run(
        Options {
            absences: vec![Absence {
                source: late,
                span: [0.0, 8.0],
            }],
            ..options(16.0)
        },
        &[],
    );
    let alone = Trouble::Alone(stations[0].source);
    assert!(bench.share([4.0, 8.0], |troubles, _| troubles == [alone]) > 0.95);
    assert!(
        bench.share([4.0, 8.0], |_, tracked| tracked) > 0.95,
        "one is enough"
    );
    let new = |troubles: &[Trouble], _| troubles.contains(&Trouble::New(late));
    assert!(bench.share([8.0, 10.5], new) > 0.0);
    assert_eq!(
        bench.share([12.0, 16.0], |troubles, _| troubles.is_empty()),
        1.0
    );
    assert_eq!(bench.placed(), 2);
}

#[test]
fn a_moved_station_is_told_of_and_measured_anew() {
    let stations = four_stations();
    let moved = Move {
        at_s: 8.0,
        source: stations[3].source,
        position: stations[3].position + DVec3::new(0.3, 0.1, 0.0),
        rotation: DQuat::from_rotation_y(0.1) * stations[3].rotation,
    };
    let told = |trouble: Trouble| move |troubles: &[Trouble], _| troubles.contains(&trouble);
    let moves = || Options {
        moves: vec![moved],
        stations: stations.clone(),
        ..options(20.0)
    };
    let bench = Bench::run(moves(), &[]);
    assert_eq!(
        bench.share([3.0, 8.0], |troubles, _| troubles.is_empty()),
        1.0
    );
    assert!(bench.share([12.0, 20.0], told(Trouble::Moved(moved.source))) > 0.95);
    assert!(
        bench.share([3.0, 20.0], |_, tracked| tracked) > 0.99,
        "three are enough"
    );
    assert_eq!(bench.placed(), 4, "it has a place again");
    // Where places are given nothing is measured: the light of that one is left out, and said to be.
    let bench = Bench::run(moves(), &stations);
    assert!(bench.share([14.0, 20.0], told(Trouble::Misplaced(moved.source))) > 0.9);
    assert!(bench.share([10.0, 20.0], |_, tracked| tracked) > 0.9);
}

#[test]
fn darkness_a_room_unknown_and_one_not_given_are_told() {
    let stations = default_stations();
    let bench = Bench::run(
        Options {
            dark: vec![[6.0, 9.0]],
            ..options(11.0)
        },
        &stations[..1],
    );
    let unlisted = Trouble::Unlisted(stations[1].source);
    assert!(bench.share([3.0, 6.0], |troubles, _| troubles == [unlisted]) > 0.95);
    assert!(bench.share([7.2, 9.0], |troubles, _| troubles == [Trouble::Dark]) > 0.95);
    assert!(bench.share([9.5, 11.0], |troubles, _| troubles == [unlisted]) > 0.9);
    // Who never stands still is not measured; here somebody spins.
    let spinning = |seconds: f64| Placement {
        position: DVec3::new(0.0, 1.6, 0.0),
        rotation: DQuat::from_rotation_y(2.5 * seconds),
    };
    let (mut rig, _rings) = Rig::new(rig::Settings::default());
    let device = Device::new(Model::Headset, spinning);
    let mut last = None;
    for packet in Simulator::new(options(4.0), vec![device]).unwrap() {
        rig.packet(&packet);
        last = Some(packet.at);
    }
    rig.tick(last.unwrap(), &mut Vec::new());
    let troubles = &rig.devices()[0].troubles;
    assert!(troubles.contains(&Trouble::Unmeasured), "{troubles:?}");
    assert!(troubles[0].to_string().contains("hold the headset still"));
}

#[test]
fn a_controller_buzzes_and_a_headset_does_not() {
    let mut bench = Bench::run(options(0.5), &default_stations());
    let role = |bench: &Bench, role| {
        let of_role = bench
            .rig
            .devices()
            .iter()
            .find(|device| device.role == role);
        of_role.map(|device| (device.id, device.port)).unwrap()
    };
    let (hand, port) = role(&bench, Role::RightHand);
    let (head, _) = role(&bench, Role::Head);
    let haptic = Haptic::new(0.25, 160.0, 0.5).unwrap();
    let mut commands: Vec<(Port, Command)> = Vec::new();
    assert_eq!(bench.rig.buzz(hand, &haptic, &mut commands), Ok(()));
    // 40 periods of 6,250 us, a quarter of each on, by radio.
    let data = vec![0xff, 0x8f, 7, 0, 0x1a, 6, 0x4f, 0x12, 40, 0];
    let command = Command::SetFeature { interface: 0, data };
    assert_eq!(commands, [(port, command)]);
    assert_eq!(
        bench.rig.buzz(head, &haptic, &mut commands),
        Err(HapticError::NoMotor(head))
    );
    bench.rig.detach(port);
    let gone = bench.rig.buzz(hand, &haptic, &mut commands);
    assert_eq!(gone, Err(HapticError::NoDevice(hand)));
    bench.rig.count_buzz(hand, true);
    bench.rig.count_buzz(hand, false);
    let counters = &bench.rig.devices()[usize::from(hand.0)].counters;
    assert_eq!((counters.haptics, counters.haptics_dropped), (1, 1));
    assert_eq!(commands.len(), 1);
}
