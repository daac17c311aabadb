//! From syncs and sweep times to rotor angles, one rotor a base station.

use super::{
    reproject::{PLANE_CENTRE, ROTOR_HZ},
    wire::TICKS_PER_SECOND,
};

/// A rotor whose speed differs by more than this from its channel's is not that rotor, Hz.
const SPEED_TOLERANCE_HZ: f64 = 1.0;
/// Syncs within this of where the last ones foretell them belong to the same rotor, ticks (4 us).
const SYNC_TOLERANCE: f64 = 200.0;
/// The same while the rotor's speed is only known by its channel, ticks a revolution.
const FIRST_TOLERANCE: f64 = 1_000.0;
/// Misplaced syncs in a row that agree with each other replace the rotor's phase.
const RELOCK_SYNCS: u8 = 2;
/// Weight of a sync in the running share of those that did not agree, and the share from which on two
/// base stations are taken to be set to the channel: with two, half of all syncs do not agree.
const RUNNING: f64 = 0.02;
const SHARED: f64 = 0.25;
/// Revolutions over which the phase is foretold without a sync: 0.6 s, as the drift of rotors in
/// captures allows for 1e-4 rad.
const COAST_REVOLUTIONS: f64 = 30.0;
/// Share of a sync's deviation that the period takes over.
const PERIOD_GAIN: f64 = 0.1;
/// Near half a revolution it cannot be told which plane passed, rad.
const PLANE_MARGIN: f64 = 0.16;

/// A light plane's angle as it passed a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Which plane, 0 or 1.
    pub plane: u8,
    /// Angle from the plane's centre, rad; comparable to [`super::reproject::reproject`].
    pub angle: f64,
}

/// The rotor of one base station, as one device sees it.
#[derive(Debug, Clone, Copy)]
pub struct Rotor {
    nominal: f64,
    /// Ticks a revolution.
    period: f64,
    /// The newest sync, ticks.
    zero: f64,
    /// Syncs that agreed, saturating.
    agreed: u8,
    /// The newest sync that did not agree, and how many of them agree with each other.
    stray: f64,
    strays: u8,
    /// Running share of syncs that did not agree.
    astray: f64,
}

impl Rotor {
    /// The rotor of a channel, 0 to 15, not seen yet.
    #[must_use]
    pub fn new(channel: u8) -> Self {
        let nominal = TICKS_PER_SECOND / ROTOR_HZ[usize::from(channel) % ROTOR_HZ.len()];
        Self {
            nominal,
            period: nominal,
            zero: 0.0,
            agreed: 0,
            stray: 0.0,
            strays: 0,
            astray: 0.0,
        }
    }

