//! Reports of the SlimeVR HID protocol, byte by byte: 64 bytes without a report id, four packets
//! of 16 bytes, unused ones all zero. Byte 0 of a packet is its type, byte 1 the tracker's number
//! at the receiver, the rest little-endian.
//!
//! Rotations are here as on the wire: the tracker's own frame (x to its right, y to its top, z out
//! of its face) to a world whose z is up. [`WORLD`] turns that world into posed's.

use std::f32::consts::FRAC_PI_2;

use glam::{Quat, Vec3};

use crate::decode::DecodeError;

/// Length of a report.
pub const REPORT_BYTES: usize = 64;
/// Length of a packet.
pub const PACKET_BYTES: usize = 16;
/// Packets in a report.
pub const PACKETS: usize = REPORT_BYTES / PACKET_BYTES;
/// From the protocol's world, z up, to posed's, y up: -90 degrees about x.
pub const WORLD: Quat = Quat::from_xyzw(
    -std::f32::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f32::consts::FRAC_1_SQRT_2,
);

/// A 1 in 16-bit rotations.
const ROTATION_ONE: f32 = 32_768.0;
/// 1 m/s^2.
const ACCEL_ONE: f32 = 128.0;
/// 1 gauss.
const FIELD_ONE: f32 = 1_024.0;
/// Beyond this error of its length, a rotation is not one: the receiver's own limit is 0.001.
const LENGTH_ERROR_MAX: f32 = 0.01;
/// Bits of the three numbers of a packed rotation.
const PACKED_BITS: [u32; 3] = [10, 11, 11];
/// Trackers on a charger give no less than this, volts.
const CHARGING_V: f32 = 4.3;

/// A packet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Packet {
    /// The tracker's number at its receiver.
    pub tracker: u8,
    /// What it says.
    pub content: Content,
}

/// What a packet says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Content {
    /// Type 0: what the tracker is.
    Info {
        /// Its battery.
        power: Power,
        /// Its firmware.
        firmware: Firmware,
        /// How well it is heard.
        signal: Signal,
    },
    /// Type 1: motion in full precision.
    Motion(Motion),
    /// Type 2: motion in less precision, and the battery.
    MotionAndPower {
        /// The motion.
        motion: Motion,
        /// The battery.
        power: Power,
        /// How well the tracker is heard.
        signal: Signal,
    },
    /// Type 3: the radio link since the last packet of this type.
    Status {
        /// What arrived and what did not.
        link: LinkStatus,
        /// How well the tracker is heard.
        signal: Signal,
    },
    /// Type 4: rotation in full precision, and the magnetic field.
    Field {
        /// Tracker to world, unit.
        rotation: Quat,
        /// Gauss, in the tracker's frame.
        field: Vec3,
    },
    /// Type 5: time until the battery is empty.
    Runtime {
        /// Microseconds; negative where it is not known.
        micros: i64,
        /// How well the tracker is heard.
        signal: Signal,
    },
    /// Type 6: the tracker's button. Bytes 3 and 4, the time until it sleeps, are not read:
    /// sources disagree about their order.
    Button {
        /// 0 none, 1 pressed once, 2 twice.
        button: u8,
        /// How well the tracker is heard.
        signal: Signal,
    },
    /// Type 7: the button, and motion in less precision.
    MotionAndButton {
        /// The motion.
        motion: Motion,
        /// 0 none, 1 pressed once, 2 twice.
        button: u8,
        /// How well the tracker is heard.
        signal: Signal,
    },
    /// Type 255, by the receiver itself: which tracker has this number. It goes through all that
    /// it is paired with, heard or not.
    Register {
        /// The tracker's 48-bit address.
        address: u64,
    },
}

/// Orientation and acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Tracker to world, unit.
    pub rotation: Quat,
    /// m/s^2 in the tracker's frame, gravity taken out.
    pub accel: Vec3,
}

/// A tracker's battery.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Power {
    /// Bit 7: there is a battery; bits 0-6: percent. 128 is said before it was measured.
    pub battery: u8,
    /// Volts times 100, less 245.
    pub voltage: u8,
    /// Degrees Celsius plus 39, doubled; 0 where it is not known.
    pub temperature: u8,
}

impl Power {
    /// 0 to 1; `None` without a battery or before it was measured.
    #[must_use]
    pub fn charge(self) -> Option<f32> {
        let percent = f32::from((self.battery & 0x7f).min(100));
        (self.battery & 0x7f != 0).then_some(percent / 100.0)
    }

    /// Volts.
    #[must_use]
    pub fn volts(self) -> f32 {
        (f32::from(self.voltage) + 245.0) / 100.0
    }

    /// Whether it is on its charger.
    #[must_use]
    pub fn is_charging(self) -> bool {
        self.volts() >= CHARGING_V
    }

    /// Degrees Celsius.
    #[must_use]
    pub fn celsius(self) -> Option<f32> {
        (self.temperature != 0).then(|| f32::from(self.temperature) / 2.0 - 39.0)
    }
}

