//! Radio packets, as the "watchman" dongles hand them on in reports 0x23 and 0x24: the protocol
//! that wands and trackers of the first generation speak (version 1), and the one that Index
//! controllers speak from the start and the others after their switch (version 2).

use super::wire::{Fields, RawImu};
use crate::decode::DecodeError;

/// Bytes of a packet inside its report.
pub(super) const PACKET_BYTES: usize = 29;

/// Which protocol a packet is read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// Events told by 111xxxxx in the first byte, anything else light of generation 1.
    V1,
    /// A byte of flags for what follows: IMU, metadata, input, light.
    V2,
}

/// Input that a packet carries; what is `None` did not change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RadioInput {
    /// Bit set of pressed buttons.
    pub buttons: Option<u8>,
    /// Trigger, 0 to 255.
    pub trigger: Option<u8>,
    /// Pad or stick, x and y.
    pub pad: Option<[i16; 2]>,
    /// An Index controller's touched buttons.
    pub touched: Option<u8>,
    /// An Index controller's grip force, 0 to 255.
    pub grip: Option<u8>,
}

/// A part of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part<'a> {
    /// Inertial sample.
    Imu(RawImu),
    /// Battery: bit 7 charging, the others per cent.
    Battery(u8),
    /// Buttons and the like.
    Input(RadioInput),
    /// The light, to the packet's end: of generation 1 in version 1, a stream as in report 0x28
    /// in version 2.
    Light(&'a [u8]),
}

/// A packet taken out of its report.
#[derive(Debug, Clone, Copy)]
pub(super) struct RadioPacket<'a> {
    id: u8,
    /// Bits 31 to 16 of the device time at which it was sent.
    time: u16,
    payload: &'a [u8],
}

impl<'a> RadioPacket<'a> {
    /// Takes a packet of [`PACKET_BYTES`] out of report `id`.
    pub(super) fn new(id: u8, data: &'a [u8]) -> Result<Self, DecodeError> {
        let mut fields = Fields::new(id, data);
        let [high, size, low] = fields.bytes()?;
        let rest = fields.rest();
        let payload = rest
            .get(..usize::from(size).saturating_sub(1))
            .ok_or_else(|| fields.malformed("a radio packet is longer than its report"))?;
        Ok(Self {
            id,
            time: u16::from_be_bytes([high, low]),
            payload,
        })
    }

    /// Device time at which it was sent, to 2^16 ticks (1.4 ms).
    pub(super) fn ticks(&self) -> u32 {
        u32::from(self.time) << 16
    }

    /// The protocol that this packet alone gives away: an IMU sample and nothing else looks
    /// different in each, and is sent hundreds of times a second.
    pub(super) fn version(&self) -> Option<Version> {
        const IMU_ALONE: usize = 14;
        match self.payload {
            [0xe8, ..] if self.payload.len() == IMU_ALONE => Some(Version::V1),
            [0x80, ..] if self.payload.len() == IMU_ALONE => Some(Version::V2),
            _ => None,
        }
    }

    /// Whether a packet of version 2 says that light follows.
    pub(super) fn has_light(&self) -> bool {
        self.payload
            .first()
            .is_some_and(|flags| flags & 0x10 != 0 && *flags != HEARTBEAT)
    }

