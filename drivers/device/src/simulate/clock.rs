//! A device's tick counter.

use super::random::Random;

/// Nominal ticks a second.
pub(super) const TICK_HZ: f64 = 48e6;

/// A counter of 48 MHz that drifts and starts anywhere.
#[derive(Debug, Clone, Copy)]
pub(super) struct DeviceClock {
    hz: f64,
    at_start: f64,
}

impl DeviceClock {
    pub(super) fn new(random: &mut Random, drift_ppm: f64) -> Self {
        Self {
            hz: TICK_HZ * (1.0 + random.normal(drift_ppm) * 1e-6),
            // Far enough from zero that times shortly before the start are positive.
            at_start: (1.0 + random.unit()) * f64::from(u32::MAX),
        }
    }

    /// Ticks, fractions included, at a time in seconds after the start.
    pub(super) fn ticks(&self, seconds: f64) -> f64 {
        self.at_start + self.hz * seconds
    }

    /// When the counter stands at `ticks`, seconds after the start.
    pub(super) fn seconds(&self, ticks: f64) -> f64 {
        (ticks - self.at_start) / self.hz
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    #[test]
    fn ticks_invert() {
        let mut random = Random::new(5, Purpose::Device, 0);
        let clock = DeviceClock::new(&mut random, 20.0);
        let ticks = clock.ticks(12.5);
        assert!((clock.seconds(ticks) - 12.5).abs() < 1e-9);
        let rate = clock.ticks(1.0) - clock.ticks(0.0);
        assert!((rate / TICK_HZ - 1.0).abs() < 100e-6 && rate != TICK_HZ);
    }
}
