//! Packets there and back, and a receiver with two trackers.

use glam::{Quat, Vec3};
use posed_signal::{HostTime, Role, Sample};
use proptest::prelude::*;

use super::{
    decoder::Receiver,
    wire::{
        Content, Firmware, LinkStatus, Motion, PACKET_BYTES, Packet, Power, REPORT_BYTES, Signal,
        packets,
    },
};
use crate::{
    decode::{Decoder as _, Emit, Identity},
    usb::{self, Port, Transfer},
};

fn report(packets: &[Packet]) -> Vec<u8> {
    let mut bytes: Vec<u8> = packets.iter().flat_map(Packet::write).collect();
    bytes.resize(REPORT_BYTES, 0);
    bytes
}

fn read(bytes: &[u8]) -> Vec<Packet> {
    packets(bytes).unwrap().map(Result::unwrap).collect()
}

/// Bytes put together by hand from the protocol's tables, not by the writer.
#[test]
fn bytes_mean_what_the_protocol_says() {
    let mut bytes = vec![0; REPORT_BYTES];
    // A quarter turn about z: 0x5a82 is 0.70709 of 32,768; 1.5 m/s^2 is 0xc0 of 128.
    bytes[..16].copy_from_slice(&[
        1, 3, 0, 0, 0, 0, 0x82, 0x5a, 0x82, 0x5a, 0xc0, 0, 0, 0xff, 0, 0,
    ]);
    bytes[32..48].copy_from_slice(&[
        255, 3, 0x44, 0x33, 0x22, 0x11, 0xee, 0xff, 0, 0, 0, 0, 0, 0, 0, 0,
    ]);
    bytes[48..].copy_from_slice(&[3, 3, 1, 0, 95, 5, 90, 5, 0, 0, 0, 0, 0, 0, 0, 61]);
    let [motion, register, status] = read(&bytes)[..] else {
        panic!("three packets, one unused")
    };
    let Content::Motion(motion) = motion.content else {
        panic!("{motion:?}")
    };
    let turned = motion.rotation * Vec3::X;
    assert!(turned.distance(Vec3::Y) < 1e-4, "{turned}");
    assert_eq!(motion.accel, Vec3::new(1.5, -2.0, 0.0));
    let address = 0xffee_1122_3344;
    assert_eq!(register.content, Content::Register { address });
    let Content::Status { link, signal } = status.content else {
        panic!("{status:?}")
    };
    assert_eq!((link.received, link.lost), (95, 5));
    assert_eq!(signal.dbm(), Some(-61.0));
}

/// The middle of the packed numbers is no rotation; the ends are half turns.
#[test]
fn packed_rotations_mean_what_the_protocol_says() {
    let packed = |q: u32| {
        let mut bytes = [0; REPORT_BYTES];
        bytes[..2].copy_from_slice(&[2, 0]);
        bytes[5..9].copy_from_slice(&q.to_le_bytes());
        let Content::MotionAndPower { motion, .. } = read(&bytes)[0].content else {
            panic!("a packet of type 2")
        };
        motion.rotation
    };
    let (x, y, z) = (1u32 << 9, 1u32 << 10, 1u32 << 10);
    assert!(packed(x | y << 10 | z << 21).angle_between(Quat::IDENTITY) < 1e-3);
    let quarter = packed(x | (y + (y >> 1)) << 10 | z << 21);
    assert!(quarter.angle_between(Quat::from_rotation_y(std::f32::consts::FRAC_PI_2)) < 1e-3);
    let half = packed(y << 10 | z << 21);
    assert!((half * Vec3::Y).distance(Vec3::NEG_Y) < 1e-3, "about x");
}

#[test]
fn wrong_reports_are_refused_and_the_rest_of_them_is_used() {
    assert!(packets(&[0; 63]).is_err() && packets(&[0; 65]).is_err());
    let mut bytes = report(&[Packet {
        tracker: 1,
        content: Content::Register { address: 7 },
    }]);
    bytes[16..18].copy_from_slice(&[9, 1]);
    bytes[32..34].copy_from_slice(&[1, 1]);
    let results: Vec<_> = packets(&bytes).unwrap().collect();
    assert!(results[0].is_ok() && results[1].is_err() && results[2].is_err());
}

