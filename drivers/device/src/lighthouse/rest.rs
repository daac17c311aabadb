//! Whether a device lies still, from its inertial samples alone.
//!
//! What is held or worn never does: hands and heads turn by some hundredths of a radian a second
//! even while they are kept still. A device that lies on something shows nothing but its sensors'
//! noise.

use glam::DVec3;

use super::motion::ImuSample;

/// Time constant of the running figures, s.
const RUNNING: f64 = 0.25;
/// A device that lies still turns and is pushed by less than this about its mean, root mean square,
/// rad/s and m/s^2, and turns by less than this in the mean, bias taken off, rad/s.
const SCATTER: (f64, f64) = (0.006, 0.06);
const TURNING: f64 = 0.006;
/// A single sample further off than so many times that ends the rest at once.
const START: f64 = 5.0;
/// It has to have been so for this long, s.
const SETTLED: f64 = 0.5;

/// The running figures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rest {
    gyro: DVec3,
    accel: DVec3,
    square: (f64, f64),
    /// Since when it has been still, s of device time.
    since: Option<f64>,
}

impl Default for Rest {
    fn default() -> Self {
        Self {
            gyro: DVec3::ZERO,
            accel: DVec3::ZERO,
            // Nothing is known yet: as if it had just moved.
            square: ((START * SCATTER.0).powi(2), (START * SCATTER.1).powi(2)),
            since: None,
        }
    }
}

impl Rest {
    /// Takes a sample, biases taken off, that comes `dt` after the last one; whether the device lies
    /// still.
    pub(super) fn watch(&mut self, imu: &ImuSample, dt: f64) -> bool {
        let gain = (dt / RUNNING).clamp(0.0, 1.0);
        if self.accel == DVec3::ZERO {
            (self.gyro, self.accel) = (imu.gyro, imu.accel);
        }
        let (turn, push) = (imu.gyro - self.gyro, imu.accel - self.accel);
        self.gyro += gain * turn;
        self.accel += gain * push;
        self.square.0 += gain * (turn.length_squared() - self.square.0);
        self.square.1 += gain * (push.length_squared() - self.square.1);
        let within = |square: f64, limit: f64| square < limit * limit;
        let still = within(self.square.0, SCATTER.0)
            && within(self.square.1, SCATTER.1)
            && turn.length() < START * SCATTER.0
            && push.length() < START * SCATTER.1
            && self.gyro.length() < TURNING
            && !imu.clipped;
        if !still {
            self.since = None;
            return false;
        }
        imu.time - *self.since.get_or_insert(imu.time) > SETTLED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of a headset's sensors; what is on top of it is told.
    fn still_at(seconds: f64, motion: impl Fn(f64) -> (DVec3, DVec3)) -> Option<f64> {
        let mut rest = Rest::default();
        let mut first: Option<f64> = None;
        let mut state = 1u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f64 / f64::from(1u32 << 24) - 0.5
        };
        for n in 0..(seconds * 1e3) as u32 {
            let time = f64::from(n) * 1e-3;
            let mut vector = |size: f64| size * DVec3::new(noise(), noise(), noise());
            let (turn, push) = motion(time);
            let imu = ImuSample {
                time,
                accel: DVec3::new(1.0, 9.7, 0.0) + vector(0.04) + push,
                gyro: vector(0.003) + turn,
                clipped: false,
            };
            if rest.watch(&imu, 1e-3) {
                first.get_or_insert(time);
            } else if time > 2.0 {
                first = None;
            }
        }
        first
    }

    #[test]
    fn what_lies_still_is_seen_to() {
        let found = still_at(3.0, |_| (DVec3::ZERO, DVec3::ZERO)).unwrap();
        assert!(found < 2.0, "{found}");
    }

    #[test]
    fn what_is_held_or_carried_is_not() {
        let tremor = |t: f64| 0.02 * DVec3::new((40.0 * t).sin(), (9.0 * t).cos(), 0.0);
        assert_eq!(still_at(3.0, |t| (tremor(t), DVec3::ZERO)), None);
        let turning = DVec3::new(0.0, 0.02, 0.0);
        assert_eq!(still_at(3.0, |_| (turning, DVec3::ZERO)), None);
        // A push ends it at once.
        let push = |t: f64| {
            if t > 2.5 { DVec3::X * 0.5 } else { DVec3::ZERO }
        };
        assert_eq!(still_at(2.51, |t| (DVec3::ZERO, push(t))), None);
    }
}
