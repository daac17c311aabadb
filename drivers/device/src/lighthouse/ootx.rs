//! What a base station says about itself ("OOTX"): its serial number, the shape of its light planes
//! and which way is up, sent bit by bit with its sync pulses, over and over. Layouts are
//! libsurvive's (MIT), checked against captures.
//!
//! A frame is 17 zeros and a one, then words of 16 bits with a one behind each: the payload's
//! length (little-endian), the payload, filled up to a word, and its CRC-32.

use glam::DVec3;
use half::f16;

use super::{base_station::Generation, reproject::PlaneCalibration};

/// Zeros before a frame; nothing else in it has so many.
const PREAMBLE_ZEROS: u64 = 17;
/// Longest payload that is read; the longest known has 43 bytes.
const PAYLOAD_MAX: usize = 64;
/// Bits of a frame that carries so many bytes.
const fn frame_bits(payload: usize) -> usize {
    let words = 1 + payload.div_ceil(2) + 2;
    PREAMBLE_ZEROS as usize + 1 + 17 * words
}
/// Payloads of generation 2 and of generation 1, bytes. The first entry stands for any other length:
/// with those, no bit before the length may be missing.
const LENGTHS: [Option<usize>; 3] = [None, Some(43), Some(33)];
/// The first frame of a station is read while so many of its bits were never seen: the check sum
/// tells them, and 24 of its bits are left to tell that the others are right.
const UNSEEN_MAX: usize = 8;
/// Bits kept: six of the longest frames.
const WINDOW: usize = 6 * frame_bits(PAYLOAD_MAX);

/// What a base station says about itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Broadcast {
    /// Its serial number.
    pub id: u32,
    /// Version of its firmware (bits 15 to 6) and of this protocol (the others).
    pub firmware: u16,
    /// Version of its hardware.
    pub hardware: u8,
    /// What it is set to: 0, 1 and 2 are a generation-1 station's A, b and c; the low seven bits of
    /// a generation-2 station's are its channel.
    pub mode: u8,
    /// Faults that it has found with itself; 0 where there are none.
    pub faults: u8,
    /// How often its rotors have lost their lock, modulo 256.
    pub unlocks: u8,
    /// Up, by its own accelerometer, in its own frame; unit, to half a degree.
    pub up: DVec3,
    /// Shape of its two light planes.
    pub calibration: [PlaneCalibration; 2],
}

impl Broadcast {
    /// Reads a payload; `None` where it is too short or a number is not finite.
    #[must_use]
    pub fn parse(generation: Generation, payload: &[u8]) -> Option<Self> {
        let byte = |at: usize| payload.get(at).copied();
        let mut calibration = [PlaneCalibration::default(); 2];
        let mut fill = |at: usize, slot: fn(&mut PlaneCalibration) -> &mut f64| {
            for (index, plane) in calibration.iter_mut().enumerate() {
                let half = [byte(at + 2 * index)?, byte(at + 2 * index + 1)?];
                let value = f16::from_le_bytes(half).to_f64();
                *slot(plane) = Some(value).filter(|value| value.is_finite())?;
            }
            Some(())
        };
        fill(6, |plane| &mut plane.phase)?;
        fill(10, |plane| &mut plane.tilt)?;
        fill(16, |plane| &mut plane.curve)?;
        fill(23, |plane| &mut plane.gibphase)?;
        fill(27, |plane| &mut plane.gibmag)?;
        match generation {
            // The model wants the tangent of what is sent, as libsurvive found.
            Generation::One => {
                for plane in &mut calibration {
                    plane.tilt = plane.tilt.tan();
                }
            }
            Generation::Two => {
                fill(33, |plane| &mut plane.ogeephase)?;
                fill(37, |plane| &mut plane.ogeemag)?;
            }
        }
        let axis = |at| byte(at).map(|byte| f64::from(byte.cast_signed()));
        Some(Self {
            id: u32::from_le_bytes([byte(2)?, byte(3)?, byte(4)?, byte(5)?]),
            firmware: u16::from_le_bytes([byte(0)?, byte(1)?]),
            hardware: byte(15)?,
            mode: byte(31)?,
            faults: byte(32)?,
            unlocks: byte(14)?,
            up: DVec3::new(axis(20)?, axis(21)?, axis(22)?).normalize_or(DVec3::Y),
            calibration,
        })
    }
}

