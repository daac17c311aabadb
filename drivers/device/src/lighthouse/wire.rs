//! Reports as they come over USB, and the pieces that radio packets share with them. Layouts are
//! from libsurvive (MIT) and nairol's LighthouseRedox (CC-BY 4.0), checked against captures.

use crate::decode::DecodeError;

/// Ticks of a Lighthouse device's clock in a second.
pub const TICKS_PER_SECOND: f64 = 48e6;

/// Report ids.
pub(super) mod id {
    /// Buttons, battery, proximity; as a feature report the ranges of the IMU.
    pub(crate) const INPUT: u8 = 0x01;
    /// Status of a Vive's mainboard.
    pub(crate) const MAINBOARD: u8 = 0x03;
    /// Inertial samples.
    pub(crate) const IMU: u8 = 0x20;
    /// Pulses of generation-1 base stations, as trackers and wands report them.
    pub(crate) const PULSES_TRACKER: u8 = 0x21;
    /// One radio packet.
    pub(crate) const RADIO: u8 = 0x23;
    /// Two radio packets.
    pub(crate) const RADIO_TWO: u8 = 0x24;
    /// Pulses of generation-1 base stations, as headsets report them.
    pub(crate) const PULSES_HEADSET: u8 = 0x25;
    /// The device behind the dongle was switched off.
    pub(crate) const RADIO_OFF: u8 = 0x26;
    /// Undecoded beams of generation-2 base stations: the device waits for the mode switch.
    pub(crate) const RAW_BEAMS: u8 = 0x27;
    /// Syncs and sweeps of generation-2 base stations.
    pub(crate) const LIGHT: u8 = 0x28;
    /// Feature report that starts a read of the configuration.
    pub(crate) const CONFIGURATION_START: u8 = 0x10;
    /// Feature report that holds the next piece of the configuration.
    pub(crate) const CONFIGURATION_READ: u8 = 0x11;
    /// Feature report that switches the light's mode.
    pub(crate) const MODE: u8 = 0x04;
    /// Feature report that sets what is reported.
    pub(crate) const VERBOSITY: u8 = 0x07;
    /// Feature report that makes a wired device buzz; by radio, the same as a command.
    pub(crate) const HAPTIC: u8 = 0x8f;
    /// Feature report that carries a radio command.
    pub(crate) const RADIO_COMMAND: u8 = 0xff;
}

/// Takes fields off the front of a report.
#[derive(Debug, Clone)]
pub(super) struct Fields<'a> {
    id: u8,
    all: usize,
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// The fields of report `id` from its data, report id left out.
    pub(super) fn new(id: u8, data: &'a [u8]) -> Self {
        Self {
            id,
            all: data.len() + 1,
            rest: data,
        }
    }

    /// The next `N` bytes.
    pub(super) fn bytes<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let Some((head, rest)) = self.rest.split_first_chunk::<N>() else {
            let needed = self.all - self.rest.len() + N;
            return Err(DecodeError::TooShort {
                id: self.id,
                got: self.all,
                needed,
            });
        };
        self.rest = rest;
        Ok(*head)
    }

    /// The next `count` bytes.
    pub(super) fn slice(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let Some((head, rest)) = self.rest.split_at_checked(count) else {
            let needed = self.all - self.rest.len() + count;
            return Err(DecodeError::TooShort {
                id: self.id,
                got: self.all,
                needed,
            });
        };
        self.rest = rest;
        Ok(head)
    }

    pub(super) fn u8(&mut self) -> Result<u8, DecodeError> {
        self.bytes().map(|[byte]| byte)
    }

    pub(super) fn u16(&mut self) -> Result<u16, DecodeError> {
        self.bytes().map(u16::from_le_bytes)
    }

    pub(super) fn i16(&mut self) -> Result<i16, DecodeError> {
        self.bytes().map(i16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, DecodeError> {
        self.bytes().map(u32::from_le_bytes)
    }

    /// Three signed numbers, x, y and z.
    pub(super) fn vector(&mut self) -> Result<[i16; 3], DecodeError> {
        Ok([self.i16()?, self.i16()?, self.i16()?])
    }

    /// What has not been taken yet.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub(super) fn malformed(&self, what: &'static str) -> DecodeError {
        DecodeError::Malformed { id: self.id, what }
    }
}

/// An inertial sample in the sensor's own units and axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RawImu {
    /// Device time, wraps.
    pub ticks: u32,
    /// Accelerometer, LSB.
    pub accel: [i16; 3],
    /// Gyroscope, LSB.
    pub gyro: [i16; 3],
}

/// Joins the reports 0x20: each repeats the last three samples, the oldest in any slot.
#[derive(Debug, Clone, Default)]
pub(super) struct ImuRing {
    last: Option<u8>,
    in_slot_order: (Option<u8>, u64),
}

impl ImuRing {
    /// Samples so far, had the slots been taken as they lie: where a report has its oldest sample
    /// last, this loses two. Published counts of captures are often made this way.
    pub(super) fn in_slot_order(&self) -> u64 {
        self.in_slot_order.1
    }

