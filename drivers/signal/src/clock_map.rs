//! Device ticks to host time.
//!
//! A report reaches the host some time after it was measured, never before, and the delay varies.
//! The map therefore follows the *smallest* difference between host and device time (Fober et al.
//! 2005, "Real time clock skew estimation over network delays"): minima over short buckets give
//! the drift of the two clocks, and the lowest of them, carried on by that drift, the offset.

use crate::time::{HostTime, MILLISECOND_NS, SECOND_NS};

/// One bucket's length in device time.
const BUCKET_NS: u64 = SECOND_NS / 4;
/// Buckets remembered: 8 s.
const BUCKETS: usize = 32;
/// Slopes are taken between buckets this far apart: 4 s.
const SLOPE_BUCKETS: usize = 16;
/// Quartz oscillators of consumer devices stay within this; a larger slope is noise.
const DRIFT_MAX: f64 = 500e-6;
/// A report that seems to have come this long before it was measured, or reports that stay this
/// late for [`HOLD_OFF_NS`], mean that one of the clocks jumped.
const JUMP_NS: i64 = 100 * MILLISECOND_NS as i64;
/// How long lateness is put down to a stalled host.
const HOLD_OFF_NS: u64 = SECOND_NS / 2;

/// Extends a 32-bit tick counter that wraps.
#[derive(Debug, Clone, Default)]
pub struct TickUnwrap {
    last: Option<u64>,
}

impl TickUnwrap {
    /// The counter's value since it was first seen, plus 2^32 so that earlier values fit below.
    /// A value less than half the range behind the last one counts as older, not as a wrap.
    pub fn extend(&mut self, ticks: u32) -> u64 {
        let extended = match self.last {
            None => (1 << 32) | u64::from(ticks),
            Some(last) => {
                let step = ticks.wrapping_sub(last as u32).cast_signed();
                last.saturating_add_signed(i64::from(step))
            }
        };
        self.last = Some(self.last.map_or(extended, |last| last.max(extended)));
        extended
    }

    /// Forgets the counter, as after a device's reset.
    pub fn reset(&mut self) {
        self.last = None;
    }
}

#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// Device time of the minimum, ns.
    device_ns: u64,
    /// Smallest host minus device time seen in the bucket, ns.
    offset_ns: i64,
}

/// Maps one device's ticks to host time. Everything is integer or deterministic f64 arithmetic:
/// the same reports give the same times.
#[derive(Debug, Clone)]
pub struct ClockMap {
    ticks_per_second: f64,
    buckets: [Option<Bucket>; BUCKETS],
    /// Number of the newest bucket: device time divided by [`BUCKET_NS`].
    newest: u64,
    drift: f64,
    offset: Option<Bucket>,
    late_since_ns: Option<u64>,
    last: Option<(u64, HostTime)>,
    jumps: u64,
}

impl ClockMap {
    /// A map for a counter of `ticks_per_second` (48 MHz for Lighthouse devices).
    #[must_use]
    pub fn new(ticks_per_second: f64) -> Self {
        assert!(
            ticks_per_second > 0.0,
            "a clock that stands still cannot be mapped"
        );
        Self {
            ticks_per_second,
            buckets: [None; BUCKETS],
            newest: 0,
            drift: 0.0,
            offset: None,
            late_since_ns: None,
            last: None,
            jumps: 0,
        }
    }

    /// Takes note that a report holding device time `ticks` arrived at `host`.
    /// Returns `true` when this shows that a clock jumped and the map started anew.
    pub fn observe(&mut self, ticks: u64, host: HostTime) -> bool {
        let device_ns = self.device_ns(ticks);
        let offset_ns = host.since_ns(HostTime(device_ns));
        let jumped = self.is_jump(device_ns, offset_ns);
        if jumped {
            let jumps = self.jumps + 1;
            *self = Self {
                jumps,
                ..Self::new(self.ticks_per_second)
            };
        }
        self.insert(Bucket {
            device_ns,
            offset_ns,
        });
        jumped
    }

