//! The error-state Kalman filter that fuses inertial samples with single sweeps (after Sola 2017,
//! "Quaternion kinematics for the error-state Kalman filter").
//!
//! The state is the pose and velocity of the IMU's frame in the world, the biases of gyroscope and
//! accelerometer, and the tilt of gravity against the base stations' world, which is off by a
//! tenth of a degree in practice. The rotation's error is in the IMU's frame. Every sweep is a
//! measurement of its own at its own time, so that motion within a revolution needs no window.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use super::{
    model::{DeviceModel, Frame, GRAVITY},
    motion::ImuSample,
    planes::Planes,
    rest::Rest,
    room::Placed,
    solve::{Sighting, Solution, station_of},
};

const N: usize = 17;
const POSITION: usize = 0;
const VELOCITY: usize = 3;
const ROTATION: usize = 6;
const GYRO_BIAS: usize = 9;
const ACCEL_BIAS: usize = 12;
const TILT: usize = 15;

type Covariance = SMatrix<f64, N, N>;

/// Noise of the model. Densities are per root hertz; the first of a pair always holds, the second
/// is a share of what is measured, for scale errors and vibration.
const GYRO_NOISE: (f64, f64) = (5e-5, 1e-2);
const ACCEL_NOISE: (f64, f64) = (1e-3, 2e-2);
/// Densities while a sensor stands at the end of its range: accelerometer, gyroscope.
const CLIPPED_NOISE: (f64, f64) = (10.0, 1.0);
/// Samples come at least this often, s. What happened in a longer gap is not known: acceleration
/// and turn rate may have been off by so much, and by a share of what is measured around it.
const IMU_INTERVAL: f64 = 0.01;
const GAP_ACCEL: (f64, f64) = (0.5, 1.0);
const GAP_GYRO: (f64, f64) = (0.1, 0.5);
/// Random walks of the biases, per root second.
const GYRO_BIAS_WALK: f64 = 2e-5;
const ACCEL_BIAS_WALK: f64 = 3e-4;
const TILT_WALK: f64 = 1e-6;
/// Standard deviations at the start: what the factory calibration leaves, and the base stations.
const GYRO_BIAS_START: f64 = 0.02;
const ACCEL_BIAS_START: f64 = 0.15;
const TILT_START: f64 = 0.005;
/// A sweep's standard deviation, rad. Its noise is 6e-5; the rest is what the calibrations of
/// sensors and base stations leave, measured in captures.
const SWEEP_SIGMA: f64 = 3e-4;
/// Innovations beyond so many standard deviations weigh less, beyond the second number nothing.
const SOFT_GATE: f64 = 3.0;
const HARD_GATE: f64 = 8.0;
/// Sensors hardly see light that comes from behind this angle, as a cosine.
const FACING_COSINE: f64 = -0.1;

/// A device that lies still is told so, m/s, this often, s, unless it is thought to move by more
/// than the last of these, m/s.
const STILL_SIGMA: f64 = 3e-4;
const STILL_INTERVAL: f64 = 0.01;
const STILL_SPEED: f64 = 4e-3;
/// What a pose may be off after base stations got better places, m and rad.
const REPLACED: (f64, f64) = (0.01, 0.01);

/// Pose and velocity of the IMU's frame in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nominal {
    pub(super) position: DVec3,
    pub(super) velocity: DVec3,
    pub(super) rotation: DQuat,
}

impl Nominal {
    /// Moves on by `dt` under a sample without biases; `gravity` points down.
    pub(super) fn advance(&mut self, dt: f64, imu: &ImuSample, gravity: DVec3) {
        let half = self.rotation * DQuat::from_scaled_axis(0.5 * dt * imu.gyro);
        let accel = half * imu.accel + gravity;
        self.position += dt * self.velocity + 0.5 * dt * dt * accel;
        self.velocity += dt * accel;
        self.rotation = (self.rotation * DQuat::from_scaled_axis(dt * imu.gyro)).normalize();
    }
}

/// What became of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    /// It was used: the residual that is left, rad, and its weight beside an ordinary sweep's.
    Accepted(f64, f64),
    /// It does not fit well, and was not used: others may tell what it is.
    Doubtful,
    /// It does not fit: a reflection, or the filter is wrong.
    Rejected,
    /// It cannot be compared: no such sensor, or a base station that is not known.
    Ignored,
}