    /// The samples of a report that were not in the reports before, oldest first. Of the very
    /// first report only the newest counts: the others may stem from before a reset.
    pub(super) fn samples(
        &mut self,
        data: &[u8],
    ) -> Result<impl Iterator<Item = RawImu> + use<>, DecodeError> {
        let mut fields = Fields::new(id::IMU, data);
        let mut slots = [(0, RawImu::default()); 3];
        for slot in &mut slots {
            let (accel, gyro) = (fields.vector()?, fields.vector()?);
            let sample = RawImu {
                ticks: fields.u32()?,
                accel,
                gyro,
            };
            *slot = (fields.u8()?, sample);
        }
        let newer = |a: u8, b: u8| a.wrapping_sub(b).cast_signed() > 0;
        for (sequence, _) in slots {
            if self
                .in_slot_order
                .0
                .is_none_or(|last| newer(sequence, last))
            {
                self.in_slot_order = (Some(sequence), self.in_slot_order.1 + 1);
            }
        }
        let newest = slots
            .iter()
            .map(|slot| slot.0)
            .fold(slots[0].0, |best, sequence| {
                if newer(sequence, best) {
                    sequence
                } else {
                    best
                }
            });
        slots.sort_by_key(|slot| slot.0.wrapping_sub(newest).cast_signed());
        let mut last = self.last.replace(newest).unwrap_or(newest.wrapping_sub(1));
        let fresh = slots.into_iter().filter(move |slot| {
            let fresh = newer(slot.0, last);
            if fresh {
                last = slot.0;
            }
            fresh
        });
        Ok(fresh.map(|slot| slot.1))
    }
}

/// What the light of generation-2 base stations said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Light {
    /// A rotor passed its zero.
    Sync {
        /// The base station's channel.
        channel: u8,
        /// Device time, 24 bits of 48 MHz.
        time: u32,
        /// The bit of the base station's slow data stream that this revolution carries.
        data: bool,
    },
    /// A light plane passed a sensor.
    Sweep {
        /// The base station's channel.
        channel: u8,
        /// The sensor's hardware channel.
        sensor: u8,
        /// Device time, 25 bits of 96 MHz.
        time: u32,
    },
}

/// Reads a light stream (report 0x28 and radio packets alike): channel markers of one byte, which
/// have bit 0 set, and words of four bytes, which belong to the channel before them. `light` is
/// called for every word.
///
/// # Errors
/// The stream does not begin with a marker, or ends inside a word. Words before that are valid.
pub(super) fn light_stream(
    id: u8,
    data: &[u8],
    mut light: impl FnMut(Light),
) -> Result<(), DecodeError> {
    let mut fields = Fields::new(id, data);
    let mut channel = None;
    while let Some(&first) = fields.rest().first() {
        if first & 1 != 0 {
            // Bit 2 says that two base stations share the channel; the others are always clear.
            if first & 0x0a != 0 {
                return Err(fields.malformed("a channel marker has bits set that none has"));
            }
            channel = Some(first >> 4);
            fields.u8()?;
            continue;
        }
        let word = fields.u32()?;
        let Some(channel) = channel else {
            return Err(fields.malformed("the light stream does not begin with a channel"));
        };
        light(if word & 2 == 0 {
            Light::Sync {
                channel,
                time: word >> 2 & 0xff_ffff,
                data: word >> 26 & 1 != 0,
            }
        } else {
            Light::Sweep {
                channel,
                sensor: (word >> 27) as u8,
                time: word >> 2 & 0x1ff_ffff,
            }
        });
    }
    Ok(())
}

/// The light stream inside a report 0x28, whose first byte says how long it is.
pub(super) fn light_report(data: &[u8]) -> Result<&[u8], DecodeError> {
    let mut fields = Fields::new(id::LIGHT, data);
    let length = fields.u8()?;
    fields.slice(usize::from(length))
}

/// A light pulse, as devices report it under base stations of generation 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pulse {
    /// The sensor's hardware channel.
    pub sensor: u8,
    /// Length, ticks.
    pub length: u16,
    /// Device time of its beginning, wraps.
    pub ticks: u32,
}

