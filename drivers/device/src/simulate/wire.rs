//! How reports leave the devices: the headset's interrupt endpoints, and the controllers' radio
//! with the dongle's endpoint behind it.

use std::collections::VecDeque;

use super::imu::RawImu;
use super::pulses::PulseQueue;
use super::queue::LightQueue;
use super::random::Random;

/// A report at an endpoint.
pub(super) type Report = (u8, Vec<u8>);

const IMU_ENDPOINT: u8 = 0x81;
const LIGHT_ENDPOINT: u8 = 0x83;

/// A device on its cable.
#[derive(Debug)]
pub(super) struct Cable {
    /// The last three samples, each at its sequence number modulo three.
    samples: [RawImu; 3],
    fresh: bool,
    /// What the device's buffer for light reports holds: the end of longer reports stays.
    light: [u8; 64],
}

impl Cable {
    /// Reports hold at most this many words; real ones do.
    const WORDS_MAX: usize = 14;
    const STREAM_MAX: usize = 62;

    pub(super) fn new() -> Self {
        Self {
            samples: [RawImu::default(); 3],
            fresh: false,
            light: [0; 64],
        }
    }

    pub(super) fn measured(&mut self, sample: RawImu) {
        self.samples[usize::from(sample.sequence) % 3] = sample;
        self.fresh = true;
    }

    /// What the host gets when it asks every endpoint once.
    pub(super) fn poll(
        &mut self,
        light: &mut LightQueue,
        pulses: &mut PulseQueue,
        reports: &mut Vec<Report>,
    ) {
        if std::mem::take(&mut self.fresh) {
            let mut report = vec![0x20];
            for sample in &self.samples {
                report.extend(imu_values(sample));
                report.extend(sample.ticks.to_le_bytes());
                report.push(sample.sequence);
            }
            reports.push((IMU_ENDPOINT, report));
        }
        if !pulses.is_empty() {
            reports.push((LIGHT_ENDPOINT, pulses.report()));
        }
        if light.ready() > 0 {
            let stream = light.pack(Self::WORDS_MAX, Self::STREAM_MAX);
            self.light[..2].copy_from_slice(&[0x28, stream.len() as u8]);
            self.light[2..2 + stream.len()].copy_from_slice(&stream);
            reports.push((LIGHT_ENDPOINT, self.light.to_vec()));
        }
    }
}

/// Accelerometer and gyroscope, 12 bytes.
fn imu_values(sample: &RawImu) -> impl Iterator<Item = u8> {
    let counts = sample.accel.into_iter().chain(sample.gyro);
    counts.flat_map(i16::to_le_bytes)
}

/// A controller's radio and the dongle.
#[derive(Debug)]
pub(super) struct Radio {
    samples: VecDeque<RawImu>,
    /// Packets on their way to a slot: time (bits 31 to 16) and payload.
    sending: VecDeque<(u16, Vec<u8>)>,
    /// What the dongle's buffers hold: the end of longer packets stays.
    slots: [[u8; Self::PACKET]; 2],
    /// Speaks version 1 of the protocol.
    old: bool,
    loss: f64,
    random: Random,
}

impl Radio {
    /// Bytes of a packet in the dongle's reports.
    const PACKET: usize = 29;
    /// Flags, samples and light of one packet.
    const PAYLOAD_MAX: usize = 26;
    /// Packets that are made before their slot comes. It makes a sample's delay what captures
    /// show: up to three slots.
    const AHEAD: usize = 2;
    /// Share of slots that carry two packets.
    const DOUBLE: f64 = 0.06;
    const FLAG_IMU: u8 = 0x80;
    const FLAG_LIGHT: u8 = 0x10;
    /// Bytes of a sample with its flags.
    const SAMPLE: usize = 14;
    /// An event of version 1 that is a sample.
    const EVENT_IMU: u8 = 0xe8;

    pub(super) fn new(old: bool, loss: f64, random: Random) -> Self {
        Self {
            samples: VecDeque::new(),
            sending: VecDeque::new(),
            slots: [[0; Self::PACKET]; 2],
            old,
            loss,
            random,
        }
    }

    pub(super) fn measured(&mut self, sample: RawImu) {
        self.samples.push_back(sample);
    }

