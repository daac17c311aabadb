mod recordings;

use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::decode::{Decoder, Emit};
use posed_signal::device::DEVICES_MAX;

const USB: UsbId = UsbId::new(0x28de, 0x2300);

/// Speaks a protocol of its own: `I unit serial role` is an identity, `S unit` a sample, `N unit`
/// one that is not finite, anything else an error. A serial of 0 is none.
struct Puppet;

impl Decoder for Puppet {
    fn packet(&mut self, packet: &Packet, out: &mut dyn Emit) -> Result<(), DecodeError> {
        match packet.data[..] {
            [b'I', unit, serial, role] => {
                let text = format!("S{serial}");
                let serial = Serial::new(if serial == 0 { "" } else { &text });
                let natural_role = Role::ALL[usize::from(role)];
                let identity = Identity {
                    serial,
                    model: "puppet",
                    natural_role,
                    has_haptics: false,
                };
                out.identity(usize::from(unit), identity);
            }
            [b'S', unit] => out.sample(usize::from(unit), imu(packet.at, 1.0)),
            [b'N', unit] => out.sample(usize::from(unit), imu(packet.at, f32::NAN)),
            _ => {
                return Err(DecodeError::TooShort {
                    id: 0,
                    got: 0,
                    needed: 1,
                });
            }
        }
        Ok(())
    }

    fn tick(&mut self, _now: HostTime, commands: &mut Vec<Command>) {
        commands.push(Command::GetFeature {
            interface: 0,
            id: 1,
            length: 2,
        });
    }
}

fn imu(at: HostTime, value: f32) -> Sample {
    Sample::Imu(Imu {
        at,
        accel: Vec3::splat(value),
        gyro: Vec3::ZERO,
    })
}

fn port(address: u8) -> Port {
    Port {
        bus: 1,
        address: u16::from(address),
    }
}

struct Bench {
    rig: Rig,
    rings: Vec<Consumer<Sample>>,
}

impl Bench {
    fn new(roles: &[(&str, Role)]) -> Self {
        let roles = roles
            .iter()
            .map(|(serial, role)| (Serial::new(serial), *role))
            .collect();
        let (rig, rings) = Rig::new(Settings {
            roles,
            ring_samples: 8,
            ..Settings::default()
        });
        Self { rig, rings }
    }

    fn plug(&mut self, address: u8) {
        let link = Link::with_decoder(port(address), USB, Box::new(Puppet));
        self.rig.detach(port(address));
        self.rig.links.insert(port(address), link);
    }

    fn say(&mut self, address: u8, data: &[u8]) {
        self.rig.packet(&Packet {
            at: HostTime(1),
            port: port(address),
            endpoint: 0x81,
            transfer: crate::usb::Transfer::Interrupt,
            data: data.to_vec(),
        });
    }

    fn roles(&self) -> Vec<Role> {
        self.rig
            .devices()
            .iter()
            .map(|device| device.role)
            .collect()
    }
}

const HEAD: u8 = Role::Head as u8;
const LEFT: u8 = Role::LeftHand as u8;

#[test]
fn samples_reach_the_ring_of_their_device() {
    let mut bench = Bench::new(&[]);
    bench.plug(1);
    bench.plug(2);
    bench.say(1, b"?");
    bench.say(1, &[b'I', 0, 1, HEAD]);
    bench.say(2, &[b'I', 0, 2, LEFT]);
    bench.say(2, b"S\0");
    bench.say(2, b"N\0");
    (0..9).for_each(|_| bench.say(1, b"S\0"));

    let devices = bench.rig.devices();
    let counters = &devices[0].counters;
    assert_eq!((counters.packets, counters.decode_errors), (11, 1));
    assert_eq!(
        (counters.samples, counters.imu, counters.dropped),
        (9, 9, 1)
    );
    let counters = &devices[1].counters;
    assert_eq!(
        (counters.samples, counters.unsound, counters.dropped),
        (1, 1, 0)
    );
    assert_eq!(devices[1].imu.map(|imu| imu.accel), Some(Vec3::ONE));
    let waiting: Vec<_> = bench.rings.iter().map(Consumer::waiting).collect();
    assert_eq!(waiting[..3], [8, 1, 0]);
    assert_eq!(waiting.len(), DEVICES_MAX);
}

#[test]
fn a_replugged_serial_keeps_its_id() {
    let mut bench = Bench::new(&[]);
    bench.plug(1);
    bench.say(1, &[b'I', 0, 1, HEAD]);
    bench.plug(2);
    bench.say(2, &[b'I', 0, 2, LEFT]);
    let before = bench.rig.revision();
    bench.rig.detach(port(1));
    assert!(bench.rig.revision() > before);
    assert!(!bench.rig.devices()[0].connected);
    bench.plug(7);
    // A sample before the configuration: a provisional id, given up when the serial is known.
    bench.say(7, b"S\0");
    assert_eq!(bench.rig.devices().len(), 3);
    bench.say(7, &[b'I', 0, 1, HEAD]);
    let device = &bench.rig.devices()[0];
    assert_eq!(
        (device.connected, device.port, device.role),
        (true, port(7), Role::Head)
    );
    assert!(
        !bench.rig.devices()[2].connected,
        "the provisional id is free again"
    );
    bench.say(7, b"S\0");
    assert_eq!(bench.rings[0].waiting(), 1);
}

