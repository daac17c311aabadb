//! What a device's samples tell about how well it was tracked, without anything to compare to.

use glam::{DQuat, DVec3};
use posed_signal::{HostTime, Imu, Pose, PoseHow, Sample};
use serde::Serialize;

/// Time that a device is given to wake up and be found, s.
const WARM_UP: f64 = 3.0;
/// Share of time is counted in slots this long, s.
const SLOT: f64 = 0.02;
/// Rest is looked for in windows this long, s.
const WINDOW: f64 = 1.0;
/// A device turns and accelerates less than this at rest: mean square, rad/s and m/s^2.
const REST_GYRO: f64 = 0.04;
const REST_ACCEL: f64 = 0.15;

/// The figures; what could not be measured is left out.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Measures {
    /// Share of time at which light stood behind its pose, once it had time to be found.
    pub tracked: Option<f64>,
    /// Root mean square of those poses' residuals, rad.
    pub residual_rms_rad: Option<f64>,
    /// At rest: between up and what the accelerometer says is up, degrees; the median of windows.
    pub tilt_degrees: Option<f64>,
    /// At rest: standard deviation of the position, the mean of the axes, m; the median of windows.
    pub noise_m: Option<f64>,
    /// At rest: root mean square of rotations from their mean, degrees; the median of windows.
    pub noise_degrees: Option<f64>,
    /// Seconds at rest.
    pub rest_s: f64,
}