/// A tracker's hardware and firmware, in the numbers of SlimeVR's lists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Firmware {
    /// Board.
    pub board: u8,
    /// Processor.
    pub mcu: u8,
    /// Inertial sensor.
    pub imu: u8,
    /// Magnetometer: 0 none, 1 off, 2 on.
    pub magnetometer: u8,
    /// Year since 2020 in bits 9-15, month in 5-8, day in 0-4.
    pub date: u16,
    /// Major, minor, patch.
    pub version: [u8; 3],
}

/// Signal strength at the receiver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Signal(
    /// -dBm; 0 where it is not known, as on a cable.
    pub u8,
);

impl Signal {
    /// dBm.
    #[must_use]
    pub fn dbm(self) -> Option<f32> {
        (self.0 != 0).then(|| -f32::from(self.0))
    }
}

/// What arrived over the radio since the last packet that says so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkStatus {
    /// The tracker's state in the server's numbers: 1 is well.
    pub server_status: u8,
    /// The tracker's state in its own bits.
    pub status: u8,
    /// Packets that arrived.
    pub received: u8,
    /// Packets that did not.
    pub lost: u8,
    /// Packets in the tracker's own time slot.
    pub windows_hit: u8,
    /// Packets outside it.
    pub windows_missed: u8,
}

/// The packets of a report, in its order, without unused ones.
///
/// # Errors
/// The report is not 64 bytes long. A packet that cannot be read is an error of its own.
pub fn packets(
    report: &[u8],
) -> Result<impl Iterator<Item = Result<Packet, DecodeError>> + '_, DecodeError> {
    if report.len() != REPORT_BYTES {
        return Err(DecodeError::TooShort {
            id: 0,
            got: report.len(),
            needed: REPORT_BYTES,
        });
    }
    let (packets, _) = report.as_chunks::<PACKET_BYTES>();
    let used = packets.iter().filter(|bytes| bytes.iter().any(|&b| b != 0));
    Ok(used.map(Packet::read))
}

impl Packet {
    fn read(bytes: &[u8; PACKET_BYTES]) -> Result<Self, DecodeError> {
        let malformed = |what| DecodeError::Malformed { id: bytes[0], what };
        let signal = Signal(bytes[15]);
        let power = Power {
            battery: bytes[2],
            voltage: bytes[3],
            temperature: bytes[4],
        };
        let no_rotation = || malformed("its rotation is not of unit length");
        let full = || full_rotation(bytes).ok_or_else(no_rotation);
        let packed = || Motion {
            rotation: unpack(u32::from_le_bytes([bytes[5], bytes[6], bytes[7], bytes[8]])),
            accel: vector(bytes, 9) / ACCEL_ONE,
        };
        let content = match bytes[0] {
            0 => Content::Info {
                power,
                firmware: firmware(bytes),
                signal,
            },
            1 => Content::Motion(Motion {
                rotation: full()?,
                accel: vector(bytes, 10) / ACCEL_ONE,
            }),
            2 => Content::MotionAndPower {
                motion: packed(),
                power,
                signal,
            },
            3 => Content::Status {
                link: link_status(bytes),
                signal,
            },
            4 => Content::Field {
                rotation: full()?,
                field: vector(bytes, 10) / FIELD_ONE,
            },
            5 => Content::Runtime {
                micros: i64::from_le_bytes(std::array::from_fn(|at| bytes[2 + at])),
                signal,
            },
            6 => Content::Button {
                button: bytes[2],
                signal,
            },
            7 => Content::MotionAndButton {
                motion: packed(),
                button: bytes[2],
                signal,
            },
            255 => Content::Register {
                address: (0..6).fold(0, |address, at| {
                    address | u64::from(bytes[2 + at]) << (8 * at)
                }),
            },
            _ => return Err(malformed("a type of packet that is not known")),
        };
        Ok(Self {
            tracker: bytes[1],
            content,
        })
    }

    /// The packet as it stands in a report.
    #[must_use]
    pub fn write(&self) -> [u8; PACKET_BYTES] {
        let mut bytes = [0; PACKET_BYTES];
        bytes[1] = self.tracker;
        match self.content {
            Content::Info {
                power,
                firmware,
                signal,
            } => {
                write_power(&mut bytes, power);
                let Firmware { board, mcu, .. } = firmware;
                bytes[5..7].copy_from_slice(&[board, mcu]);
                bytes[8..10].copy_from_slice(&[firmware.imu, firmware.magnetometer]);
                bytes[10..12].copy_from_slice(&firmware.date.to_le_bytes());
                bytes[12..15].copy_from_slice(&firmware.version);
                bytes[15] = signal.0;
            }
            Content::Motion(motion) => {
                bytes[0] = 1;
                write_full_rotation(&mut bytes, motion.rotation);
                write_vector(&mut bytes, 10, motion.accel * ACCEL_ONE);
            }
            Content::MotionAndPower {
                motion,
                power,
                signal,
            } => {
                bytes[0] = 2;
                write_power(&mut bytes, power);
                write_packed(&mut bytes, motion, signal);
            }
            Content::Status { link, signal } => {
                bytes[0] = 3;
                bytes[2..8].copy_from_slice(&[
                    link.server_status,
                    link.status,
                    link.received,
                    link.lost,
                    link.windows_hit,
                    link.windows_missed,
                ]);
                bytes[15] = signal.0;
            }
            Content::Field { rotation, field } => {
                bytes[0] = 4;
                write_full_rotation(&mut bytes, rotation);
                write_vector(&mut bytes, 10, field * FIELD_ONE);
            }
            Content::Runtime { micros, signal } => {
                bytes[0] = 5;
                bytes[2..10].copy_from_slice(&micros.to_le_bytes());
                bytes[15] = signal.0;
            }
            Content::Button { button, signal } => {
                (bytes[0], bytes[2], bytes[15]) = (6, button, signal.0);
            }
            Content::MotionAndButton {
                motion,
                button,
                signal,
            } => {
                (bytes[0], bytes[2]) = (7, button);
                write_packed(&mut bytes, motion, signal);
            }
            Content::Register { address } => {
                bytes[0] = 255;
                bytes[2..8].copy_from_slice(&address.to_le_bytes()[..6]);
            }
        }
        bytes
    }
}