fn any_content() -> impl Strategy<Value = Content> {
    let rotation = prop::array::uniform3(-1.7f32..1.7)
        .prop_map(|axis| Quat::from_scaled_axis(Vec3::from_array(axis)));
    let vector = prop::array::uniform3(-20f32..20.0).prop_map(Vec3::from_array);
    let motion =
        (rotation, vector.clone()).prop_map(|(rotation, accel)| Motion { rotation, accel });
    let power = any::<[u8; 3]>().prop_map(|[battery, voltage, temperature]| Power {
        battery,
        voltage,
        temperature,
    });
    let signal = any::<u8>().prop_map(Signal);
    let firmware = any::<[u8; 7]>().prop_map(|b| Firmware {
        board: b[0],
        mcu: b[1],
        imu: b[2],
        magnetometer: b[3],
        date: u16::from(b[3]) << 7,
        version: [b[4], b[5], b[6]],
    });
    let link = any::<[u8; 6]>().prop_map(|b| LinkStatus {
        server_status: b[0],
        status: b[1],
        received: b[2],
        lost: b[3],
        windows_hit: b[4],
        windows_missed: b[5],
    });
    prop_oneof![
        (power.clone(), firmware, signal.clone()).prop_map(|(power, firmware, signal)| {
            Content::Info {
                power,
                firmware,
                signal,
            }
        }),
        motion.clone().prop_map(Content::Motion),
        (motion.clone(), power, signal.clone()).prop_map(|(motion, power, signal)| {
            Content::MotionAndPower {
                motion,
                power,
                signal,
            }
        }),
        (link, signal.clone()).prop_map(|(link, signal)| Content::Status { link, signal }),
        (motion.clone(), vector).prop_map(|(motion, field)| Content::Field {
            rotation: motion.rotation,
            field,
        }),
        (any::<i64>(), signal.clone())
            .prop_map(|(micros, signal)| Content::Runtime { micros, signal }),
        (any::<u8>(), signal.clone())
            .prop_map(|(button, signal)| Content::Button { button, signal }),
        (motion, any::<u8>(), signal).prop_map(|(motion, button, signal)| {
            Content::MotionAndButton {
                motion,
                button,
                signal,
            }
        }),
        (0u64..1 << 48).prop_map(|address| Content::Register { address }),
    ]
}

/// What a packet says, as far as its precision goes.
fn same(sent: &Content, read: &Content) -> bool {
    let turn = |a: Quat, b: Quat, limit: f32| a.dot(b).abs() > 1.0 - limit;
    let near = |a: Vec3, b: Vec3| a.distance(b) < 0.01;
    let moved = |a: &Motion, b: &Motion, limit: f32| {
        turn(a.rotation, b.rotation, limit) && near(a.accel, b.accel)
    };
    match (sent, read) {
        (Content::Motion(a), Content::Motion(b)) => moved(a, b, 1e-6),
        (
            Content::MotionAndPower {
                motion: a,
                power,
                signal,
            },
            Content::MotionAndPower {
                motion: b,
                power: power_read,
                signal: signal_read,
            },
        ) => moved(a, b, 1e-5) && power == power_read && signal == signal_read,
        (
            Content::MotionAndButton {
                motion: a, button, ..
            },
            Content::MotionAndButton {
                motion: b,
                button: button_read,
                ..
            },
        ) => moved(a, b, 1e-5) && button == button_read,
        (
            Content::Field { rotation, field },
            Content::Field {
                rotation: turned,
                field: field_read,
            },
        ) => turn(*rotation, *turned, 1e-6) && near(*field, *field_read),
        (sent, read) => sent == read,
    }
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(tracker in any::<u8>(), content in any_content()) {
        let sent = Packet { tracker, content };
        prop_assume!(sent.write() != [0; PACKET_BYTES]);
        let read = read(&report(&[sent]));
        prop_assert_eq!(read.len(), 1);
        prop_assert_eq!(read[0].tracker, tracker);
        prop_assert!(same(&sent.content, &read[0].content), "{:?} {:?}", sent, read[0]);
    }
}