/// Joins one base station's bits to payloads. Bits may be missing: the same bit comes again with
/// every frame, and a frame is read as soon as each of its bits has been seen once.
#[derive(Debug, Clone)]
pub struct BitStream {
    /// The newest [`WINDOW`] bits, by position modulo the window.
    bits: Vec<Option<bool>>,
    /// Position of the next bit.
    next: u64,
    /// Position of the newest preamble whose frame has not been read yet.
    preamble: Option<u64>,
    /// Bits of a frame that need not have been seen.
    unseen_max: usize,
}

impl Default for BitStream {
    fn default() -> Self {
        Self {
            bits: vec![None; WINDOW],
            next: 0,
            preamble: None,
            unseen_max: UNSEEN_MAX,
        }
    }
}

impl BitStream {
    /// Takes the bit that comes `missed` bits after the last one taken. Returns a payload whose
    /// check sum is right, once a frame.
    pub fn push(&mut self, missed: u64, bit: bool) -> Option<Vec<u8>> {
        if missed > WINDOW as u64 {
            *self = Self::default();
        }
        for _ in 0..missed {
            self.put(None);
        }
        self.put(Some(bit));
        let start = (self.next - 1).checked_sub(PREAMBLE_ZEROS);
        let begins = |start: &u64| LENGTHS.into_iter().any(|length| self.zeros(*start, length));
        self.preamble = start.filter(|start| bit && begins(start)).or(self.preamble);
        // Zeros that were filled in by a wrong period are as good as others: all are tried.
        let start = self.preamble?;
        let payload = LENGTHS
            .into_iter()
            .filter(|length| self.zeros(start, *length))
            .find_map(|length| self.frame(start, length))?;
        self.preamble = None;
        self.unseen_max = 0;
        Some(payload)
    }

    fn zeros(&self, start: u64, length: Option<usize>) -> bool {
        let period = length.map_or(0, frame_bits) as u64;
        (start..start + PREAMBLE_ZEROS).all(|at| self.bit(at, period) == Some(false))
    }

    fn put(&mut self, bit: Option<bool>) {
        self.bits[(self.next % WINDOW as u64) as usize] = bit;
        self.next += 1;
    }

    fn at(&self, position: u64) -> Option<bool> {
        let kept = position < self.next && position + WINDOW as u64 >= self.next;
        kept.then(|| self.bits[(position % WINDOW as u64) as usize])
            .flatten()
    }

    /// The payload of the frame that begins at `start`, of a known length or of what it says; bits
    /// that are not there are taken from the frames before.
    fn frame(&self, start: u64, known: Option<usize>) -> Option<Vec<u8>> {
        let body = start + PREAMBLE_ZEROS + 1;
        let length = match known {
            Some(length) => length,
            None => usize::from(u16::from_le_bytes([
                self.byte(body, 0)?,
                self.byte(body + 8, 0)?,
            ])),
        };
        if length > PAYLOAD_MAX {
            return None;
        }
        let period = frame_bits(length) as u64;
        let filled = length.next_multiple_of(2);
        // Length, payload, filling, check sum: what has to be there, whatever the payload.
        let mut bytes = vec![0u8; 2 + filled + 4];
        let mut unseen = Vec::new();
        // The last bits come last: without them there is no need to look at the others.
        for (index, byte) in bytes.iter_mut().enumerate().rev() {
            let at = body + 17 * (index as u64 / 2) + 8 * (index as u64 % 2);
            let is_told = index < 2 || (2 + length..2 + filled).contains(&index);
            let told = match index {
                0 | 1 => (length as u16).to_le_bytes()[index],
                _ => 0,
            };
            for bit in 0..8 {
                let mask = 0x80 >> bit;
                match (self.bit(at + bit, period), is_told) {
                    (Some(seen), true) if seen != (told & mask != 0) => return None,
                    (_, true) => *byte = told,
                    (Some(true), false) => *byte |= mask,
                    (Some(false), false) => {}
                    (None, false) if unseen.len() < self.unseen_max => unseen.push((index, mask)),
                    (None, false) => return None,
                }
            }
            // A one stands behind every word.
            if index % 2 == 1 && self.bit(at + 8, period) == Some(false) {
                return None;
            }
        }
        fill(&mut bytes, length, &unseen)?;
        Some(bytes[2..2 + length].to_vec())
    }