fn firmware(bytes: &[u8; PACKET_BYTES]) -> Firmware {
    Firmware {
        board: bytes[5],
        mcu: bytes[6],
        imu: bytes[8],
        magnetometer: bytes[9],
        date: u16::from_le_bytes([bytes[10], bytes[11]]),
        version: [bytes[12], bytes[13], bytes[14]],
    }
}

fn link_status(bytes: &[u8; PACKET_BYTES]) -> LinkStatus {
    LinkStatus {
        server_status: bytes[2],
        status: bytes[3],
        received: bytes[4],
        lost: bytes[5],
        windows_hit: bytes[6],
        windows_missed: bytes[7],
    }
}

fn short(bytes: &[u8; PACKET_BYTES], at: usize) -> f32 {
    f32::from(i16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

fn vector(bytes: &[u8; PACKET_BYTES], at: usize) -> Vec3 {
    Vec3::from_array([0, 2, 4].map(|offset| short(bytes, at + offset)))
}

fn full_rotation(bytes: &[u8; PACKET_BYTES]) -> Option<Quat> {
    let rotation = Quat::from_array([2, 4, 6, 8].map(|at| short(bytes, at) / ROTATION_ONE));
    let unit = (rotation.length() - 1.0).abs() < LENGTH_ERROR_MAX;
    unit.then(|| rotation.normalize())
}

/// A rotation from its packed exponential map (Reynolds 2017, "Quantizing quaternions"): three
/// numbers from -1 to 1, whose length times a quarter turn is half the angle.
fn unpack(packed: u32) -> Quat {
    let mut rest = packed;
    let numbers = PACKED_BITS.map(|bits| {
        let number = rest & ((1 << bits) - 1);
        rest >>= bits;
        number as f32 / (1u32 << bits) as f32 * 2.0 - 1.0
    });
    Quat::from_scaled_axis(Vec3::from_array(numbers) * (2.0 * FRAC_PI_2))
}

fn pack(rotation: Quat) -> u32 {
    let near = if rotation.w < 0.0 {
        -rotation
    } else {
        rotation
    };
    let numbers = (near.to_scaled_axis() / (2.0 * FRAC_PI_2)).to_array();
    let (mut packed, mut shift) = (0, 0);
    for (number, bits) in numbers.into_iter().zip(PACKED_BITS) {
        let steps = (1u32 << bits) as f32;
        // Rounded, where the firmware cuts off: half its error, the same values.
        let quantised = ((number + 1.0) / 2.0 * steps).round();
        packed |= (quantised.clamp(0.0, steps - 1.0) as u32) << shift;
        shift += bits;
    }
    packed
}

fn write_power(bytes: &mut [u8; PACKET_BYTES], power: Power) {
    bytes[2..5].copy_from_slice(&[power.battery, power.voltage, power.temperature]);
}

fn write_vector(bytes: &mut [u8; PACKET_BYTES], at: usize, counts: Vec3) {
    for (offset, count) in counts.to_array().into_iter().enumerate() {
        // A cast from a float saturates, as the firmware does.
        let count = count.round() as i16;
        bytes[at + 2 * offset..at + 2 * offset + 2].copy_from_slice(&count.to_le_bytes());
    }
}

fn write_full_rotation(bytes: &mut [u8; PACKET_BYTES], rotation: Quat) {
    for (offset, count) in (rotation * ROTATION_ONE).to_array().into_iter().enumerate() {
        let count = count.round() as i16;
        bytes[2 + 2 * offset..4 + 2 * offset].copy_from_slice(&count.to_le_bytes());
    }
}

fn write_packed(bytes: &mut [u8; PACKET_BYTES], motion: Motion, signal: Signal) {
    bytes[5..9].copy_from_slice(&pack(motion.rotation).to_le_bytes());
    write_vector(bytes, 9, motion.accel * ACCEL_ONE);
    bytes[15] = signal.0;
}