#[derive(Default)]
struct Heard {
    names: Vec<(usize, String)>,
    samples: Vec<(usize, Sample)>,
}

impl Emit for Heard {
    fn identity(&mut self, unit: usize, identity: Identity) {
        assert_eq!(identity.natural_role, Role::None);
        self.names.push((unit, identity.serial.to_string()));
    }

    fn sample(&mut self, unit: usize, sample: Sample) {
        self.samples.push((unit, sample));
    }
}

fn send(receiver: &mut Receiver, ms: u64, packets: &[Packet], heard: &mut Heard) {
    let packet = usb::Packet {
        at: HostTime(ms * 1_000_000),
        port: Port { bus: 1, address: 2 },
        endpoint: 0x81,
        transfer: Transfer::Interrupt,
        data: report(packets),
    };
    receiver.packet(&packet, heard).unwrap();
}

#[test]
fn trackers_get_names_when_they_are_heard() {
    let (mut receiver, mut heard) = (Receiver::default(), Heard::default());
    let register = |tracker, address| Packet {
        tracker,
        content: Content::Register { address },
    };
    // Lying on its back: the face looks up, z of the tracker is y of the world.
    let lying = |tracker| Packet {
        tracker,
        content: Content::Motion(Motion {
            rotation: Quat::IDENTITY,
            accel: Vec3::Z,
        }),
    };
    let paired = [register(0, 0xa), register(1, 0xb), register(7, 0xc)];
    send(&mut receiver, 1, &paired, &mut heard);
    assert!(heard.names.is_empty(), "paired, but not heard");
    send(&mut receiver, 2, &[lying(7), lying(0)], &mut heard);
    let names = [(0, "00000000000C".to_owned()), (1, "00000000000A".into())];
    assert_eq!(heard.names, names);
    for (index, (unit, sample)) in heard.samples.iter().enumerate() {
        let Sample::Orientation(orientation) = sample else {
            panic!("{sample:?}")
        };
        assert_eq!(*unit, index);
        let face = orientation.rotation * Vec3::Z;
        assert!(face.distance(Vec3::Y) < 1e-6, "{face}");
        assert!(
            orientation.accel.distance(Vec3::Y) < 1e-5,
            "{orientation:?}"
        );
    }
    send(&mut receiver, 3, &[register(0, 0xd)], &mut heard);
    assert_eq!(
        heard.names[2],
        (1, "00000000000D".to_owned()),
        "paired anew"
    );
}

#[test]
fn lost_packets_add_up_and_batteries_are_told_now_and_then() {
    let (mut receiver, mut heard) = (Receiver::default(), Heard::default());
    let power = Power {
        battery: 0x80 | 77,
        voltage: 190,
        temperature: 120,
    };
    let signal = Signal(55);
    for step in 0..100 {
        let motion = Motion {
            rotation: Quat::IDENTITY,
            accel: Vec3::ZERO,
        };
        let packets = [
            Packet {
                tracker: 0,
                content: Content::MotionAndPower {
                    motion,
                    power,
                    signal,
                },
            },
            Packet {
                tracker: 0,
                content: Content::Status {
                    link: LinkStatus {
                        received: 95,
                        lost: 5,
                        ..LinkStatus::default()
                    },
                    signal,
                },
            },
        ];
        let both = step % 50 == 49;
        send(
            &mut receiver,
            step * 10,
            &packets[..1 + usize::from(both)],
            &mut heard,
        );
    }
    let batteries = |sample: &&(usize, Sample)| matches!(sample.1, Sample::Battery(_));
    assert_eq!(heard.samples.iter().filter(batteries).count(), 2);
    let counted = |(_, sample): &(usize, Sample)| match sample {
        Sample::Radio(radio) => Some((radio.received, radio.lost)),
        _ => None,
    };
    let radios: Vec<_> = heard.samples.iter().filter_map(counted).collect();
    assert_eq!(radios.last(), Some(&(190, 10)));
    let charge = heard.samples.iter().find_map(|(_, sample)| match sample {
        Sample::Battery(battery) => Some((battery.charge, battery.charging)),
        _ => None,
    });
    assert_eq!(charge, Some((0.77, true)), "4.35 V: on its charger");
}
