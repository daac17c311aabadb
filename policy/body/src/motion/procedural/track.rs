//! Quantities that go from key to key along minimum-jerk curves, and smooth noise: all twice
//! continuously differentiable.

use std::array::from_fn;
use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// From 0 to 1 with neither velocity nor acceleration at the ends (Flash and Hogan 1985).
pub(super) fn minimum_jerk(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

/// The integral of [`minimum_jerk`] from 0.
fn minimum_jerk_integral(u: f64) -> f64 {
    let inner = u.clamp(0.0, 1.0);
    let integral = inner.powi(4) * (2.5 + inner * (inner - 3.0));
    integral + (u - 1.0).max(0.0)
}

/// From 0 up to 1 in the middle and down to 0, with neither velocity nor acceleration at the ends.
pub(super) fn bump(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    64.0 * (u * (1.0 - u)).powi(3)
}

/// From 0 to 1 over `duration`, at constant speed but for the `ramp` at either end.
pub(super) fn cruise(t: f64, duration: f64, ramp: f64) -> f64 {
    let ramp = ramp.min(duration / 2.0);
    let up = minimum_jerk_integral(t / ramp);
    let down = minimum_jerk_integral((t - (duration - ramp)) / ramp);
    (up - down) * ramp / (duration - ramp)
}

/// A quantity of `N` numbers that moves from key to key.
#[derive(Debug, Clone)]
pub(super) struct Track<const N: usize> {
    start: [f64; N],
    /// Begin and end of each movement, and where it leads.
    keys: Vec<(f64, f64, [f64; N])>,
}

impl<const N: usize> Track<N> {
    pub(super) fn new(start: [f64; N]) -> Self {
        let keys = Vec::new();
        Self { start, keys }
    }

    /// Moves to `target` between two times, in seconds.
    pub(super) fn to(&mut self, begin: f64, end: f64, target: [f64; N]) {
        self.keys.push((begin, end, target));
    }

    pub(super) fn at(&self, t: f64) -> [f64; N] {
        let (mut value, mut from) = (self.start, self.start);
        for &(begin, end, target) in &self.keys {
            let share = minimum_jerk((t - begin) / (end - begin));
            value = from_fn(|n| value[n] + share * (target[n] - from[n]));
            from = target;
        }
        value
    }
}

/// Slow random movement about zero: a sum of sines.
#[derive(Debug, Clone)]
pub(super) struct Drift<const N: usize> {
    waves: [[(f64, f64, f64); 3]; N],
}

impl<const N: usize> Drift<N> {
    /// Of about this amplitude, with frequencies of up to `hz`.
    pub(super) fn new(random: &mut Random, amplitude: f64, hz: f64) -> Self {
        let mut wave = |share: f64| {
            let frequency = hz * share * random.between(0.7, 1.0);
            (
                amplitude * (1.2 - share),
                TAU * frequency,
                random.between(0.0, TAU),
            )
        };
        Self {
            waves: from_fn(|_| [wave(0.25), wave(0.5), wave(1.0)]),
        }
    }

    pub(super) fn at(&self, t: f64) -> [f64; N] {
        let sine =
            |&(amplitude, rate, phase): &(f64, f64, f64)| amplitude * (rate * t + phase).sin();
        from_fn(|n| self.waves[n].iter().map(sine).sum::<f64>() / 2.0)
    }
}

/// Random numbers from a seed.
pub(super) struct Random(Pcg64Mcg);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// Uniform between two bounds.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + self.0.random::<f64>() * (high - low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_start_and_end_at_rest() {
        type Curve = fn(f64) -> f64;
        let curves: [(Curve, f64); 3] = [
            (minimum_jerk, 1.0),
            (bump, 0.0),
            (|u| cruise(3.0 * u, 3.0, 0.7), 1.0),
        ];
        for (curve, end) in curves {
            let h = 1e-3;
            assert!(curve(0.0).abs() < 1e-12 && (curve(1.0) - end).abs() < 1e-12);
            for edge in [0.0, 1.0] {
                let (before, at, after) = (curve(edge - h), curve(edge), curve(edge + h));
                assert!((after - before).abs() / (2.0 * h) < 1e-3);
                assert!((after - 2.0 * at + before).abs() / (h * h) < 1.0);
            }
        }
        assert_eq!(bump(0.5), 1.0);
        assert!((cruise(1.5, 3.0, 0.7) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn tracks_hold_between_movements_and_may_overlap() {
        let mut track = Track::new([1.0]);
        track.to(1.0, 2.0, [3.0]);
        track.to(4.0, 5.0, [0.0]);
        assert_eq!(track.at(0.5), [1.0]);
        assert_eq!(track.at(1.5), [2.0]);
        assert_eq!(track.at(3.0), [3.0]);
        assert_eq!(track.at(9.0), [0.0]);
        track.to(4.5, 6.0, [10.0]);
        assert_eq!(track.at(6.0), [10.0]);
    }
}