    /// A bit, or the same bit of an earlier frame, the newest that was seen.
    fn bit(&self, position: u64, period: u64) -> Option<bool> {
        let frames = (WINDOW as u64).checked_div(period).unwrap_or(1);
        (0..frames).find_map(|back| self.at(position.checked_sub(back * period)?))
    }

    fn byte(&self, position: u64, period: u64) -> Option<u8> {
        (0..8).try_fold(0, |byte, n| {
            Some(byte << 1 | u8::from(self.bit(position + n, period)?))
        })
    }
}

/// What the check sum of a frame is off.
fn off(bytes: &[u8], length: usize) -> Option<u32> {
    let (rest, sum) = bytes.split_last_chunk::<4>()?;
    let mut crc = flate2::Crc::new();
    crc.update(rest.get(2..2 + length)?);
    Some(crc.sum() ^ u32::from_le_bytes(*sum))
}

/// Sets the bits of a frame that were not seen (byte and mask) so that its check sum is right, if
/// there is one way to do so and no other.
fn fill(bytes: &mut [u8], length: usize, unseen: &[(usize, u8)]) -> Option<()> {
    let wrong = off(bytes, length)?;
    // What each of them changes does not depend on the others.
    let mut changes = Vec::with_capacity(unseen.len());
    for &(index, mask) in unseen {
        bytes[index] ^= mask;
        changes.push(off(bytes, length)? ^ wrong);
        bytes[index] ^= mask;
    }
    let chosen = |set: u32, n: usize| set >> n & 1 == 1;
    let mut sets = (0..1u32 << unseen.len()).filter(|set| {
        let each = changes.iter().enumerate();
        let change = each.filter(|(n, _)| chosen(*set, *n));
        change.fold(wrong, |wrong, (_, change)| wrong ^ change) == 0
    });
    let set = sets.next()?;
    if sets.next().is_some() {
        return None;
    }
    for (n, &(index, mask)) in unseen.iter().enumerate() {
        if chosen(set, n) {
            bytes[index] |= mask;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The bits of a frame.
    fn bits(payload: &[u8]) -> Vec<bool> {
        let mut crc = flate2::Crc::new();
        crc.update(payload);
        let mut bytes = (payload.len() as u16).to_le_bytes().to_vec();
        bytes.extend(payload);
        bytes.resize(bytes.len().next_multiple_of(2), 0);
        bytes.extend(crc.sum().to_le_bytes());
        let mut bits = vec![false; 17];
        bits.push(true);
        for pair in bytes.chunks(2) {
            let byte = |byte: u8| (0..8).rev().map(move |bit| byte >> bit & 1 == 1);
            bits.extend(pair.iter().copied().flat_map(byte));
            bits.push(true);
        }
        bits
    }

    /// Position after which the payload came.
    fn read_at(stream: impl Iterator<Item = Option<bool>>, payload: &[u8]) -> Option<usize> {
        let (mut reader, mut missed) = (BitStream::default(), 0);
        for (index, bit) in stream.enumerate() {
            let Some(bit) = bit else {
                missed += 1;
                continue;
            };
            if let Some(found) = reader.push(std::mem::take(&mut missed), bit) {
                assert_eq!(found, payload);
                return Some(index);
            }
        }
        None
    }

    #[test]
    fn a_frame_is_read_as_soon_as_all_of_it_was_there() {
        let payload: Vec<u8> = (0..43u8).map(|n| n.wrapping_mul(37)).collect();
        let frame = bits(&payload);
        assert_eq!(frame.len(), 443);
        for start in [0, 1, 100, 200, 420, 442] {
            let stream = frame.iter().cycle().skip(start).copied().map(Some);
            let at = read_at(stream.take(1_000), &payload).unwrap();
            // The preamble has to come in one piece; the last bits follow from the check sum.
            assert!((420..442 + 34).contains(&at), "{start}: {at}");
        }
    }

    #[test]
    fn a_wrong_bit_is_no_payload() {
        let payload = [7; 33];
        let mut frame = bits(&payload);
        frame[100] = !frame[100];
        let stream = frame.iter().cycle().copied().map(Some);
        assert_eq!(read_at(stream.take(2_000), &payload), None);
    }

    #[test]
    fn some_bits_that_are_never_seen_follow_from_the_others() {
        let payload: Vec<u8> = (0..43u8).map(|n| n.wrapping_mul(91)).collect();
        let frame = bits(&payload);
        let read = |unseen: &[usize]| {
            let stream = (0..1_500).map(|n| (!unseen.contains(&(n % 443))).then(|| frame[n % 443]));
            read_at(stream, &payload)
        };
        // Length, stuffing and filling need not be seen, and eight others, also of the check sum.
        assert!(read(&[20, 34, 51, 410, 50, 100, 101, 102, 103, 200, 300, 430]).is_some());
        assert!(read(&[50, 100, 101, 103, 104, 200, 300, 430, 341, 351]).is_none());
    }

    #[test]
    fn payloads_say_what_they_say() {
        let mut payload = [0u8; 43];
        payload[2..6].copy_from_slice(&0xdead_beefu32.to_le_bytes());
        payload[10..12].copy_from_slice(&f16::from_f64(0.05).to_le_bytes());
        payload[21] = 127;
        payload[39..41].copy_from_slice(&f16::from_f64(-0.25).to_le_bytes());
        let read = Broadcast::parse(Generation::Two, &payload).unwrap();
        assert_eq!((read.id, read.up), (0xdead_beef, DVec3::Y));
        assert_eq!(read.calibration[0].tilt, f16::from_f64(0.05).to_f64());
        assert_eq!(read.calibration[1].ogeemag, -0.25);
        let old = Broadcast::parse(Generation::One, &payload[..33]).unwrap();
        assert_eq!(old.calibration[0].tilt, read.calibration[0].tilt.tan());
        assert_eq!(Broadcast::parse(Generation::Two, &payload[..33]), None);
        payload[7] = 0x7e;
        assert_eq!(
            Broadcast::parse(Generation::Two, &payload),
            None,
            "no number"
        );
    }

    proptest! {
        #[test]
        fn missing_bits_are_taken_from_other_frames(
            seed in prop::collection::vec(any::<u8>(), 43), old in any::<bool>(),
            lost in prop::collection::vec(0.0f64..1.0, 3_540), share in 0.0f64..0.15,
        ) {
            let seed = if old { &seed[..33] } else { &seed[..] };
            let frame = bits(seed);
            let stream = frame.iter().cycle().zip(&lost)
                .map(|(bit, lost)| (*lost >= share).then_some(*bit));
            prop_assert!(read_at(stream, seed).is_some());
        }

        #[test]
        fn any_bits_are_survived(bits in prop::collection::vec((0u64..3, any::<bool>()), 0..3_000)) {
            let mut reader = BitStream::default();
            for (missed, bit) in bits {
                if let Some(payload) = reader.push(missed, bit) {
                    let _ = Broadcast::parse(Generation::Two, &payload);
                }
            }
        }
    }
}