#[test]
fn a_serial_that_turns_up_elsewhere_is_taken_over() {
    let mut bench = Bench::new(&[]);
    bench.plug(1);
    bench.plug(2);
    bench.say(1, &[b'I', 0, 1, LEFT]);
    bench.say(2, &[b'I', 0, 1, LEFT]);
    bench.say(1, b"S\0");
    assert_eq!(
        bench.rings[0].waiting(),
        0,
        "the old place is not believed any more"
    );
    bench.say(2, b"S\0");
    assert_eq!(bench.rings[0].waiting(), 1);
    bench.rig.detach(port(1));
    assert!(bench.rig.devices()[0].connected);
}

#[test]
fn of_two_with_the_same_role_the_first_wins() {
    let mut bench = Bench::new(&[]);
    (1..=2).for_each(|n| bench.plug(n));
    (1..=2).for_each(|n| bench.say(n, &[b'I', 0, n, HEAD]));
    assert_eq!(bench.roles(), [Role::Head, Role::None]);
    bench.rig.detach(port(1));
    assert_eq!(bench.roles(), [Role::None, Role::Head]);
    bench.plug(1);
    bench.say(1, &[b'I', 0, 1, HEAD]);
    assert_eq!(
        bench.roles(),
        [Role::None, Role::Head],
        "the one that has it keeps it"
    );
}

#[test]
fn the_users_choice_of_role_wins() {
    let mut bench = Bench::new(&[("S2", Role::Head), ("S3", Role::None)]);
    (1..=3).for_each(|n| bench.plug(n));
    (1..=3).for_each(|n| bench.say(n, &[b'I', 0, n, HEAD]));
    assert_eq!(bench.roles(), [Role::None, Role::Head, Role::None]);
}

#[test]
fn several_units_behind_one_device_are_apart() {
    let mut bench = Bench::new(&[]);
    bench.plug(1);
    bench.say(1, &[b'I', 3, 1, HEAD]);
    bench.say(1, &[b'I', 5, 2, LEFT]);
    bench.say(1, b"S\x05");
    bench.say(1, b"S\xff");
    let units: Vec<_> = bench
        .rig
        .devices()
        .iter()
        .map(|device| device.unit)
        .collect();
    assert_eq!(units, [3, 5]);
    assert_eq!(bench.rings[1].waiting(), 1);
}

#[test]
fn commands_carry_their_port() {
    let mut bench = Bench::new(&[]);
    bench.plug(4);
    bench.plug(2);
    let mut commands = Vec::new();
    bench.rig.tick(HostTime(5), &mut commands);
    let ports: Vec<_> = commands.iter().map(|(port, _)| *port).collect();
    assert_eq!(ports, [port(2), port(4)]);
}

#[test]
fn devices_without_number_do_not_exhaust_the_rig() {
    let mut bench = Bench::new(&[]);
    for serial in 1..=100 {
        bench.plug(1);
        bench.say(1, &[b'I', 0, serial, HEAD]);
        bench.say(1, b"S\0");
    }
    assert_eq!(bench.rig.devices().len(), DEVICES_MAX);
    assert_eq!(
        bench
            .rig
            .devices()
            .iter()
            .filter(|device| device.connected)
            .count(),
        1
    );
    assert_eq!(bench.rig.refused(), 0);
    for address in 1..=100 {
        bench.plug(address);
        bench.say(address, &[b'I', 0, 100 + address, HEAD]);
    }
    assert_eq!(bench.rig.refused(), 100 - DEVICES_MAX as u64);
}

#[derive(Debug, Clone)]
enum Op {
    Plug(u8),
    Unplug(u8),
    Identity {
        address: u8,
        unit: u8,
        serial: u8,
        role: u8,
    },
    Sample {
        address: u8,
        unit: u8,
    },
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let op = prop_oneof![
        (0..6u8).prop_map(Op::Plug),
        (0..6u8).prop_map(Op::Unplug),
        (0..6u8, 0..2u8, 0..8u8, 0..4u8).prop_map(|(address, unit, serial, role)| {
            Op::Identity {
                address,
                unit,
                serial,
                role,
            }
        }),
        (0..6u8, 0..2u8).prop_map(|(address, unit)| Op::Sample { address, unit }),
    ];
    prop::collection::vec(op, 0..80)
}

proptest! {
    #[test]
    fn the_rig_stays_consistent(ops in ops()) {
        let mut bench = Bench::new(&[("S3", Role::LeftHand)]);
        let mut ids: BTreeMap<Serial, DeviceId> = BTreeMap::new();
        for op in ops {
            match op {
                Op::Plug(address) => bench.plug(address),
                Op::Unplug(address) => bench.rig.detach(port(address)),
                Op::Identity { address, unit, serial, role } => {
                    bench.say(address, &[b'I', unit, serial, role]);
                }
                Op::Sample { address, unit } => bench.say(address, &[b'S', unit]),
            }
            let mut roles = [false; Role::COUNT];
            let mut places = std::collections::BTreeSet::new();
            for (index, device) in bench.rig.devices().iter().enumerate() {
                prop_assert_eq!(usize::from(device.id.0), index);
                if device.role != Role::None {
                    prop_assert!(!std::mem::replace(&mut roles[device.role as usize], true));
                }
                if device.connected {
                    prop_assert!(bench.rig.links.contains_key(&device.port));
                    prop_assert!(places.insert((device.port, device.unit)));
                }
                let serial = device.identity.serial;
                if serial != Serial::default() {
                    prop_assert_eq!(*ids.entry(serial).or_insert(device.id), device.id);
                }
                let Counters { samples, dropped, .. } = device.counters;
                prop_assert!(dropped <= samples);
            }
        }
    }
}
