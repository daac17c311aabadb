//! The inertial sensors: what they measure along a path, with their errors, as raw counts.

use glam::{DQuat, DVec3};

use super::blueprint::{Blueprint, ImuCalibration, ImuRange};
use super::clock::DeviceClock;
use super::device::{Path, Placement};
use super::options::ImuNoise;
use super::random::Random;

/// Standard gravity: what 1 g means in a configuration's and a report's units.
const G: f64 = 9.806_65;
/// Configurations give the accelerometer's bias in m/s^2 of this gravity.
const BIAS_G: f64 = 9.81;
/// A sensor averages over about its sampling interval; so do the differences taken here, s.
const HALF_WINDOW_S: f64 = 2.5e-4;

/// Specific force (m/s^2) and angular velocity (rad/s) of a frame that moves along `path`, in
/// that frame. `mount` is the frame's place on the moving body.
pub(super) fn inertial(path: &dyn Path, mount: &Placement, seconds: f64) -> (DVec3, DVec3) {
    let at = |offset: f64| path.at(seconds + offset).then(mount);
    let (before, now, after) = (at(-HALF_WINDOW_S), at(0.0), at(HALF_WINDOW_S));
    let second_difference = before.position + after.position - 2.0 * now.position;
    let acceleration = second_difference / (HALF_WINDOW_S * HALF_WINDOW_S);
    let force = now.rotation.conjugate() * (acceleration + DVec3::Y * G);
    let turn = before.rotation.conjugate() * after.rotation;
    (force, rotation_vector(turn) / (2.0 * HALF_WINDOW_S))
}

fn rotation_vector(turn: DQuat) -> DVec3 {
    let turn = if turn.w < 0.0 { -turn } else { turn };
    turn.to_scaled_axis()
}

/// One measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct RawImu {
    pub(super) accel: [i16; 3],
    pub(super) gyro: [i16; 3],
    /// The counter's lower 32 bits.
    pub(super) ticks: u32,
    /// Counts samples and wraps.
    pub(super) sequence: u8,
}

/// A device's inertial sensors.
pub(super) struct ImuSource {
    mount: Placement,
    calibration: ImuCalibration,
    range: ImuRange,
    noise: ImuNoise,
    random: Random,
    accel_bias: DVec3,
    gyro_bias: DVec3,
    interval_ticks: f64,
    next_ticks: f64,
    sequence: u8,
}

impl ImuSource {
    /// Sensors that measure every `interval_ticks`, from `start` (seconds) on.
    pub(super) fn new(
        blueprint: &Blueprint,
        noise: ImuNoise,
        mut random: Random,
        clock: &DeviceClock,
        interval_ticks: f64,
    ) -> Self {
        let first = clock.ticks(0.0) + random.unit() * interval_ticks;
        Self {
            mount: blueprint.imu_in_head(),
            calibration: blueprint.calibration,
            range: blueprint.range,
            noise,
            accel_bias: random.normal3(noise.accel_bias),
            gyro_bias: random.normal3(noise.gyro_bias),
            random,
            interval_ticks,
            next_ticks: first,
            sequence: 0,
        }
    }

    /// The next measurement, if it is made by `until` (seconds).
    pub(super) fn next(
        &mut self,
        path: &dyn Path,
        clock: &DeviceClock,
        until: f64,
    ) -> Option<RawImu> {
        let seconds = clock.seconds(self.next_ticks);
        if seconds > until {
            return None;
        }
        let (force, rate) = inertial(path, &self.mount, seconds);
        let step_s = clock.seconds(self.next_ticks + self.interval_ticks) - seconds;
        self.gyro_bias += self.random.normal3(self.noise.gyro_walk * step_s.sqrt());
        let force = force + self.accel_bias + self.random.normal3(self.noise.accel);
        let rate = rate + self.gyro_bias + self.random.normal3(self.noise.gyro);
        let raw = RawImu {
            accel: counts(self.raw_accel(force), self.range.acc_lsb()),
            gyro: counts(rate + self.calibration.gyro_bias, self.range.gyro_lsb()),
            ticks: self.next_ticks as u64 as u32,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.next_ticks += self.interval_ticks;
        Some(raw)
    }

    /// In g, before calibration: the inverse of (raw - bias) * scale.
    fn raw_accel(&self, force: DVec3) -> DVec3 {
        force / G / self.calibration.acc_scale + self.calibration.acc_bias / BIAS_G
    }
}

fn counts(value: DVec3, lsb: f64) -> [i16; 3] {
    // A cast from f64 saturates, as the sensor does.
    (value / lsb).to_array().map(|x| x.round() as i16)
}

#[cfg(test)]
mod tests {
    use super::super::device::Model;
    use super::super::random::Purpose;
    use super::*;
    use crate::simulate::Options;