    /// Calls `part` for each part, in order.
    ///
    /// # Errors
    /// The packet ends early or holds an event that is not known; parts before that are valid.
    pub(super) fn parts(
        &self,
        version: Version,
        part: impl FnMut(Part<'a>),
    ) -> Result<(), DecodeError> {
        match version {
            Version::V1 => self.parts_v1(part),
            Version::V2 => self.parts_v2(part),
        }
    }

    fn parts_v1(&self, mut part: impl FnMut(Part<'a>)) -> Result<(), DecodeError> {
        let mut fields = Fields::new(self.id, self.payload);
        while let Some(&flags) = fields.rest().first() {
            if flags & 0xe0 != 0xe0 {
                part(Part::Light(fields.rest()));
                return Ok(());
            }
            if flags == HEARTBEAT {
                return Ok(());
            }
            fields.u8()?;
            if flags & 0x10 != 0 {
                part(Part::Input(input(flags, &mut fields)?));
            } else if flags & 0x06 != 0 {
                return Err(fields.malformed("an event of a radio packet is not known"));
            } else if flags & 0x01 != 0 {
                part(Part::Battery(fields.u8()?));
            }
            if flags & 0x08 != 0 {
                part(Part::Imu(self.imu(&mut fields)?));
            }
        }
        Ok(())
    }

    fn parts_v2(&self, mut part: impl FnMut(Part<'a>)) -> Result<(), DecodeError> {
        let mut fields = Fields::new(self.id, self.payload);
        if self.payload.is_empty() {
            return Ok(());
        }
        let flags = fields.u8()?;
        if flags == HEARTBEAT {
            return Ok(());
        }
        if flags & 0x80 != 0 {
            part(Part::Imu(self.imu(&mut fields)?));
        }
        let light = flags & 0x10 != 0;
        if flags & 0x60 != 0 {
            // Where light follows, the low bits say how long the part before it is.
            let length = if light {
                usize::from(flags & 0x0f) + 1
            } else {
                fields.rest().len()
            };
            let mut section = Fields::new(self.id, fields.slice(length)?);
            if flags & 0x40 != 0 {
                metadata(&mut section, &mut part)?;
            }
            if flags & 0x20 != 0 {
                let what = section.u8()?;
                part(Part::Input(input(what, &mut section)?));
            }
        }
        if light {
            part(Part::Light(fields.rest()));
        } else if !fields.rest().is_empty() {
            return Err(fields.malformed("a radio packet goes on after its last part"));
        }
        Ok(())
    }

    /// A sample; its time completes the packet's.
    fn imu(&self, fields: &mut Fields<'a>) -> Result<RawImu, DecodeError> {
        let low = fields.u8()?;
        let ticks = self.ticks() | u32::from(low) << 8;
        Ok(RawImu {
            ticks,
            accel: fields.vector()?,
            gyro: fields.vector()?,
        })
    }
}

/// A marker, then what it announces; only the battery's meaning is known.
fn metadata<'a>(
    section: &mut Fields<'a>,
    part: &mut impl FnMut(Part<'a>),
) -> Result<(), DecodeError> {
    const BATTERY: u8 = 0x80;
    const KNOWN: [(u8, usize); 4] = [(BATTERY, 1), (0x20, 1), (0x40, 1), (0x30, 2)];
    let marker = section.u8()?;
    let known = KNOWN.iter().find(|(known, _)| *known == marker);
    let data = section.slice(known.map_or(section.rest().len(), |(_, length)| *length))?;
    if let (BATTERY, [byte]) = (marker, data) {
        part(Part::Battery(*byte));
    }
    Ok(())
}

/// Sent while a device has nothing to say.
const HEARTBEAT: u8 = 0xe2;

fn input(flags: u8, fields: &mut Fields<'_>) -> Result<RadioInput, DecodeError> {
    const CAPACITIVE: u8 = 0xa1;
    let mut input = RadioInput::default();
    if flags & 0x07 == 0 {
        if fields.u8()? != CAPACITIVE {
            return Err(fields.malformed("an input event of a radio packet is not known"));
        }
        // The fingers' proximities lie between the touched buttons and the forces.
        let [touched, _, _, _, _, grip, _] = fields.bytes()?;
        (input.touched, input.grip) = (Some(touched), Some(grip));
        return Ok(input);
    }
    if flags & 0x01 != 0 {
        input.buttons = Some(fields.u8()?);
    }
    if flags & 0x04 != 0 {
        input.trigger = Some(fields.u8()?);
    }
    if flags & 0x02 != 0 {
        input.pad = Some([fields.i16()?, fields.i16()?]);
    }
    Ok(input)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn packet(payload: &[u8]) -> Vec<u8> {
        let mut data = vec![0x12, payload.len() as u8 + 1, 0x34];
        data.extend(payload);
        data.resize(PACKET_BYTES, 0);
        data
    }

    fn parts(version: Version, payload: &[u8]) -> Result<Vec<String>, DecodeError> {
        let data = packet(payload);
        let mut found = Vec::new();
        RadioPacket::new(0x23, &data)?
            .parts(version, |part| found.push(format!("{part:?}")))
            .map(|()| found)
    }

    const IMU: [u8; 13] = [0x56, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0];

    fn imu() -> String {
        let sample = RawImu {
            ticks: 0x1234_5600,
            accel: [1, 2, 3],
            gyro: [4, 5, 6],
        };
        format!("{:?}", Part::Imu(sample))
    }

    #[test]
    fn version_2_is_read() {
        let with = |flags: u8, rest: &[u8]| [&[flags][..], &IMU, rest].concat();
        assert_eq!(parts(Version::V2, &with(0x80, &[])).unwrap(), [imu()]);
        // As libsurvive notes them from a Knuckles: battery, metadata of one byte, then light.
        let battery = format!("{:?}", Part::Battery(0xd0));
        assert_eq!(
            parts(Version::V2, &with(0xc0, &[0x80, 0xd0])).unwrap(),
            [imu(), battery]
        );
        let light = format!("{:?}", Part::Light(&[0x61, 0x50, 0xd2, 0x57, 0x01]));
        let found = parts(
            Version::V2,
            &[0x51, 0x20, 0x01, 0x61, 0x50, 0xd2, 0x57, 0x01],
        );
        assert_eq!(found.unwrap(), [light]);
        let pulled = RadioInput {
            trigger: Some(0x39),
            ..RadioInput::default()
        };
        let found = parts(Version::V2, &[0x20, 0xf4, 0x39]).unwrap();
        assert_eq!(found, [format!("{:?}", Part::Input(pulled))]);
        let touch = [0x20, 0xf0, 0xa1, 0x20, 0, 1, 0, 0, 7, 0];
        let touched = RadioInput {
            touched: Some(0x20),
            grip: Some(7),
            ..RadioInput::default()
        };
        let found = parts(Version::V2, &touch).unwrap();
        assert_eq!(found, [format!("{:?}", Part::Input(touched))]);
        assert!(
            parts(Version::V2, &with(0x80, &[0])).is_err(),
            "a byte too many"
        );
        assert!(
            parts(Version::V2, &with(0xd1, &[0x80])).is_err(),
            "shorter than it says"
        );
    }

    /// From captures of a tracker and an Index controller (libsurvive-extras-data,
    /// tracker-cal-attempt and knuckles_all_buttons).
    #[test]
    fn the_part_before_the_light_says_its_length() {
        let light = |bytes| vec![format!("{:?}", Part::Light(bytes))];
        let unknown = [0x53, 0x70, 0x0b, 0, 0, 0x61];
        assert_eq!(parts(Version::V2, &unknown).unwrap(), light(&[0x61]));
        let zeros = [0x52, 0x30, 0, 0, 0x98];
        assert_eq!(parts(Version::V2, &zeros).unwrap(), light(&[0x98]));
        let grip = [0x38, 0xf0, 0xa1, 0, 0, 0, 0, 0, 5, 0, 0x31, 0x36];
        let found = parts(Version::V2, &grip).unwrap();
        assert_eq!(found[1..], light(&[0x31, 0x36]));
    }

    #[test]
    fn version_1_is_read() {
        assert_eq!(
            parts(Version::V1, &[&[0xe8][..], &IMU].concat()).unwrap(),
            [imu()]
        );
        let light = format!("{:?}", Part::Light(&[0x2b, 0x51]));
        let battery = format!("{:?}", Part::Battery(0x57));
        let found = parts(Version::V1, &[0xe1, 0x57, 0x2b, 0x51]).unwrap();
        assert_eq!(found, [battery, light]);
        let pressed = RadioInput {
            buttons: Some(1),
            trigger: Some(9),
            pad: Some([-2, 3]),
            ..RadioInput::default()
        };
        let found = parts(Version::V1, &[0xf7, 1, 9, 0xfe, 0xff, 3, 0]).unwrap();
        assert_eq!(found, [format!("{:?}", Part::Input(pressed))]);
        assert_eq!(
            parts(Version::V1, &[0xe2, 1, 2]).unwrap(),
            Vec::<String>::new()
        );
    }

    #[test]
    fn a_size_beyond_the_report_is_an_error() {
        let mut data = packet(&[0x80]);
        data[1] = 28;
        assert!(RadioPacket::new(0x23, &data).is_err());
        data[1] = 0;
        assert!(RadioPacket::new(0x23, &data).is_ok());
    }

    proptest! {
        #[test]
        fn any_bytes_give_an_answer(data in prop::collection::vec(any::<u8>(), 0..32)) {
            if let Ok(packet) = RadioPacket::new(0x24, &data) {
                let _ = (packet.version(), packet.has_light());
                let _ = packet.parts(Version::V1, |_| {});
                let _ = packet.parts(Version::V2, |_| {});
            }
        }
    }
}