    /// Makes packets of what waits at `ticks`: samples first, light behind them or by itself.
    fn prepare(&mut self, ticks: u32, light: &mut LightQueue, pulses: &mut PulseQueue) {
        while self.sending.len() < Self::AHEAD {
            let (time, mut payload) = match self.samples.pop_front() {
                Some(sample) => {
                    let flags = if self.old {
                        Self::EVENT_IMU
                    } else {
                        Self::FLAG_IMU
                    };
                    let mut payload = vec![flags, (sample.ticks >> 8) as u8];
                    payload.extend(imu_values(&sample));
                    (sample.ticks, payload)
                }
                None if !pulses.is_empty() => (ticks, pulses.pack(Self::PAYLOAD_MAX)),
                None if light.ready() > 0 => (ticks, vec![0]),
                None => return,
            };
            if self.old {
                // Light follows a sample where there is room for it.
                if payload.len() == Self::SAMPLE && !pulses.is_empty() {
                    payload.extend(pulses.pack(Self::PAYLOAD_MAX - payload.len()));
                }
                self.sending.push_back(((time >> 16) as u16, payload));
                continue;
            }
            let words = if payload.len() > 1 { 2 } else { 6 };
            let stream = light.pack(words, Self::PAYLOAD_MAX - payload.len());
            if !stream.is_empty() {
                payload[0] |= Self::FLAG_LIGHT;
                payload.extend(stream);
            }
            self.sending.push_back(((time >> 16) as u16, payload));
        }
    }

    /// What the host gets from the dongle after one radio slot at `ticks`.
    pub(super) fn poll(
        &mut self,
        ticks: u32,
        light: &mut LightQueue,
        pulses: &mut PulseQueue,
        reports: &mut Vec<Report>,
    ) {
        self.prepare(ticks, light, pulses);
        let count = if self.random.chance(Self::DOUBLE) {
            2
        } else {
            1
        };
        let mut received = 0;
        for _ in 0..count {
            let Some((time, payload)) = self.sending.pop_front() else {
                break;
            };
            if self.random.chance(self.loss) {
                continue;
            }
            let [middle, high] = time.to_le_bytes();
            let slot = &mut self.slots[received];
            slot[..3].copy_from_slice(&[high, payload.len() as u8 + 1, middle]);
            slot[3..3 + payload.len()].copy_from_slice(&payload);
            received += 1;
        }
        self.prepare(ticks, light, pulses);
        let report = match received {
            0 => return,
            1 => [&[0x23], &self.slots[0][..]].concat(),
            _ => [&[0x24], &self.slots[0][..], &self.slots[1][..]].concat(),
        };
        reports.push((IMU_ENDPOINT, report));
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    fn sample(sequence: u8) -> RawImu {
        RawImu {
            accel: [1, -2, 3],
            gyro: [4, 5, -6],
            ticks: 0x1234_5678,
            sequence,
        }
    }

    #[test]
    fn a_cable_repeats_the_last_three_samples() {
        let mut cable = Cable::new();
        let (mut light, mut reports) = (LightQueue::new(3e-3, 256), Vec::new());
        for sequence in 0..5 {
            cable.measured(sample(sequence));
            cable.poll(&mut light, &mut PulseQueue::default(), &mut reports);
        }
        cable.poll(&mut light, &mut PulseQueue::default(), &mut reports);
        assert_eq!(reports.len(), 5, "nothing new, no report");
        let (endpoint, last) = &reports[4];
        assert_eq!((*endpoint, last.len(), last[0]), (0x81, 52, 0x20));
        let mut sequences = [last[17], last[34], last[51]];
        sequences.sort_unstable();
        assert_eq!(sequences, [2, 3, 4]);
        assert_eq!(last[1..7], [1, 0, 0xfe, 0xff, 3, 0]);
        assert_eq!(last[13..17], [0x78, 0x56, 0x34, 0x12]);
    }

    #[test]
    fn a_radio_packet_is_laid_out_as_the_real_one() {
        let mut radio = Radio::new(false, 0.0, Random::new(1, Purpose::Radio, 0));
        let (mut light, mut reports) = (LightQueue::new(3e-3, 256), Vec::new());
        radio.measured(sample(0));
        radio.poll(0, &mut light, &mut PulseQueue::default(), &mut reports);
        let (endpoint, report) = &reports[0];
        assert_eq!((*endpoint, report.len()), (0x81, 30));
        // Time bits 31-24, size from byte 2 on, bits 23-16, flags, bits 15-8.
        assert_eq!(report[..6], [0x23, 0x12, 15, 0x34, 0x80, 0x56]);
    }
}