    /// Host time at which the device's counter stood at `ticks`; `None` before the first report.
    #[must_use]
    pub fn host_time(&self, ticks: u64) -> Option<HostTime> {
        let device_ns = self.device_ns(ticks);
        let offset = self.offset_at(device_ns)?;
        Some(HostTime(device_ns).plus_ns(offset))
    }

    /// As [`ClockMap::host_time`], but never out of order: later ticks than any before get a later
    /// time, though an earlier minimum may just have moved the map back.
    pub fn stamp(&mut self, ticks: u64) -> Option<HostTime> {
        let mapped = self.host_time(ticks)?;
        let Some((last_ticks, last_time)) = self.last else {
            self.last = Some((ticks, mapped));
            return Some(mapped);
        };
        if ticks < last_ticks {
            return Some(mapped.min(last_time));
        }
        let time = if ticks == last_ticks {
            last_time
        } else {
            mapped.max(last_time.plus_ns(1))
        };
        self.last = Some((ticks, time));
        Some(time)
    }

    /// Estimated drift of the host's clock against the device's nominal rate (1e-6 = 1 ppm).
    #[must_use]
    pub fn drift(&self) -> f64 {
        self.drift
    }

    /// How often a clock jumped.
    #[must_use]
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    fn device_ns(&self, ticks: u64) -> u64 {
        (ticks as f64 * (SECOND_NS as f64 / self.ticks_per_second)) as u64
    }

    fn offset_at(&self, device_ns: u64) -> Option<i64> {
        let anchor = self.offset?;
        let ahead = HostTime(device_ns).since_ns(HostTime(anchor.device_ns)) as f64;
        Some(anchor.offset_ns + (ahead * self.drift) as i64)
    }

    fn is_jump(&mut self, device_ns: u64, offset_ns: i64) -> bool {
        let Some(expected) = self.offset_at(device_ns) else {
            return false;
        };
        let late = offset_ns.saturating_sub(expected);
        if late < JUMP_NS && late > -JUMP_NS {
            self.late_since_ns = None;
            return false;
        }
        if late < 0 {
            return true;
        }
        let since = *self.late_since_ns.get_or_insert(device_ns);
        // A device that restarted counts from zero: its time lies before the first late report.
        device_ns < since || device_ns - since > HOLD_OFF_NS
    }

    fn insert(&mut self, seen: Bucket) {
        let number = seen.device_ns / BUCKET_NS;
        if number + BUCKETS as u64 <= self.newest {
            return;
        }
        let fresh = number > self.newest || self.offset.is_none();
        if fresh {
            let skipped = (number - self.newest.min(number)).min(BUCKETS as u64);
            for gone in 0..skipped {
                self.buckets[((number - gone) % BUCKETS as u64) as usize] = None;
            }
            self.newest = number;
        }
        let slot = &mut self.buckets[(number % BUCKETS as u64) as usize];
        let lower = slot.is_none_or(|bucket| seen.offset_ns < bucket.offset_ns);
        if lower {
            *slot = Some(seen);
        }
        if fresh {
            self.drift = self.estimate_drift();
            self.offset = self.lowest();
        } else if self
            .offset_at(seen.device_ns)
            .is_none_or(|offset| seen.offset_ns < offset)
        {
            self.offset = Some(seen);
        }
    }

    /// Median of the slopes between minima 4 s apart: single late buckets do not move it.
    fn estimate_drift(&self) -> f64 {
        let mut slopes = [0.0; BUCKETS];
        let mut count = 0;
        // The newest bucket has only just begun: its minimum is not one yet.
        for later in (self.newest + 1).saturating_sub(BUCKETS as u64)..self.newest {
            let earlier = later.wrapping_sub(SLOPE_BUCKETS as u64);
            if let (Some(a), Some(b)) = (self.bucket(earlier), self.bucket(later)) {
                let span = b.device_ns.saturating_sub(a.device_ns) as f64;
                slopes[count] = (b.offset_ns - a.offset_ns) as f64 / span.max(1.0);
                count += 1;
            }
        }
        if count < 4 {
            return self.drift;
        }
        let slopes = &mut slopes[..count];
        slopes.sort_unstable_by(f64::total_cmp);
        slopes[count / 2].clamp(-DRIFT_MAX, DRIFT_MAX)
    }