/// The pulses of a report 0x21 (seven, the sensor in two bytes) or 0x25 (nine, in one).
pub(super) fn pulses(id: u8, data: &[u8], mut pulse: impl FnMut(Pulse)) -> Result<(), DecodeError> {
    const EMPTY: u16 = 0xfd;
    let mut fields = Fields::new(id, data);
    let count = if id == id::PULSES_TRACKER { 7 } else { 9 };
    for _ in 0..count {
        let sensor = if id == id::PULSES_TRACKER {
            fields.u16()?
        } else {
            fields.u8()?.into()
        };
        let (length, ticks) = (fields.u16()?, fields.u32()?);
        // Unused slots count 0xfe and 0xff; the tracker's have a second byte of 0xff.
        if sensor & 0xff <= EMPTY {
            pulse(Pulse {
                sensor: sensor as u8,
                length,
                ticks,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A report 0x20 with three samples in the given order; each is told by its sequence number.
    fn imu_report(sequence: [u8; 3]) -> Vec<u8> {
        let mut data = Vec::new();
        for number in sequence {
            for axis in [i16::from(number), 2, 3, 4, 5, 6] {
                data.extend(axis.to_le_bytes());
            }
            data.extend((1_000 * u32::from(number)).to_le_bytes());
            data.push(number);
        }
        data
    }

    fn sequence(ring: &mut ImuRing, sequence: [u8; 3]) -> Vec<i16> {
        ring.samples(&imu_report(sequence))
            .unwrap()
            .map(|sample| sample.accel[0])
            .collect()
    }

    #[test]
    fn imu_samples_come_once_and_in_order() {
        let mut ring = ImuRing::default();
        assert_eq!(
            sequence(&mut ring, [9, 7, 8]),
            [9],
            "the others may be stale"
        );
        assert_eq!(sequence(&mut ring, [9, 10, 8]), [10]);
        assert_eq!(
            sequence(&mut ring, [12, 10, 11]),
            [11, 12],
            "the oldest is in any slot"
        );
        assert!(sequence(&mut ring, [12, 10, 11]).is_empty());
        assert!(
            sequence(&mut ring, [255, 253, 254]).is_empty(),
            "older, not newer"
        );
        let mut ring = ImuRing::default();
        assert_eq!(sequence(&mut ring, [253, 254, 252]), [254]);
        assert_eq!(
            sequence(&mut ring, [0, 254, 255]),
            [255, 0],
            "the sequence number wraps"
        );
    }

    #[test]
    fn a_short_imu_report_is_an_error() {
        let error = ImuRing::default().samples(&[0; 50]).err();
        assert_eq!(
            error,
            Some(DecodeError::TooShort {
                id: 0x20,
                got: 51,
                needed: 52
            })
        );
    }

    /// Channel 6: a sync whose data bit is set and a sweep of sensor 17; channel 9: a sweep.
    #[test]
    fn a_light_stream_is_read() {
        let sync = 0x12_3456u32 << 2 | 1 << 26;
        let sweep = 0x155_5555u32 << 2 | 2 | 17 << 27;
        let mut data = vec![0x61];
        data.extend(sync.to_le_bytes());
        data.extend(sweep.to_le_bytes());
        data.push(0x91);
        data.extend(sweep.to_le_bytes());
        let mut lights = Vec::new();
        light_stream(0x28, &data, |light| lights.push(light)).unwrap();
        let swept = |channel| Light::Sweep {
            channel,
            sensor: 17,
            time: 0x155_5555,
        };
        let sync = Light::Sync {
            channel: 6,
            time: 0x12_3456,
            data: true,
        };
        assert_eq!(lights, [sync, swept(6), swept(9)]);
        let torn = light_stream(0x28, &data[..data.len() - 1], |_| {}).unwrap_err();
        assert_eq!(
            torn,
            DecodeError::TooShort {
                id: 0x28,
                got: 14,
                needed: 15
            }
        );
        assert!(
            light_stream(0x28, &data[1..], |_| {}).is_err(),
            "no channel"
        );
        assert!(
            light_stream(0x28, &[0x63], |_| {}).is_err(),
            "no marker looks like that"
        );
    }

    #[test]
    fn pulses_leave_out_empty_slots() {
        let mut data = vec![0xff; 57];
        data[..8].copy_from_slice(&[5, 0, 0x10, 0x27, 1, 2, 3, 4]);
        let mut found = Vec::new();
        pulses(0x21, &data, |pulse| found.push(pulse)).unwrap();
        assert_eq!(
            found,
            [Pulse {
                sensor: 5,
                length: 10_000,
                ticks: 0x0403_0201
            }]
        );
        let mut data = vec![0xff; 63];
        data[7..14].copy_from_slice(&[31, 0x10, 0x27, 1, 2, 3, 4]);
        let mut found = Vec::new();
        pulses(0x25, &data, |pulse| found.push(pulse)).unwrap();
        assert_eq!(
            found,
            [Pulse {
                sensor: 31,
                length: 10_000,
                ticks: 0x0403_0201
            }]
        );
    }

    proptest! {
        #[test]
        fn any_bytes_give_an_answer(data in prop::collection::vec(any::<u8>(), 0..80)) {
            let _ = light_report(&data);
            let _ = light_stream(0x28, &data, |light| {
                let (Light::Sync { channel, time, .. }
                    | Light::Sweep { channel, time, .. }) = light;
                assert!(channel < 16 && time < 1 << 25);
            });
            let _ = pulses(0x21, &data, |pulse| assert!(pulse.sensor <= 0xfd));
            let _ = pulses(0x25, &data, |pulse| assert!(pulse.sensor <= 0xfd));
            if let Ok(samples) = ImuRing::default().samples(&data) {
                prop_assert!(samples.count() <= 3);
            }
        }
    }
}
