//! Orientation of devices that report nothing but accelerometer and gyroscope.
//!
//! The filter is VQF (Laidig and Seel 2023, "VQF: Highly accurate IMU orientation estimation with
//! bias estimation and magnetic disturbance rejection", Information Fusion 91), the most accurate
//! of eight in its authors' comparison on public benchmarks without tuning, and the one that
//! SlimeVR's trackers run themselves. Of its crates, `vqf-rs` is a direct port of the authors' own
//! C++, with the estimation of the gyroscope's bias at rest and in motion, and no dependencies;
//! `vqf` lacks the magnetometer and brings another nalgebra.

use glam::{DVec3, Quat, Vec3};
use posed_signal::{Imu, Orientation};
use vqf_rs::VQF;

use crate::slimevr::wire::WORLD;

/// Standard gravity, m/s^2.
const G: f32 = 9.806_65;
/// A gap longer than this is bridged as if it were this long, in seconds.
const GAP_MAX_S: f64 = 0.1;

/// The orientation filter of one device.
pub struct Fusion {
    vqf: VQF,
    interval_s: f64,
    last: Option<posed_signal::HostTime>,
}

impl Fusion {
    /// For a device that measures every `interval_s` seconds.
    #[must_use]
    pub fn new(interval_s: f64) -> Self {
        Self {
            vqf: VQF::new(interval_s, None, None, None),
            interval_s,
            last: None,
        }
    }

    /// Takes a sample; samples come in the order of time. The world's heading is whatever it was
    /// at the first sample.
    pub fn update(&mut self, imu: &Imu) -> Orientation {
        let step = self.last.map_or(self.interval_s, |last| {
            imu.at.since_secs(last).clamp(0.0, GAP_MAX_S)
        });
        self.last = Some(imu.at);
        // Times of single samples jitter, the device's own clock does not: only where samples are
        // missing does the time tell more than the interval.
        let missing = step > 1.5 * self.interval_s;
        let step = if missing { step } else { self.interval_s };
        let gyro = imu.gyro.as_dvec3();
        self.vqf.update_gyr_with_ts(gyro.to_array(), step);
        self.vqf.update_acc(imu.accel.as_dvec3().to_array());
        let quaternion = self.vqf.quat_6d();
        let [w, x, y, z] = [quaternion.0, quaternion.1, quaternion.2, quaternion.3];
        let upright = Quat::from_xyzw(x as f32, y as f32, z as f32, w as f32);
        let rotation = (WORLD * upright).normalize();
        let bias = DVec3::from_array(self.vqf.bias_estimate().0);
        Orientation {
            at: imu.at,
            rotation,
            accel: rotation * imu.accel - Vec3::Y * G,
            angular_velocity: rotation * (gyro - bias).as_vec3(),
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;

    use super::*;

    /// Swings about two axes, with a gyroscope that is 0.5 degrees a second off.
    #[test]
    fn follows_a_swing_and_learns_the_bias_at_rest() {
        let interval = 0.005;
        let bias = Vec3::new(0.3, -0.3, 0.25) * 1f32.to_radians();
        let truth = |seconds: f64| {
            let swing = ((seconds - 4.0).max(0.0) * 3.0).sin() as f32;
            Quat::from_rotation_y(0.8 * swing) * Quat::from_rotation_x(0.5 * swing + 0.3)
        };
        let mut fusion = Fusion::new(interval);
        let mut start = None;
        for step in 0..6_000u32 {
            let seconds = f64::from(step) * interval;
            let (before, after) = (truth(seconds - interval), truth(seconds));
            let turn = before.inverse() * after;
            let imu = Imu {
                at: HostTime::from_secs_f64(1.0 + seconds),
                accel: after.inverse() * Vec3::Y * G,
                gyro: turn.to_scaled_axis() / interval as f32 + bias,
            };
            let answer = fusion.update(&imu);
            let heading = *start.get_or_insert(answer.rotation * after.inverse());
            let error = (heading * after)
                .angle_between(answer.rotation)
                .to_degrees();
            assert!(error < 2.5, "{seconds} s: {error} degrees");
            assert!(answer.is_sound());
            if step == 799 {
                let left = answer.angular_velocity.length().to_degrees();
                assert!(left < 0.1, "bias left at rest: {left} degrees a second");
            }
            if step > 800 {
                assert!(answer.accel.length() < 0.4, "{}", answer.accel);
            }
        }
    }
}