impl Measures {
    /// Of a device's samples, in the order in which they came.
    #[must_use]
    pub fn of(samples: &[Sample]) -> Self {
        let imu: Vec<Imu> = samples
            .iter()
            .filter_map(|sample| match sample {
                Sample::Imu(imu) => Some(*imu),
                _ => None,
            })
            .collect();
        let poses = optical(samples);
        let (Some(first), Some(last)) = (imu.first(), imu.last()) else {
            return Self::default();
        };
        let begin = first.at.plus_secs(WARM_UP);
        let settled = &poses[poses.partition_point(|pose| pose.at < begin)..];
        let squares: f64 = settled
            .iter()
            .map(|pose| f64::from(pose.residual_rad).powi(2))
            .sum();
        let windows: Vec<Rest> = windows(begin, last.at)
            .filter_map(|window| {
                Rest::of(
                    part(&imu, window, |imu| imu.at),
                    part(settled, window, |pose| pose.at),
                )
            })
            .collect();
        let median = |of: fn(&Rest) -> f64| {
            let mut values: Vec<f64> = windows.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Self {
            tracked: share(settled, begin, last.at),
            residual_rms_rad: (!settled.is_empty())
                .then(|| (squares / settled.len() as f64).sqrt()),
            tilt_degrees: median(|rest| rest.tilt),
            noise_m: median(|rest| rest.noise),
            noise_degrees: median(|rest| rest.turn),
            rest_s: windows.len() as f64 * WINDOW,
        }
    }
}

/// The poses that light stands behind.
pub(super) fn optical(samples: &[Sample]) -> Vec<Pose> {
    samples
        .iter()
        .filter_map(|sample| match sample {
            Sample::Pose(pose) if pose.how == PoseHow::Optical => Some(*pose),
            _ => None,
        })
        .collect()
}

/// Share of the slots between two times with a pose in them; `None` where there is no time.
fn share(poses: &[Pose], begin: HostTime, end: HostTime) -> Option<f64> {
    let slots = (end.since_secs(begin) / SLOT).floor();
    if slots < 1.0 {
        return None;
    }
    let slot = |pose: &Pose| (pose.at.since_secs(begin) / SLOT).floor();
    let mut seen = 0.0;
    let mut last = -1.0;
    for slot in poses.iter().map(slot).filter(|slot| *slot < slots) {
        if slot > last {
            (seen, last) = (seen + 1.0, slot);
        }
    }
    Some(seen / slots)
}

fn windows(begin: HostTime, end: HostTime) -> impl Iterator<Item = [HostTime; 2]> {
    let count = (end.since_secs(begin) / WINDOW).floor().max(0.0) as u32;
    (0..count).map(move |n| [n, n + 1].map(|n| begin.plus_secs(f64::from(n) * WINDOW)))
}

/// What of `all`, in the order of time, lies in a window.
fn part<T>(all: &[T], [begin, end]: [HostTime; 2], at: impl Fn(&T) -> HostTime) -> &[T] {
    let from = all.partition_point(|one| at(one) < begin);
    let to = all.partition_point(|one| at(one) < end);
    &all[from..to.max(from)]
}

/// One window at rest.
struct Rest {
    tilt: f64,
    noise: f64,
    turn: f64,
}

impl Rest {
    /// `None` where the device moved, or was not tracked.
    fn of(imu: &[Imu], poses: &[Pose]) -> Option<Self> {
        if imu.len() < 50 || poses.len() < 50 {
            return None;
        }
        let count = imu.len() as f64;
        let force = imu.iter().map(|imu| imu.accel.as_dvec3()).sum::<DVec3>() / count;
        let mean = |of: &dyn Fn(&Imu) -> f64| (imu.iter().map(of).sum::<f64>() / count).sqrt();
        let turning = mean(&|imu| imu.gyro.as_dvec3().length_squared());
        let shaking = mean(&|imu| (imu.accel.as_dvec3() - force).length_squared());
        if turning > REST_GYRO || shaking > REST_ACCEL {
            return None;
        }
        let count = poses.len() as f64;
        let middle = poses
            .iter()
            .map(|pose| pose.position.as_dvec3())
            .sum::<DVec3>()
            / count;
        let square = |pose: &Pose| (pose.position.as_dvec3() - middle).length_squared();
        let variance = poses.iter().map(square).sum::<f64>() / count;
        let rotation = mean_rotation(poses.iter().map(|pose| pose.rotation.as_dquat()));
        let angle = |pose: &Pose| pose.rotation.as_dquat().angle_between(rotation).powi(2);
        let turn = (poses.iter().map(angle).sum::<f64>() / count).sqrt();
        // What is worn at rest still drifts: its own acceleration is no gravity.
        let tenth = (poses.len() / 10).max(1);
        let (begin, end) = (speed(&poses[..tenth]), speed(&poses[poses.len() - tenth..]));
        let own = (end.1 - begin.1) / (end.0 - begin.0).max(0.1);
        Some(Self {
            tilt: (rotation * force - own)
                .angle_between(DVec3::Y)
                .to_degrees(),
            noise: (variance / 3.0).sqrt(),
            turn: turn.to_degrees(),
        })
    }
}

/// Mean time, s, and mean velocity, m/s.
fn speed(poses: &[Pose]) -> (f64, DVec3) {
    let count = poses.len() as f64;
    let time = poses.iter().map(|pose| pose.at.as_secs_f64()).sum::<f64>();
    let velocity = poses.iter().map(|pose| pose.velocity.as_dvec3());
    (time / count, velocity.sum::<DVec3>() / count)
}

/// The mean of rotations that are near each other.
pub(super) fn mean_rotation(rotations: impl Iterator<Item = DQuat>) -> DQuat {
    let mut first = None;
    let mut sum = glam::DVec4::ZERO;
    for rotation in rotations {
        let near = *first.get_or_insert(rotation);
        let signed = if near.dot(rotation) < 0.0 {
            -rotation
        } else {
            rotation
        };
        sum += glam::DVec4::from(signed);
    }
    match sum.try_normalize() {
        Some(mean) => DQuat::from_vec4(mean),
        None => DQuat::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds at rest, tilted by 0.2 degrees, poses from the fourth second on.
    #[test]
    fn a_device_at_rest_is_measured() {
        let up = DQuat::from_rotation_x(0.2f64.to_radians()) * DVec3::Y * 9.81;
        let mut samples = Vec::new();
        for n in 0..5_000u64 {
            let at = HostTime(n * 2_000_000);
            samples.push(Sample::Imu(Imu {
                at,
                accel: up.as_vec3(),
                gyro: glam::Vec3::ZERO,
            }));
            let side = if n % 2 == 0 { 1e-3 } else { -1e-3 };
            samples.push(Sample::Pose(Pose {
                position: glam::Vec3::splat(side),
                residual_rad: 1e-4,
                how: if n < 2_000 {
                    PoseHow::Lost
                } else {
                    PoseHow::Optical
                },
                ..Pose::unknown(at)
            }));
        }
        let found = Measures::of(&samples);
        assert!((found.tilt_degrees.unwrap() - 0.2).abs() < 1e-3);
        assert!((found.noise_m.unwrap() - 1e-3).abs() < 1e-6);
        assert!(found.noise_degrees.unwrap() < 1e-3);
        assert!(
            (found.tracked.unwrap() - 6.0 / 7.0).abs() < 0.01,
            "{:?}",
            found.tracked
        );
        assert!((found.residual_rms_rad.unwrap() - 1e-4).abs() < 1e-8);
        assert_eq!(found.rest_s, 5.0);
    }

    /// Level, but pushed forwards by 0.1 m/s^2 all the time, which looks like 0.6 degrees.
    #[test]
    fn a_devices_own_acceleration_is_no_tilt() {
        let mut samples = Vec::new();
        for n in 0..3_000u64 {
            let at = HostTime(n * 2_000_000);
            samples.push(Sample::Imu(Imu {
                at,
                accel: glam::Vec3::new(0.0, 9.81, -0.1),
                gyro: glam::Vec3::ZERO,
            }));
            let time = at.as_secs_f64() as f32;
            samples.push(Sample::Pose(Pose {
                position: glam::Vec3::new(0.0, 0.0, -0.05 * time * time),
                velocity: glam::Vec3::new(0.0, 0.0, -0.1 * time),
                how: PoseHow::Optical,
                ..Pose::unknown(at)
            }));
        }
        assert!(Measures::of(&samples).tilt_degrees.unwrap() < 0.01);
    }

    #[test]
    fn nothing_gives_nothing() {
        let found = Measures::of(&[]);
        assert!(found.tracked.is_none() && found.noise_m.is_none());
    }
}
