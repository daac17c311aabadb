//! How far each light plane agrees with the others.
//!
//! A base station's calibration or pose is often off by far more than its light's noise, and then
//! for all sensors alike, so that no single sweep looks wrong. What tells is that one plane keeps
//! disagreeing while the others agree: it then weighs less. When all disagree, the pose is wrong
//! and no plane is to blame.

use super::base_station::Source;

/// Base stations that are told apart.
const STATIONS: usize = Source::COUNT;
/// Weight of a sweep in the running figures: half a second of a headset's sweeps.
const RUNNING: f64 = 1.0 / 256.0;
/// A single deviation counts no more than this, rad.
const DEVIATION_MAX: f64 = 0.03;
/// A plane counts for comparison while its last sweep is no older than this, s.
const ACTIVE: f64 = 1.0;
/// Planes of stations that stand where they are taken to agree like this, rad; those of a station
/// that was moved by some centimetres disagree like this.
const AGREES: f64 = 1.5e-3;
const DISAGREES: f64 = 6e-3;
/// Deviations up to this times the others' are ordinary.
const ORDINARY: f64 = 2.0;

#[derive(Debug, Clone, Copy)]
struct Plane {
    /// Running mean of squared deviations, rad^2.
    square: f64,
    /// Time of its newest sweep, s.
    seen: f64,
}

/// The agreement of all planes.
#[derive(Debug, Clone)]
pub(super) struct Planes {
    planes: [[Plane; 2]; STATIONS],
    /// Variance of a sweep of an ordinary plane, rad^2.
    ordinary: f64,
}

impl Planes {
    /// `sigma`: standard deviation of a sweep of an ordinary plane, rad.
    pub(super) fn new(sigma: f64) -> Self {
        let unseen = Plane {
            square: sigma * sigma,
            seen: f64::NEG_INFINITY,
        };
        Self {
            planes: [[unseen; 2]; STATIONS],
            ordinary: sigma * sigma,
        }
    }

    /// A sweep of a plane deviates by `deviation` (rad) at `time`.
    pub(super) fn note(&mut self, station: usize, plane: usize, time: f64, deviation: f64) {
        let entry = self.planes.get_mut(station);
        if let Some(entry) = entry.and_then(|pair| pair.get_mut(plane)) {
            let deviation = deviation.abs().min(DEVIATION_MAX);
            entry.square += RUNNING * (deviation * deviation - entry.square);
            entry.seen = time;
        }
    }

    /// The variance of a sweep of a plane, rad^2.
    pub(super) fn variance(&self, station: usize, plane: usize, time: f64) -> f64 {
        let entry = self.planes.get(station).and_then(|pair| pair.get(plane));
        let Some(entry) = entry else {
            return self.ordinary;
        };
        let excess = entry.square / (ORDINARY * ORDINARY * self.reference(time));
        self.ordinary * excess.max(1.0)
    }

    /// A station both of whose planes keep disagreeing, while others agree among each other.
    pub(super) fn outlier(&self, time: f64) -> Option<usize> {
        let active = |plane: &Plane| time - plane.seen < ACTIVE;
        let agrees = |pair: &[Plane; 2]| {
            pair.iter()
                .all(|plane| active(plane) && plane.square < AGREES * AGREES)
        };
        if !self.planes.iter().any(agrees) {
            return None;
        }
        let disagrees = |pair: &[Plane; 2]| {
            pair.iter()
                .all(|plane| active(plane) && plane.square > DISAGREES * DISAGREES)
        };
        self.planes.iter().position(disagrees)
    }

    /// What ordinary planes deviate by now: the second best of those that are seen.
    fn reference(&self, time: f64) -> f64 {
        let (mut best, mut second) = (f64::INFINITY, f64::INFINITY);
        for plane in self
            .planes
            .iter()
            .flatten()
            .filter(|plane| time - plane.seen < ACTIVE)
        {
            if plane.square < best {
                (best, second) = (plane.square, best);
            } else {
                second = second.min(plane.square);
            }
        }
        let reference = if second.is_finite() { second } else { best };
        if reference.is_finite() {
            reference.max(self.ordinary)
        } else {
            self.ordinary
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA: f64 = 3e-4;

    fn after(deviations: [f64; 4]) -> [f64; 4] {
        let mut planes = Planes::new(SIGMA);
        let mut variances = [0.0; 4];
        for n in 0..2_000 {
            for (index, deviation) in deviations.into_iter().enumerate() {
                let time = f64::from(n) * 1e-3;
                planes.note(index / 2, index % 2, time, deviation);
                variances[index] = planes.variance(index / 2, index % 2, time);
            }
        }
        variances.map(|variance| variance.sqrt() / SIGMA)
    }

    #[test]
    fn only_the_plane_that_disagrees_loses_weight() {
        let [a, b, c, d] = after([2e-4, 3e-4, 1e-4, 6e-3]);
        assert_eq!([a, b, c], [1.0; 3]);
        assert!((d - 10.0).abs() < 0.1, "{d}");
    }

    #[test]
    fn when_all_disagree_no_plane_is_to_blame() {
        assert_eq!(after([6e-3; 4]), [1.0; 4]);
    }

    #[test]
    fn stations_out_of_range_are_ordinary() {
        let mut planes = Planes::new(SIGMA);
        planes.note(99, 0, 0.0, 1.0);
        assert_eq!(planes.variance(99, 0, 0.0), SIGMA * SIGMA);
    }
}