    /// On a circle of 0.5 m radius at 2 rad/s, always facing outward along +X.
    fn circling(seconds: f64) -> Placement {
        let rotation = DQuat::from_rotation_y(2.0 * seconds);
        Placement {
            position: rotation * DVec3::new(0.5, 0.0, 0.0),
            rotation,
        }
    }

    #[test]
    fn a_circle_gives_centripetal_force_and_constant_rate() {
        let (force, rate) = inertial(&circling, &Placement::IDENTITY, 3.0);
        assert!(
            (force - DVec3::new(-2.0, G, 0.0)).length() < 1e-4,
            "{force}"
        );
        assert!((rate - DVec3::new(0.0, 2.0, 0.0)).length() < 1e-6, "{rate}");
        // A sensor at the centre of the circle feels none of it.
        let mount = Placement {
            position: DVec3::new(-0.5, 0.0, 0.0),
            rotation: DQuat::from_rotation_z(0.4),
        };
        let (force, _) = inertial(&circling, &mount, 3.0);
        assert!(
            (mount.rotation * force - DVec3::Y * G).length() < 1e-4,
            "{force}"
        );
    }

    fn still(_: f64) -> Placement {
        Placement {
            position: DVec3::Y,
            rotation: DQuat::from_rotation_x(0.3),
        }
    }

    /// What a reader makes of the counts with the configuration's calibration, in the IMU's frame.
    fn calibrated(blueprint: &Blueprint, raw: &RawImu) -> (DVec3, DVec3) {
        let [ax, ay, az] = raw.accel.map(f64::from);
        let [gx, gy, gz] = raw.gyro.map(f64::from);
        let accel = DVec3::new(ax, ay, az) * blueprint.range.acc_lsb();
        let accel =
            (accel - blueprint.calibration.acc_bias / 9.81) * blueprint.calibration.acc_scale;
        let gyro = DVec3::new(gx, gy, gz) * blueprint.range.gyro_lsb();
        (accel * G, gyro - blueprint.calibration.gyro_bias)
    }

    fn source(blueprint: &Blueprint, noise: ImuNoise) -> (ImuSource, DeviceClock) {
        let mut random = Random::new(1, Purpose::Device, 0);
        let clock = DeviceClock::new(&mut random, 20.0);
        let random = Random::new(1, Purpose::Imu, 0);
        (
            ImuSource::new(blueprint, noise, random, &clock, 47_990.0),
            clock,
        )
    }

    #[test]
    fn without_errors_the_calibrated_counts_are_the_truth_within_a_count() {
        let blueprint = Blueprint::new(Model::Headset, &Options::default(), 0);
        let (mut source, clock) = source(&blueprint, ImuNoise::NONE);
        let path: &dyn Path = &circling;
        while let Some(raw) = source.next(path, &clock, 0.2) {
            let ticks = clock.ticks(0.0) as u64;
            let since = raw.ticks.wrapping_sub(ticks as u32);
            let (force, rate) = inertial(
                path,
                &source.mount,
                clock.seconds((ticks + u64::from(since)) as f64),
            );
            let (accel, gyro) = calibrated(&blueprint, &raw);
            assert!((accel - force).abs().max_element() < 0.6 * G * blueprint.range.acc_lsb());
            assert!((gyro - rate).abs().max_element() < 0.6 * blueprint.range.gyro_lsb());
        }
    }

    #[test]
    fn noise_has_the_deviation_asked_for() {
        let blueprint = Blueprint::new(Model::Headset, &Options::default(), 0);
        let noise = ImuNoise {
            accel: 0.05,
            gyro: 0.004,
            ..ImuNoise::NONE
        };
        let (mut source, clock) = source(&blueprint, noise);
        let (mut accel, mut gyro, mut count) = (0.0, 0.0, 0.0);
        let (force, rate) = inertial(&still, &source.mount, 0.0);
        while let Some(raw) = source.next(&still, &clock, 4.0) {
            let (a, g) = calibrated(&blueprint, &raw);
            accel += (a - force).length_squared();
            gyro += (g - rate).length_squared();
            count += 3.0;
        }
        let (accel, gyro) = ((accel / count).sqrt(), (gyro / count).sqrt());
        assert!((accel / 0.05 - 1.0).abs() < 0.05, "{accel}");
        assert!((gyro / 0.004 - 1.0).abs() < 0.05, "{gyro}");
    }
}