/// How often a sweep has been tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trial {
    /// One that does not fit well may wait for others: a state that is not known well cannot tell a
    /// reflection from its own error, but once others have improved it, it can.
    First,
    /// Now it is used or not.
    Second,
}

/// The filter.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    /// Device time of the state, s.
    pub(super) time: f64,
    pub(super) nominal: Nominal,
    pub(super) gyro_bias: DVec3,
    pub(super) accel_bias: DVec3,
    /// Rotations of gravity's direction about the world's x and z, rad.
    tilt: [f64; 2],
    covariance: Covariance,
    /// The newest sample, biases taken off.
    imu: ImuSample,
    planes: Planes,
    rest: Rest,
    /// When it was last told that it lies still, s.
    told_still: f64,
}

impl Filter {
    /// Starts from a solution that holds at the time of `imu`.
    pub(super) fn new(solution: &Solution, imu: &ImuSample) -> Self {
        let mut covariance = Covariance::zeros();
        covariance
            .fixed_view_mut::<9, 9>(0, 0)
            .copy_from(&solution.covariance);
        let starts = [
            (GYRO_BIAS, 3, GYRO_BIAS_START),
            (ACCEL_BIAS, 3, ACCEL_BIAS_START),
        ];
        for (at, count, sigma) in starts.into_iter().chain([(TILT, 2, TILT_START)]) {
            for axis in at..at + count {
                covariance[(axis, axis)] = sigma * sigma;
            }
        }
        Self {
            time: imu.time,
            nominal: Nominal {
                position: solution.position,
                velocity: solution.velocity,
                rotation: solution.rotation,
            },
            gyro_bias: DVec3::ZERO,
            accel_bias: DVec3::ZERO,
            tilt: [0.0; 2],
            covariance,
            imu: *imu,
            planes: Planes::new(SWEEP_SIGMA),
            rest: Rest::default(),
            told_still: f64::NEG_INFINITY,
        }
    }

    /// Starts again from a solution, keeping what was learnt about biases and gravity.
    pub(super) fn restart(&mut self, solution: &Solution, imu: &ImuSample) {
        let fresh = Self::new(solution, imu);
        let mut covariance = fresh.covariance;
        const KEPT: usize = N - GYRO_BIAS;
        let learnt = self
            .covariance
            .fixed_view::<KEPT, KEPT>(GYRO_BIAS, GYRO_BIAS);
        covariance
            .fixed_view_mut::<KEPT, KEPT>(GYRO_BIAS, GYRO_BIAS)
            .copy_from(&learnt);
        (self.time, self.nominal, self.covariance) = (fresh.time, fresh.nominal, covariance);
        self.imu = self.unbiased(imu);
    }

    /// Gravity in the world, m/s^2.
    pub(super) fn gravity(&self) -> DVec3 {
        // Small rotations about x and z of a vector that points down.
        GRAVITY * DVec3::new(self.tilt[1], -1.0, -self.tilt[0])
    }

    /// A sample with the estimated biases taken off.
    pub(super) fn unbiased(&self, imu: &ImuSample) -> ImuSample {
        imu.less(self.accel_bias, self.gyro_bias)
    }

    /// Moves on to the time of a sample.
    pub(super) fn propagate(&mut self, imu: &ImuSample) {
        let dt = imu.time - self.time;
        if dt <= 0.0 {
            return;
        }
        let newest = self.unbiased(imu);
        let mean = self.imu.mean(&newest);
        self.propagate_covariance(dt, &mean);
        self.nominal.advance(dt, &mean, self.gravity());
        (self.time, self.imu) = (imu.time, newest);
        if self.rest.watch(&newest, dt) && (imu.time - self.told_still).abs() > STILL_INTERVAL {
            self.told_still = imu.time;
            self.hold();
        }
    }

    /// The device lies still: its velocity is zero.
    fn hold(&mut self) {
        if self.nominal.velocity.length() > STILL_SPEED {
            return;
        }
        for axis in 0..3 {
            let mut row = SVector::<f64, 9>::zeros();
            row[VELOCITY + axis] = 1.0;
            self.update(
                -self.nominal.velocity[axis],
                STILL_SIGMA * STILL_SIGMA,
                &row,
            );
        }
    }

    /// Base stations have got better places: the pose among them is not known as well any more.
    pub(super) fn loosen(&mut self) {
        for axis in 0..3 {
            self.covariance[(POSITION + axis, POSITION + axis)] += REPLACED.0 * REPLACED.0;
            self.covariance[(ROTATION + axis, ROTATION + axis)] += REPLACED.1 * REPLACED.1;
        }
    }

