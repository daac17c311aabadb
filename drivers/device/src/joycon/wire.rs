//! Reports, byte by byte; numbers are little-endian. Offsets count the report id.

use crate::decode::DecodeError;

/// Input report with the answer to a subcommand.
pub const REPLY: u8 = 0x21;
/// Input reports with inertial samples: plain, with infrared camera data, and two that are like
/// them.
pub const FULL: [u8; 4] = [0x30, 0x31, 0x32, 0x33];
/// Output report with a subcommand.
pub const SUBCOMMAND: u8 = 0x01;

/// Subcommand: what the device is.
pub const DEVICE_INFO: u8 = 0x02;
/// Subcommand: which input report it sends.
pub const SET_REPORT: u8 = 0x03;
/// Subcommand: read its flash memory.
pub const FLASH_READ: u8 = 0x10;
/// Subcommand: switch the inertial sensors.
pub const SET_IMU: u8 = 0x40;

/// Where inertial samples begin in a report.
const IMU_AT: usize = 13;
/// Length of one inertial sample.
const SAMPLE_BYTES: usize = 12;
/// Where a subcommand stands in output report 0x01, behind a counter and two motors.
const SUBCOMMAND_AT: usize = 10;

/// One inertial sample as it stands in a report. What is called `gyro` here is that only in
/// [`ImuMode::Raw`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RawImu {
    /// Accelerometer, counts.
    pub accel: [i16; 3],
    /// Gyroscope, counts, or bits of a packed rotation.
    pub gyro: [i16; 3],
}

impl RawImu {
    /// Whether there is nothing in it: what devices send until their sensors have started.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// How the inertial sensors report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ImuMode {
    /// Nobody has said.
    #[default]
    Unknown,
    /// Not at all.
    Off,
    /// Accelerometer and gyroscope.
    Raw,
    /// The accelerometer, and a rotation packed into the gyroscope's place.
    Packed,
}

impl ImuMode {
    /// What subcommand 0x40 asks for with this argument.
    #[must_use]
    pub fn asked_for(argument: u8) -> Self {
        match argument {
            0 => Self::Off,
            1 => Self::Raw,
            2 | 3 => Self::Packed,
            _ => Self::Unknown,
        }
    }

    /// The word used in JSON output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Off => "off",
            Self::Raw => "raw",
            Self::Packed => "packed rotation",
        }
    }
}

/// The part that input reports 0x21 and 0x30-0x33 have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Common {
    /// Counts 5 ms, wraps.
    pub timer: u8,
    /// Bits 5-7 charge in quarters, bit 4 charging, bits 0-3 connection.
    pub battery: u8,
    /// Buttons: of the right hand, of both, of the left hand.
    pub buttons: [u8; 3],
    /// Left and right stick, 12 bits an axis.
    pub sticks: [[u16; 2]; 2],
}

/// An input report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input<'a> {
    /// With inertial samples, oldest first, 5 ms apart.
    Full(Common, [RawImu; 3]),
    /// With the answer to a subcommand.
    Reply(Common, Reply<'a>),
    /// Another report, of which nothing is needed.
    Other,
}

/// The answer to a subcommand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    /// Bit 7: it was carried out.
    pub accepted: bool,
    /// Which one.
    pub subcommand: u8,
    /// What it gave.
    pub data: &'a [u8],
}

/// Takes an input report apart.
///
/// # Errors
/// It is shorter than its kind has to be.
pub fn input(report: &[u8]) -> Result<Input<'_>, DecodeError> {
    let Some(&id) = report.first() else {
        return Err(too_short(0, report, 1));
    };
    if id == REPLY {
        let needed = IMU_AT + 2;
        let (head, data) = report
            .split_at_checked(needed)
            .ok_or_else(|| too_short(id, report, needed))?;
        let reply = Reply {
            accepted: head[IMU_AT] & 0x80 != 0,
            subcommand: head[IMU_AT + 1],
            data,
        };
        return Ok(Input::Reply(common(head), reply));
    }
    if !FULL.contains(&id) {
        return Ok(Input::Other);
    }
    let needed = IMU_AT + 3 * SAMPLE_BYTES;
    let whole = report
        .get(..needed)
        .ok_or_else(|| too_short(id, report, needed))?;
    let samples = std::array::from_fn(|n| sample(&whole[IMU_AT + n * SAMPLE_BYTES..]));
    Ok(Input::Full(common(whole), samples))
}

fn too_short(id: u8, report: &[u8], needed: usize) -> DecodeError {
    DecodeError::TooShort {
        id,
        got: report.len(),
        needed,
    }
}

/// `report` holds at least the common part.
fn common(report: &[u8]) -> Common {
    let stick = |at: usize| {
        let [a, b, c] = [report[at], report[at + 1], report[at + 2]].map(u16::from);
        [a | (b & 0x0f) << 8, b >> 4 | c << 4]
    };
    Common {
        timer: report[1],
        battery: report[2],
        buttons: [report[3], report[4], report[5]],
        sticks: [stick(6), stick(9)],
    }
}

fn sample(bytes: &[u8]) -> RawImu {
    let short = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
    RawImu {
        accel: [short(0), short(2), short(4)],
        gyro: [short(6), short(8), short(10)],
    }
}

/// The mode that an output report asks for, if it is subcommand 0x40.
#[must_use]
pub fn imu_request(output: &[u8]) -> Option<ImuMode> {
    let asked = output.first() == Some(&SUBCOMMAND) && output.get(SUBCOMMAND_AT) == Some(&SET_IMU);
    let argument = output.get(SUBCOMMAND_AT + 1).filter(|_| asked)?;
    Some(ImuMode::asked_for(*argument))
}

/// An output report with a subcommand; the motors stand still. `counter` counts such reports.
#[must_use]
pub fn subcommand(counter: u8, subcommand: u8, arguments: &[u8]) -> Vec<u8> {
    const STILL: [u8; 4] = [0x00, 0x01, 0x40, 0x40];
    let mut report = vec![SUBCOMMAND, counter & 0x0f];
    report.extend(STILL);
    report.extend(STILL);
    report.push(subcommand);
    report.extend_from_slice(arguments);
    report.resize(49, 0);
    report
}