    /// Whether two base stations are set to this channel, so that nothing can be told from its light.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.astray > SHARED
    }

    /// A sync came. Returns whether it belongs to the rotor's sequence.
    pub fn sync(&mut self, ticks: f64) -> bool {
        let agreed = self.take(ticks);
        let relocked = agreed && self.agreed == 1;
        let astray = f64::from(u8::from(!agreed || relocked));
        self.astray += RUNNING * (astray - self.astray);
        agreed
    }

    fn take(&mut self, ticks: f64) -> bool {
        if self.agreed == 0 {
            self.lock(ticks);
            return true;
        }
        let revolutions = ((ticks - self.zero) / self.period).round();
        let deviation = ticks - self.zero - revolutions * self.period;
        let reach = revolutions.abs().max(1.0);
        let tolerance = if self.agreed < 3 {
            FIRST_TOLERANCE
        } else {
            SYNC_TOLERANCE
        };
        if reach <= COAST_REVOLUTIONS && deviation.abs() < tolerance {
            if revolutions > 0.0 {
                // Rotors wobble by more than syncs scatter: smoothing the phase doubles residuals.
                self.zero = ticks;
                self.follow(deviation / reach);
            }
            self.strays = 0;
            return true;
        }
        let apart = ((ticks - self.stray) / self.nominal).round();
        let off = ticks - self.stray - apart * self.nominal;
        let alike = apart.abs() >= 1.0 && apart.abs() <= COAST_REVOLUTIONS;
        self.strays = if alike && off.abs() < FIRST_TOLERANCE * apart.abs() {
            self.strays + 1
        } else {
            0
        };
        self.stray = ticks;
        // A rotor that has been out of sight for long is wherever it is seen now.
        if self.strays >= RELOCK_SYNCS || reach > COAST_REVOLUTIONS {
            self.lock(ticks);
            return true;
        }
        false
    }

    fn lock(&mut self, ticks: f64) {
        let nominal = self.nominal;
        *self = Self {
            nominal,
            period: self.period,
            zero: ticks,
            agreed: 1,
            stray: ticks,
            strays: 0,
            astray: self.astray,
        };
    }

    fn follow(&mut self, deviation: f64) {
        // The first syncs set the period fast, the later ones hold it.
        let gain = (1.0 / f64::from(self.agreed)).max(PERIOD_GAIN);
        self.agreed = self.agreed.saturating_add(1);
        let (slow, fast) = self.period_limits();
        self.period = (self.period + gain * deviation).clamp(fast, slow);
    }

    fn period_limits(&self) -> (f64, f64) {
        let hz = TICKS_PER_SECOND / self.nominal;
        (
            TICKS_PER_SECOND / (hz - SPEED_TOLERANCE_HZ),
            TICKS_PER_SECOND / (hz + SPEED_TOLERANCE_HZ),
        )
    }

    /// The reading of a sweep, or `None` where the rotor is not known well enough or the angle
    /// cannot be that of a plane in the room.
    #[must_use]
    pub fn reading(&self, ticks: f64) -> Option<Reading> {
        use std::f64::consts::{PI, TAU};
        let turns = (ticks - self.zero) / self.period;
        if self.agreed < 3 || turns.abs() > COAST_REVOLUTIONS || self.is_shared() {
            return None;
        }
        let angle = (turns - turns.floor()) * TAU;
        if (angle - PI).abs() < PLANE_MARGIN {
            return None;
        }
        let plane = u8::from(angle > PI);
        Some(Reading {
            plane,
            angle: angle - PLANE_CENTRE[usize::from(plane)],
        })
    }

    /// Its speed in revolutions a second of the device's clock, once it is locked.
    #[must_use]
    pub fn speed_hz(&self) -> Option<f64> {
        (self.agreed >= 3).then(|| TICKS_PER_SECOND / self.period)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD: f64 = 940_995.0;

    fn locked(start: f64) -> Rotor {
        let mut rotor = Rotor::new(6);
        for n in 0..200 {
            assert!(rotor.sync(start + f64::from(n) * PERIOD));
        }
        rotor
    }

    #[test]
    fn readings_follow_the_phase() {
        let rotor = locked(1e9);
        let zero = 1e9 + 199.0 * PERIOD;
        for (turn, plane, angle) in [(1.0 / 3.0, 0, 0.0), (0.3, 0, -0.2094), (0.7, 1, 0.2094)] {
            for revolution in [0.0, -1.0, 5.0] {
                let reading = rotor.reading(zero + (turn + revolution) * PERIOD).unwrap();
                assert_eq!(reading.plane, plane);
                assert!((reading.angle - angle).abs() < 1e-4, "{reading:?}");
            }
        }
        assert_eq!(
            rotor.reading(zero + 0.5 * PERIOD),
            None,
            "between the planes"
        );
        assert_eq!(rotor.reading(zero + 100.3 * PERIOD), None, "too long ago");
    }

    #[test]
    fn a_stray_sync_changes_nothing_and_a_new_phase_is_taken() {
        let mut rotor = locked(0.0);
        let before = rotor.reading(200.3 * PERIOD);
        assert!(!rotor.sync(199.6 * PERIOD));
        assert_eq!(rotor.reading(200.3 * PERIOD), before);
        let taken: Vec<_> = (200..204)
            .map(|n| rotor.sync((f64::from(n) + 0.37) * PERIOD))
            .collect();
        assert_eq!(taken, [false, false, true, true]);
    }

    #[test]
    fn two_stations_on_a_channel_are_noticed() {
        let mut rotor = Rotor::new(6);
        let syncs = |rotor: &mut Rotor, from: u32, second: bool| {
            for n in from..from + 200 {
                let turn = f64::from(n);
                rotor.sync(turn * PERIOD);
                if second {
                    rotor.sync((turn + 0.4 + 1e-4 * turn) * PERIOD);
                } else if n % 20 == 0 {
                    rotor.sync((turn + 0.7) * PERIOD);
                }
            }
        };
        syncs(&mut rotor, 0, false);
        assert!(!rotor.is_shared(), "a reflection now and then");
        assert!(rotor.reading(199.3 * PERIOD).is_some());
        syncs(&mut rotor, 200, true);
        assert!(rotor.is_shared());
        assert_eq!(rotor.reading(399.3 * PERIOD), None);
        syncs(&mut rotor, 400, false);
        assert!(!rotor.is_shared(), "one of them was set to another");
    }

    proptest! {
        #[test]
        fn the_speed_is_found_through_jitter(
            ppm in -300.0f64..300.0, seed in any::<u64>(), lost in 0u64..5,
        ) {
            let period = TICKS_PER_SECOND / ROTOR_HZ[9] * (1.0 + ppm * 1e-6);
            let (mut rotor, mut state) = (Rotor::new(9), seed | 1);
            for n in 0..500u64 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695);
                if (state >> 40) % 8 < lost { continue }
                let jitter = ((state >> 33) % 21) as f64 - 10.0;
                rotor.sync(1e7 + n as f64 * period + jitter);
            }
            let speed = rotor.speed_hz().unwrap();
            prop_assert!((speed / (TICKS_PER_SECOND / period) - 1.0).abs() < 5e-6);
            let reading = rotor.reading(1e7 + 500.25 * period).unwrap();
            let expected = std::f64::consts::TAU * 0.25 - PLANE_CENTRE[0];
            prop_assert!((reading.angle - expected).abs() < 2e-4);
        }

        #[test]
        fn any_syncs_are_survived(syncs in prop::collection::vec(-1e12f64..1e12, 0..50)) {
            let mut rotor = Rotor::new(3);
            for ticks in syncs {
                rotor.sync(ticks);
                if let Some(reading) = rotor.reading(ticks + 1e5) {
                    prop_assert!(reading.angle.is_finite() && reading.plane < 2);
                }
            }
        }
    }
}