    fn bucket(&self, number: u64) -> Option<Bucket> {
        let bucket = self.buckets[(number % BUCKETS as u64) as usize]?;
        (bucket.device_ns / BUCKET_NS == number).then_some(bucket)
    }

    /// The minimum that lies lowest once the drift is taken out.
    fn lowest(&self) -> Option<Bucket> {
        let level = |bucket: &Bucket| {
            let ahead = self.newest as f64 * BUCKET_NS as f64 - bucket.device_ns as f64;
            bucket.offset_ns as f64 + ahead * self.drift
        };
        let by_level = |a: &Bucket, b: &Bucket| level(a).total_cmp(&level(b));
        self.buckets.iter().flatten().copied().min_by(by_level)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HZ: f64 = 48e6;

    #[test]
    fn a_counter_that_wraps_goes_on() {
        let mut unwrap = TickUnwrap::default();
        let first = unwrap.extend(0xffff_fff0);
        assert_eq!(unwrap.extend(0x10) - first, 0x20);
        assert_eq!(
            first + 0x18,
            unwrap.extend(0x8),
            "an older value is older, not a wrap"
        );
        assert_eq!(unwrap.extend(0x20) - first, 0x30);
    }

    #[test]
    fn a_jump_starts_the_map_anew() {
        let mut map = ClockMap::new(HZ);
        let mut ticks = 1 << 32;
        let mut host = HostTime(10 * SECOND_NS);
        for _ in 0..1_000 {
            ticks += 48_000;
            host = host.plus_ns(MILLISECOND_NS as i64);
            assert!(!map.observe(ticks, host));
        }
        // The device restarts: its counter falls back, which makes every report far too late.
        ticks = 1 << 32;
        let mut jumped = 0;
        for _ in 0..1_000 {
            ticks += 48_000;
            host = host.plus_ns(MILLISECOND_NS as i64);
            jumped += u32::from(map.observe(ticks, host));
        }
        assert_eq!((jumped, map.jumps()), (1, 1));
        assert!(host.since_ns(map.host_time(ticks).unwrap()).abs() < 1_000_000);
    }

    #[test]
    fn a_stalled_host_is_not_a_jump() {
        let mut map = ClockMap::new(HZ);
        for n in 0..2_000u64 {
            let true_ns = n * MILLISECOND_NS;
            // 300 ms of reports arrive in one burst.
            let arrival = if (1_000..1_300).contains(&n) {
                1_300 * MILLISECOND_NS
            } else {
                true_ns
            };
            assert!(!map.observe((1 << 32) + n * 48_000, HostTime(arrival)));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn stays_monotone_and_close(
            ppm in -200.0f64..200.0,
            jitter_us in 0u64..4_000,
            seed in any::<u64>(),
            start in any::<u32>(),
        ) {
            let (mut map, mut unwrap) = (ClockMap::new(HZ), TickUnwrap::default());
            let (mut state, mut last) = (seed | 1, HostTime(0));
            let delay_min_us = 300;
            for n in 0..12_000u64 {
                let true_ns = (5 * SECOND_NS) + n * 4 * MILLISECOND_NS;
                let device = f64::from(start) + true_ns as f64 * 0.048 * (1.0 + ppm * 1e-6);
                let ticks = unwrap.extend((device as u64 & 0xffff_ffff) as u32);
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695);
                let jitter = if jitter_us == 0 { 0 } else { (state >> 33) % jitter_us };
                let arrival = HostTime(true_ns + (delay_min_us + jitter) * 1_000);
                prop_assert!(!map.observe(ticks, arrival));
                let time = map.stamp(ticks).unwrap();
                prop_assert!(time > last);
                last = time;
                if n > 2_000 {
                    let error_us = time.since_ns(HostTime(true_ns + delay_min_us * 1_000)) / 1_000;
                    let bound = 100 + jitter_us as i64 / 4;
                    prop_assert!(error_us.abs() < bound, "error {error_us} us, bound {bound}");
                }
            }
        }
    }
}
