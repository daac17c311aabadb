//! The rotors of base stations.

use super::ootx;
use super::options::{LightNoise, Move};
use super::random::Random;
use crate::lighthouse::base_station::{BaseStation, Generation};
use crate::lighthouse::reproject::ROTOR_HZ;

/// Standard deviation of a rotor's mean speed from its channel's, parts in a million.
const SPEED_PPM: f64 = 5.0;

/// Flashes of generation 1 a second, and from the first station's to the second's, seconds.
const FLASHES_HZ: f64 = 120.0;
const SLOT_S: f64 = 20_000.0 / 48e6;

/// One turn of a rotor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rotation {
    /// When it began, seconds after the start.
    pub(super) sync_s: f64,
    /// How long it takes.
    pub(super) period_s: f64,
    /// The bit that it broadcasts.
    pub(super) ootx: bool,
    /// Of a base station of generation 1, whose rotations are half turns: which rotor is up.
    pub(super) turn: Turn,
}

/// What of a base station of generation 1 passes the room.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Turn {
    /// Which rotor's turn it is.
    pub(super) rotor: u8,
    /// Whether the station leaves it to the other one.
    pub(super) skips: bool,
}

/// A base station with its turning rotor.
pub(super) struct Rotor {
    pub(super) station: BaseStation,
    period_s: f64,
    next_s: f64,
    bits: Vec<bool>,
    bit: usize,
    /// Flashes so far of generation 1, and whether it has the room for itself.
    flashes: u64,
    alone: bool,
    jitter_s: f64,
    random: Random,
}

impl Rotor {
    /// A base station's, which is one of `stations`.
    pub(super) fn new(
        station: BaseStation,
        stations: usize,
        noise: LightNoise,
        mut random: Random,
    ) -> Self {
        let nominal = 1.0 / ROTOR_HZ[station.source.index() % ROTOR_HZ.len()];
        let period_s = nominal * (1.0 + random.normal(SPEED_PPM) * 1e-6);
        let bits = ootx::frame_bits(&station);
        let (period_s, first_s) = match station.source.generation() {
            Generation::Two => (period_s, -random.unit() * period_s),
            // They keep step with each other.
            Generation::One => {
                let slot = (station.source.index() & 1) as f64;
                (1.0 / FLASHES_HZ, slot * SLOT_S - 1.0 / FLASHES_HZ)
            }
        };
        Self {
            station,
            period_s,
            next_s: first_s,
            flashes: 0,
            alone: stations < 2,
            bit: (random.unit() * bits.len() as f64) as usize,
            bits,
            jitter_s: noise.rotor_s,
            random,
        }
    }

    /// Puts the station to where the last of `moves` by `seconds` left it.
    pub(super) fn stand(&mut self, moves: &[Move], seconds: f64) {
        let last = moves
            .iter()
            .rev()
            .find(|moved| moved.source == self.station.source && moved.at_s <= seconds);
        if let Some(moved) = last {
            (self.station.position, self.station.rotation) = (moved.position, moved.rotation);
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
            period_s: self.period_s
                + match self.station.source.generation() {
                    Generation::One => 0.0,
                    Generation::Two => self.random.normal(self.jitter_s),
                },
            ootx: self.bits[self.bit % self.bits.len()],
            turn: self.turn(),
        };
        self.flashes += 1;
        self.bit = (self.bit + 1) % self.bits.len();
        self.next_s += rotation.period_s;
        Some(rotation)
    }

    /// Rotors take turns, and stations after both of one's rotors were up.
    fn turn(&self) -> Turn {
        if self.station.source.generation() == Generation::Two {
            return Turn::default();
        }
        let slot = self.station.source.index() as u64 & 1;
        Turn {
            rotor: (self.flashes & 1) as u8,
            skips: !self.alone && self.flashes >> 1 & 1 != slot,
        }
    }
}
