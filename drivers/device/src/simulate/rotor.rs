//! The rotors of base stations.

use super::ootx;
use super::options::LightNoise;
use super::random::Random;
use crate::lighthouse::base_station::BaseStation;
use crate::lighthouse::reproject::ROTOR_HZ;

/// Standard deviation of a rotor's mean speed from its channel's, parts in a million.
const SPEED_PPM: f64 = 5.0;

/// One turn of a rotor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rotation {
    /// When it began, seconds after the start.
    pub(super) sync_s: f64,
    /// How long it takes.
    pub(super) period_s: f64,
    /// The bit that it broadcasts.
    pub(super) ootx: bool,
}

/// A base station with its turning rotor.
pub(super) struct Rotor {
    pub(super) station: BaseStation,
    period_s: f64,
    next_s: f64,
    bits: Vec<bool>,
    bit: usize,
    jitter_s: f64,
    random: Random,
}

impl Rotor {
    pub(super) fn new(station: BaseStation, noise: LightNoise, mut random: Random) -> Self {
        let nominal = 1.0 / ROTOR_HZ[usize::from(station.channel) % ROTOR_HZ.len()];
        let period_s = nominal * (1.0 + random.normal(SPEED_PPM) * 1e-6);
        let bits = ootx::frame_bits(&station);
        Self {
            station,
            period_s,
            next_s: -random.unit() * period_s,
            bit: (random.unit() * bits.len() as f64) as usize,
            bits,
            jitter_s: noise.rotor_s,
            random,
        }
    }

    /// How long a turn takes in the mean, seconds.
    #[cfg(test)]
    pub(super) fn mean_period_s(&self) -> f64 {
        self.period_s
    }

    /// The next turn, if it has begun by `until` (seconds).
    pub(super) fn next(&mut self, until: f64) -> Option<Rotation> {
        if self.next_s > until {
            return None;
        }
        let rotation = Rotation {
            sync_s: self.next_s,
            period_s: self.period_s + self.random.normal(self.jitter_s),
            ootx: self.bits[self.bit % self.bits.len()],
        };
        self.bit = (self.bit + 1) % self.bits.len();
        self.next_s += rotation.period_s;
        Some(rotation)
    }
}
