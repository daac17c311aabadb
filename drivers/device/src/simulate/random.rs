//! Randomness that follows from the seed: each purpose draws from a stream of its own, so that
//! changing one option leaves everything else as it was.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// What a stream of random numbers is for.
#[derive(Debug, Clone, Copy)]
#[repr(u64)]
pub(super) enum Purpose {
    Device = 1,
    Clock,
    Interval,
    Imu,
    Light,
    Rotor,
    Usb,
    Radio,
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(super) struct Random(Pcg64Mcg);

impl Random {
    /// The stream of the `index`-th device or base station for `purpose`.
    pub(super) fn new(seed: u64, purpose: Purpose, index: usize) -> Self {
        let stream = (purpose as u64) << 32 | index as u64;
        Self(Pcg64Mcg::seed_from_u64(
            seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15),
        ))
    }

    /// Normally distributed with this standard deviation.
    pub(super) fn normal(&mut self, deviation: f64) -> f64 {
        let unit: f64 = StandardNormal.sample(&mut self.0);
        unit * deviation
    }

    /// Three independent normal numbers.
    pub(super) fn normal3(&mut self, deviation: f64) -> glam::DVec3 {
        glam::DVec3::from_array([(); 3].map(|()| self.normal(deviation)))
    }

    /// Exponentially distributed with this mean.
    pub(super) fn exponential(&mut self, mean: f64) -> f64 {
        let unit: f64 = Exp1.sample(&mut self.0);
        unit * mean
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        self.0.random()
    }

    /// True with this probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_repeat_and_differ() {
        let draw = |purpose, index| {
            let mut random = Random::new(7, purpose, index);
            [random.unit(), random.normal(1.0), random.exponential(1.0)]
        };
        assert_eq!(draw(Purpose::Imu, 0), draw(Purpose::Imu, 0));
        assert_ne!(draw(Purpose::Imu, 0), draw(Purpose::Imu, 1));
        assert_ne!(draw(Purpose::Imu, 0), draw(Purpose::Light, 0));
    }

    #[test]
    fn moments_are_as_asked_for() {
        let mut random = Random::new(3, Purpose::Imu, 0);
        let count = 20_000;
        let normal: Vec<f64> = (0..count).map(|_| random.normal(2.0)).collect();
        let mean = normal.iter().sum::<f64>() / f64::from(count);
        let variance = normal.iter().map(|x| x * x).sum::<f64>() / f64::from(count);
        assert!(mean.abs() < 0.06 && (variance.sqrt() - 2.0).abs() < 0.05);
        let waits = (0..count).map(|_| random.exponential(3.0)).sum::<f64>() / f64::from(count);
        assert!((waits - 3.0).abs() < 0.1);
    }
}
