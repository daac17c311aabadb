//! Light of generation 1 inside a radio packet of version 1.
//!
//! Begins and ends of pulses are sent as one list of times, the newest first: three bytes at the
//! packet's end, before them the steps back from each time to the next, seven bits a byte, the
//! first byte of a step furthest back and its last one marked. The packet's front holds a byte for
//! each pulse: the sensor, and how many times lie between the pulse's end and its begin. Ends are
//! dealt out in order, to times that are not a begin already.

use super::wire::{Fields, Pulse};
use crate::decode::DecodeError;

/// Times in a packet, at most: it has 26 bytes, a pulse at least three.
const TIMES_MAX: usize = 24;
/// Bytes of a step, at most.
const STEP_BYTES_MAX: u32 = 4;

/// The pulses of a packet, the earliest first; their times have 24 bits.
///
/// # Errors
/// The packet holds something else.
pub(super) fn pulses(
    id: u8,
    data: &[u8],
) -> Result<impl Iterator<Item = Pulse> + use<>, DecodeError> {
    let malformed = |what| Fields::new(id, data).malformed(what);
    let (times, sensors) =
        times(data).ok_or_else(|| malformed("its light's times do not add up"))?;
    let mut pulses = [Pulse::default(); TIMES_MAX / 2];
    let mut begins = [false; TIMES_MAX];
    let (mut next, mut count) = (0, 0);
    for &byte in sensors {
        while begins.get(next).is_some_and(|begin| *begin) {
            next += 1;
        }
        let begin = next + 1 + usize::from(byte & 7);
        let (Some(end), Some(start)) = (times.get(next), times.get(begin)) else {
            return Err(malformed("a light pulse has no begin"));
        };
        if std::mem::replace(&mut begins[begin], true) {
            return Err(malformed("two light pulses have one begin"));
        }
        let length = u16::try_from(end - start)
            .map_err(|_| malformed("a light pulse is longer than any"))?;
        pulses[count] = Pulse {
            sensor: byte >> 3,
            length,
            ticks: (*start & 0xff_ffff) as u32,
        };
        (next, count) = (next + 1, count + 1);
    }
    // Ends come in order, begins almost.
    let newest = times.first().copied().unwrap_or_default();
    let age = move |pulse: &Pulse| (newest as u32).wrapping_sub(pulse.ticks) & 0xff_ffff;
    pulses[..count].sort_by_key(|pulse| std::cmp::Reverse(age(pulse)));
    Ok(pulses.into_iter().take(count))
}

/// The list of times, newest first (of 24 bits, but never wrapping), and the bytes of the sensors.
fn times(data: &[u8]) -> Option<(Vec<i64>, &[u8])> {
    let (front, last) = data.split_last_chunk::<3>()?;
    let newest = i64::from(u32::from_le_bytes([last[0], last[1], last[2], 0]));
    let mut times = Vec::with_capacity(TIMES_MAX);
    // Room below, so that steps back do not go below zero.
    times.push(newest + (1 << 40));
    let mut rest = front;
    while rest.len() > times.len() / 2 {
        let (mut step, mut bytes) = (0i64, 0);
        loop {
            let (&byte, before) = rest.split_last()?;
            rest = before;
            step = step << 7 | i64::from(byte & 0x7f);
            bytes += 1;
            if byte & 0x80 != 0 {
                break;
            }
            if bytes == STEP_BYTES_MAX {
                return None;
            }
        }
        if times.len() == TIMES_MAX {
            return None;
        }
        times.push(times.last()? - step);
    }
    (times.len() == 2 * rest.len()).then_some((times, rest))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(hex: &str) -> Vec<(u8, u32, u16)> {
        let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
        let data: Vec<u8> = (0..hex.len()).step_by(2).map(byte).collect();
        let found = pulses(0x23, &data).unwrap();
        found
            .map(|pulse| (pulse.sensor, pulse.ticks, pulse.length))
            .collect()
    }

    /// From a capture of a Vive tracker (libsurvive-extras-data, wireless-tracker): flashes of two
    /// base stations and a plane's hits; pulses that overlap; one alone.
    #[test]
    fn packets_of_a_tracker_are_read() {
        assert_eq!(
            read("30309a08a0842cce6cd209e511ee8e2c06fc039f01de02e53dd3"),
            [
                (20, 13_715_815, 5_636),
                (19, 13_735_353, 3_621),
                (1, 13_736_587, 2_277),
                (6, 13_842_924, 508),
                (6, 13_843_591, 350),
            ]
        );
        assert_eq!(
            read("9a908aaa02e98249d3"),
            [(19, 13_846_501, 413), (18, 13_846_511, 298)]
        );
        assert_eq!(read("a08130cab0e3"), [(20, 14_915_785, 6_145)]);
    }

    #[test]
    fn torn_packets_are_errors() {
        for hex in [&[][..], &[1, 2], &[0xa0, 0x30, 0xca, 0xb0], &[0; 26]] {
            assert!(pulses(0x23, hex).is_err(), "{hex:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_give_an_answer(data in prop::collection::vec(any::<u8>(), 0..27)) {
            if let Ok(found) = pulses(0x23, &data) {
                for pulse in found {
                    prop_assert!(pulse.sensor < 32 && pulse.ticks < 1 << 24);
                }
            }
        }
    }
}