    /// P becomes F P F' + Q, block by block: F differs from the identity in few places.
    fn propagate_covariance(&mut self, dt: f64, imu: &ImuSample) {
        let rotation = DMat3::from_quat(self.nominal.rotation);
        let velocity_by_rotation = rotation * cross(imu.accel) * -dt;
        let velocity_by_bias = rotation * -dt;
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(-dt * imu.gyro));
        let p = &mut self.covariance;
        // First the rows, then the columns in the same way: (F P) F'.
        for pass in 0..2 {
            for k in 0..N {
                let at = |row: usize| if pass == 0 { (row, k) } else { (k, row) };
                let part = |p: &Covariance, row: usize| {
                    DVec3::new(p[at(row)], p[at(row + 1)], p[at(row + 2)])
                };
                let (velocity, angle) = (part(p, VELOCITY), part(p, ROTATION));
                let (gyro_bias, accel_bias) = (part(p, GYRO_BIAS), part(p, ACCEL_BIAS));
                let tilt = (p[at(TILT)], p[at(TILT + 1)]);
                let fall = dt * GRAVITY * DVec3::new(tilt.1, 0.0, -tilt.0);
                let position = part(p, POSITION) + dt * velocity;
                let velocity =
                    velocity + velocity_by_rotation * angle + velocity_by_bias * accel_bias + fall;
                let angle = turn * angle - dt * gyro_bias;
                for axis in 0..3 {
                    p[at(POSITION + axis)] = position[axis];
                    p[at(VELOCITY + axis)] = velocity[axis];
                    p[at(ROTATION + axis)] = angle[axis];
                }
            }
        }
        let clipped = if imu.clipped {
            CLIPPED_NOISE
        } else {
            (0.0, 0.0)
        };
        let noise = |(still, share): (f64, f64), measured: f64, clipped: f64| {
            (still * still + share * share * measured * measured + clipped * clipped) * dt
        };
        let accel = noise(ACCEL_NOISE, (imu.accel.length() - GRAVITY).abs(), clipped.0);
        let gyro = noise(GYRO_NOISE, imu.gyro.length(), clipped.1);
        let walk = |sigma: f64| sigma * sigma * dt;
        let gap = (dt - IMU_INTERVAL).max(0.0);
        let gap_accel = gap * (GAP_ACCEL.0 + GAP_ACCEL.1 * (imu.accel.length() - GRAVITY).abs());
        let gap_gyro = gap * (GAP_GYRO.0 + GAP_GYRO.1 * imu.gyro.length());
        for axis in 0..3 {
            p[(POSITION + axis, POSITION + axis)] += (0.5 * gap * gap_accel).powi(2);
            p[(VELOCITY + axis, VELOCITY + axis)] += accel + gap_accel * gap_accel;
            p[(ROTATION + axis, ROTATION + axis)] += gyro + gap_gyro * gap_gyro;
            p[(GYRO_BIAS + axis, GYRO_BIAS + axis)] += walk(GYRO_BIAS_WALK);
            p[(ACCEL_BIAS + axis, ACCEL_BIAS + axis)] += walk(ACCEL_BIAS_WALK);
        }
        for axis in 0..2 {
            p[(TILT + axis, TILT + axis)] += walk(TILT_WALK);
        }
    }

    /// Takes a sweep, which may lie a few milliseconds off the state's time.
    pub(super) fn sweep(
        &mut self,
        stations: &Placed,
        model: &DeviceModel,
        seen: &Sighting,
        trial: Trial,
    ) -> Verdict {
        let sensor = model
            .sensors
            .get(usize::from(seen.sensor))
            .copied()
            .flatten();
        let (Some(station), Some(sensor)) = (station_of(stations, seen), sensor) else {
            return Verdict::Ignored;
        };
        let Nominal {
            position,
            velocity,
            rotation,
        } = self.nominal;
        let tau = seen.time - self.time;
        let turn = DQuat::from_scaled_axis(tau * self.imu.gyro);
        let arm = turn * sensor.position;
        let point = position + tau * velocity + rotation * arm;
        let looks = rotation * (turn * sensor.normal);
        if looks.dot((station.position - point).normalize_or_zero()) < FACING_COSINE {
            return Verdict::Rejected;
        }
        let plane = usize::from(seen.plane & 1);
        let (expected, local) = station.reading(plane, station.to_local(point));
        let by_point = station.rotation * local;
        let by_rotation = arm.cross(rotation.conjugate() * by_point);
        let by_velocity = tau * by_point;
        let rows = [by_point, by_velocity, by_rotation];
        let row = SVector::<f64, 9>::from_iterator(rows.iter().flat_map(DVec3::to_array));
        let innovation = seen.angle - expected;
        let station = usize::from(seen.station);
        let noise = self.planes.variance(station, plane, seen.time);
        let known = row.dot(&(self.covariance.fixed_view::<9, 9>(0, 0) * row));
        let ratio = (innovation * innovation / (known + noise)).sqrt();
        if trial == Trial::First && ratio > SOFT_GATE {
            return Verdict::Doubtful;
        }
        self.planes.note(station, plane, seen.time, innovation);
        self.update(innovation, noise, &row)
    }

    /// The Kalman update with a scalar whose derivative over all but the first nine states is 0.
    fn update(&mut self, innovation: f64, noise: f64, row: &SVector<f64, 9>) -> Verdict {
        let gain: SVector<f64, N> = self.covariance.fixed_columns::<9>(0) * row;
        let known = row.dot(&gain.fixed_rows::<9>(0));
        let ratio = (innovation * innovation / (known + noise)).sqrt();
        if ratio.is_nan() || ratio > HARD_GATE {
            return Verdict::Rejected;
        }
        // Beyond the soft gate the influence stays what it is there (Huber).
        let variance = known + noise * (ratio / SOFT_GATE).max(1.0).powi(2);
        let change = gain * (innovation / variance);
        self.covariance.ger(-1.0 / variance, &gain, &gain, 1.0);
        self.inject(&change);
        let weight = SWEEP_SIGMA * SWEEP_SIGMA / noise;
        Verdict::Accepted(innovation * (1.0 - known / variance), weight)
    }

    fn inject(&mut self, change: &SVector<f64, N>) {
        let part = |at: usize| DVec3::new(change[at], change[at + 1], change[at + 2]);
        self.nominal.position += part(POSITION);
        self.nominal.velocity += part(VELOCITY);
        let turn = DQuat::from_scaled_axis(part(ROTATION));
        self.nominal.rotation = (self.nominal.rotation * turn).normalize();
        let (gyro, accel) = (part(GYRO_BIAS), part(ACCEL_BIAS));
        self.gyro_bias += gyro;
        self.accel_bias += accel;
        self.imu = self.imu.less(accel, gyro);
        self.tilt[0] += change[TILT];
        self.tilt[1] += change[TILT + 1];
    }

    /// A station whose light keeps disagreeing with the others', by its number.
    pub(super) fn outlier(&self) -> Option<usize> {
        self.planes.outlier(self.time)
    }

    /// Goes along when the whole world is moved by a turn about the vertical and then a shift.
    pub(super) fn carry(&mut self, by: &Frame) {
        let Nominal {
            position,
            velocity,
            rotation,
        } = self.nominal;
        self.nominal = Nominal {
            position: by.position + by.rotation * position,
            velocity: by.rotation * velocity,
            rotation: (by.rotation * rotation).normalize(),
        };
        let tilt = by.rotation * DVec3::new(self.tilt[0], 0.0, self.tilt[1]);
        self.tilt = [tilt.x, tilt.z];
    }

    /// Whether every number is finite and the covariance still is one.
    pub(super) fn is_sound(&self) -> bool {
        let Nominal {
            position,
            velocity,
            rotation,
        } = self.nominal;
        position.is_finite()
            && velocity.is_finite()
            && rotation.is_finite()
            && self.gyro_bias.is_finite()
            && self.accel_bias.is_finite()
            && (0..N).all(|axis| self.covariance[(axis, axis)] > 0.0)
    }

    /// Goes on at the time of a sample as if nothing had moved in between.
    pub(super) fn skip_to(&mut self, imu: &ImuSample) {
        (self.time, self.imu) = (imu.time, self.unbiased(imu));
        self.nominal.velocity = DVec3::ZERO;
    }

    /// Lets the velocity die away, as while nothing has been seen for long.
    pub(super) fn brake(&mut self, share: f64) {
        self.nominal.velocity *= 1.0 - share;
    }
}

/// The matrix of the cross product with `v`.
fn cross(v: DVec3) -> DMat3 {
    DMat3::from_cols_array_2d(&[[0.0, v.z, -v.y], [-v.z, 0.0, v.x], [v.y, -v.x, 0.0]])
}
