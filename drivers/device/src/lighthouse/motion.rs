//! Calibrated inertial samples, and how a device moved relative to one moment, from those alone.

use glam::{DQuat, DVec3};

use super::model::{ImuCalibration, ImuRange};
use super::wire::RawImu;

/// A calibrated inertial sample, IMU frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ImuSample {
    /// Device time, s.
    pub(super) time: f64,
    /// Specific force, m/s^2.
    pub(super) accel: DVec3,
    /// rad/s.
    pub(super) gyro: DVec3,
    /// Whether accelerometer or gyroscope stand at the end of their range, and so tell too little.
    pub(super) clipped: bool,
}

/// Raw readings from here on are at the end of the range.
const CLIPPED: u16 = 32_700;

impl ImuSample {
    pub(super) fn new(
        time: f64,
        raw: &RawImu,
        range: ImuRange,
        calibration: &ImuCalibration,
    ) -> Self {
        let clipped = |lsb: &i16| lsb.unsigned_abs() >= CLIPPED;
        let vector = |lsb: [i16; 3]| DVec3::from(lsb.map(f64::from));
        let accel = vector(raw.accel) * range.accel - calibration.accel_bias;
        let gyro = vector(raw.gyro) * range.gyro - calibration.gyro_bias;
        Self {
            time,
            accel: accel * calibration.accel_scale,
            gyro: gyro * calibration.gyro_scale,
            clipped: raw.accel.iter().chain(&raw.gyro).any(clipped),
        }
    }

    /// What holds between two samples.
    pub(super) fn mean(&self, later: &Self) -> Self {
        Self {
            time: later.time,
            accel: 0.5 * (self.accel + later.accel),
            gyro: 0.5 * (self.gyro + later.gyro),
            clipped: self.clipped || later.clipped,
        }
    }

    /// The sample with estimated biases taken off.
    pub(super) fn less(&self, accel_bias: DVec3, gyro_bias: DVec3) -> Self {
        Self {
            accel: self.accel - accel_bias,
            gyro: self.gyro - gyro_bias,
            ..*self
        }
    }
}

/// Where a device was at a time, relative to its pose and velocity at a reference time, with
/// gravity left out: `R(t) = R turn`, `p(t) = p + v tau + g tau^2 / 2 + R shift`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Seconds after the reference time; negative before it.
    pub(super) tau: f64,
    pub(super) turn: DQuat,
    /// The shift's derivative.
    drift: DVec3,
    pub(super) shift: DVec3,
}

/// The motion over a window that ends at the reference time.
#[derive(Debug, Clone, Default)]
pub(super) struct RelativeMotion {
    /// From the reference time backwards, each with the sample that holds before it.
    steps: Vec<(Step, ImuSample)>,
}

impl RelativeMotion {
    /// Integrates backwards from the newest of `samples` (in the order of time) to `begin`.
    pub(super) fn backwards<'a>(
        samples: impl DoubleEndedIterator<Item = &'a ImuSample>,
        begin: f64,
    ) -> Self {
        let mut steps: Vec<(Step, ImuSample)> = Vec::new();
        for sample in samples.rev() {
            let step = match steps.last_mut() {
                None => {
                    let (turn, zero) = (DQuat::IDENTITY, DVec3::ZERO);
                    Step {
                        tau: 0.0,
                        turn,
                        drift: zero,
                        shift: zero,
                    }
                }
                Some((later, held)) => {
                    // Between two samples their mean holds.
                    held.accel = 0.5 * (held.accel + sample.accel);
                    held.gyro = 0.5 * (held.gyro + sample.gyro);
                    let back = sample.time - held.time;
                    advance(later, held, back)
                }
            };
            steps.push((step, *sample));
            if sample.time <= begin {
                break;
            }
        }
        Self { steps }
    }

    /// The reference time, s.
    pub(super) fn reference(&self) -> Option<f64> {
        self.steps.first().map(|(_, sample)| sample.time)
    }

    /// The motion at a time within the window, or a little outside of it.
    pub(super) fn at(&self, time: f64) -> Option<Step> {
        let reference = self.reference()?;
        let tau = time - reference;
        // Steps go backwards: the first that is not later begins the interval's end.
        let after = self.steps.partition_point(|(step, _)| step.tau > tau);
        let (step, sample) = self.steps.get(after.saturating_sub(1))?;
        Some(advance(step, sample, tau - step.tau))
    }
}

/// Moves on by `dt` (of any sign) under a constant sample.
fn advance(step: &Step, sample: &ImuSample, dt: f64) -> Step {
    let half = step.turn * DQuat::from_scaled_axis(0.5 * dt * sample.gyro);
    let accel = half * sample.accel;
    Step {
        tau: step.tau + dt,
        turn: (step.turn * DQuat::from_scaled_axis(dt * sample.gyro)).normalize(),
        drift: step.drift + dt * accel,
        shift: step.shift + dt * step.drift + 0.5 * dt * dt * accel,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device on a turntable that also accelerates: position and rotation in closed form.
    #[test]
    fn the_motion_backwards_is_that_of_the_closed_form() {
        let gyro = DVec3::new(0.0, 2.0, 0.0);
        let push = DVec3::new(0.0, 0.0, -3.0);
        let rotation = |t: f64| DQuat::from_rotation_y(2.0 * t);
        let samples: Vec<_> = (0..=100)
            .map(|n| {
                let time = 5.0 + f64::from(n) * 1e-3;
                ImuSample {
                    time,
                    accel: rotation(time).conjugate() * push,
                    gyro,
                    clipped: false,
                }
            })
            .collect();
        let motion = RelativeMotion::backwards(samples.iter(), 5.0);
        let (end, velocity) = (5.1, DVec3::X);
        assert_eq!(motion.reference(), Some(samples[100].time));
        for time in [5.0, 5.0333, 5.0999, 5.1, 5.102] {
            let step = motion.at(time).unwrap();
            let tau = time - end;
            let turned = rotation(end) * step.turn;
            assert!(turned.angle_between(rotation(time)) < 1e-6);
            let moved = velocity * tau + rotation(end) * step.shift;
            let expected = velocity * tau + 0.5 * tau * tau * push;
            assert!(
                (moved - expected).length() < 1e-6,
                "{time}: {moved} {expected}"
            );
        }
    }

    #[test]
    fn without_samples_there_is_no_motion() {
        assert!(RelativeMotion::backwards([].iter(), 0.0).at(0.0).is_none());
    }
}
