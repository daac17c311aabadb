//! Which time a pose is made for, and how old its inputs were.
//!
//! A game draws a pose some time after it was made; posed carries the inputs on to that time. The
//! further it reaches, the more it guesses: 20-30 ms help, 60 ms look worse than none, so the
//! reach is bounded.

use posed_signal::{HostTime, time::MILLISECOND_NS};

/// The furthest that a pose may reach beyond the present.
pub const HORIZON_NS_MAX: i64 = 60 * MILLISECOND_NS as i64;
/// The furthest that it may lie behind: the six policy steps that QuestSim sees of the future.
pub const HORIZON_NS_MIN: i64 = -170 * MILLISECOND_NS as i64;
/// Weight of one tick in the running mean of the inputs' age: about one second at 90 Hz.
const AGE_WEIGHT: f64 = 1.0 / 90.0;

/// Chooses target times.
#[derive(Debug, Clone, Copy)]
pub struct LatencyModel {
    horizon_ns: i64,
    age_ns: f64,
    last_target: HostTime,
}

impl LatencyModel {
    /// Poses are made for `horizon_ns` after the tick, [`HORIZON_NS_MIN`] to [`HORIZON_NS_MAX`];
    /// with a negative number for the past.
    #[must_use]
    pub fn new(horizon_ns: i64) -> Self {
        Self {
            horizon_ns: horizon_ns.clamp(HORIZON_NS_MIN, HORIZON_NS_MAX),
            age_ns: 0.0,
            last_target: HostTime(0),
        }
    }

    /// How far beyond the tick poses are made for, ns.
    #[must_use]
    pub fn horizon_ns(&self) -> i64 {
        self.horizon_ns
    }

    /// The target time of a tick at `now`; never before that of an earlier tick.
    pub fn target(&mut self, now: HostTime) -> HostTime {
        self.last_target = self.last_target.max(now.plus_ns(self.horizon_ns));
        self.last_target
    }

    /// Takes note of the newest headset sample at a tick.
    pub fn observe(&mut self, now: HostTime, sample: HostTime) {
        let age = now.since_ns(sample) as f64;
        self.age_ns += (age - self.age_ns) * AGE_WEIGHT;
    }

    /// Mean age of the newest headset sample at a tick, ns.
    #[must_use]
    pub fn age_ns(&self) -> i64 {
        self.age_ns as i64
    }

    /// Starts anew, as when time starts anew.
    pub fn reset(&mut self) {
        *self = Self::new(self.horizon_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_never_go_back_and_reach_only_so_far() {
        let mut model = LatencyModel::new(i64::MAX);
        let first = model.target(HostTime(1_000_000_000));
        assert_eq!(first.since_ns(HostTime(1_000_000_000)), HORIZON_NS_MAX);
        assert_eq!(model.target(HostTime(900_000_000)), first);
    }

    #[test]
    fn the_mean_age_settles_on_the_age() {
        let mut model = LatencyModel::new(0);
        for tick in 0..1_000u64 {
            let now = HostTime(1_000_000_000 + tick * 11_000_000);
            model.observe(now, now.plus_ns(-3_000_000));
        }
        assert!((model.age_ns() - 3_000_000).abs() < 1_000);
    }
}
