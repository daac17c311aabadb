//! Time as a value. Only the daemon asks the operating system what time it is; everybody else is
//! given a [`HostTime`].

use std::cell::Cell;

/// Nanoseconds in a second.
pub const SECOND_NS: u64 = 1_000_000_000;
/// Nanoseconds in a millisecond.
pub const MILLISECOND_NS: u64 = 1_000_000;

/// A point in host time: nanoseconds of `CLOCK_MONOTONIC` (in replay: of the capture's clock).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct HostTime(pub u64);

impl HostTime {
    /// From seconds; negative and non-finite inputs give zero.
    #[must_use]
    pub fn from_secs_f64(seconds: f64) -> Self {
        // A cast from f64 saturates, and takes NaN to zero.
        Self((seconds * SECOND_NS as f64) as u64)
    }

    /// Seconds since the clock's origin.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / SECOND_NS as f64
    }

    /// Signed nanoseconds from `earlier` to `self`, saturating at the range of `i64`.
    #[must_use]
    pub fn since_ns(self, earlier: Self) -> i64 {
        let wide = i128::from(self.0) - i128::from(earlier.0);
        wide.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
    }

    /// Signed seconds from `earlier` to `self`.
    #[must_use]
    pub fn since_secs(self, earlier: Self) -> f64 {
        self.since_ns(earlier) as f64 / SECOND_NS as f64
    }

    /// `self` moved by signed nanoseconds, saturating at both ends.
    #[must_use]
    pub fn plus_ns(self, ns: i64) -> Self {
        Self(self.0.saturating_add_signed(ns))
    }

    /// `self` moved by signed seconds, saturating at both ends.
    #[must_use]
    pub fn plus_secs(self, seconds: f64) -> Self {
        self.plus_ns((seconds * SECOND_NS as f64) as i64)
    }
}

/// Something that knows what time it is. A fixed time is a clock too.
pub trait Clock {
    /// The present time.
    fn now(&self) -> HostTime;
}

impl Clock for HostTime {
    fn now(&self) -> HostTime {
        *self
    }
}

/// A clock that moves only when it is told to: that of replays and tests.
#[derive(Debug, Default)]
pub struct VirtualClock(Cell<HostTime>);

impl VirtualClock {
    /// A clock that stands at `start`.
    #[must_use]
    pub fn new(start: HostTime) -> Self {
        Self(Cell::new(start))
    }

    /// Moves on to `time`; a time in the past leaves the clock where it is.
    pub fn advance_to(&self, time: HostTime) {
        self.0.set(self.0.get().max(time));
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> HostTime {
        self.0.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_signed_and_saturate() {
        assert_eq!(HostTime(5).since_ns(HostTime(8)), -3);
        assert_eq!(HostTime(u64::MAX).since_ns(HostTime(0)), i64::MAX);
        assert_eq!(HostTime(3).plus_ns(-5), HostTime(0));
        assert_eq!(HostTime::from_secs_f64(f64::NAN), HostTime(0));
        assert_eq!(HostTime::from_secs_f64(1.5), HostTime(1_500_000_000));
    }

    #[test]
    fn a_virtual_clock_never_runs_backwards() {
        let clock = VirtualClock::new(HostTime(10));
        clock.advance_to(HostTime(7));
        assert_eq!(clock.now(), HostTime(10));
        clock.advance_to(HostTime(12));
        assert_eq!(clock.now(), HostTime(12));
    }
}
