//! A device's pose and velocity from a short window of sweeps and inertial samples, without a
//! guess: robust least squares (Levenberg and Marquardt) from seeds that gravity and the bearings
//! of single sensors give.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use super::{
    base_station::BaseStation,
    model::{DeviceModel, GRAVITY},
    motion::{RelativeMotion, Step},
    room::Placed,
};

/// One sweep as a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sighting {
    /// Device time, s.
    pub(super) time: f64,
    /// Which base station's it is, as [`Source::index`](super::base_station::Source::index).
    pub(super) station: u8,
    /// Light plane, 0 or 1.
    pub(super) plane: u8,
    /// The sensor's hardware channel.
    pub(super) sensor: u8,
    /// Reading, rad.
    pub(super) angle: f64,
}

/// The station that a sighting is of, if it has a place.
pub(super) fn station_of<'a>(stations: &'a Placed, seen: &Sighting) -> Option<&'a BaseStation> {
    stations.get(usize::from(seen.station))?.as_ref()
}

/// A solved pose of the IMU's frame at the end of the window.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub(super) position: DVec3,
    pub(super) velocity: DVec3,
    pub(super) rotation: DQuat,
    /// Covariance of position, velocity and rotation (the last in the IMU's frame).
    pub(super) covariance: SMatrix<f64, 9, 9>,
    /// Root mean square of the residuals of those sightings that fit, rad.
    pub(super) rms: f64,
}

/// Fewest sightings that can be solved: nine unknowns, and some to spare for reflections.
const SIGHTINGS_MIN: usize = 14;
/// Fewest sensors that have to be among those that fit.
const SENSORS_MIN: u32 = 4;
/// Seeds that are refined with a subset of this many sightings.
const SUBSET: usize = 48;
/// Residuals beyond this weigh less and less (Cauchy), rad; it narrows while a seed comes nearer.
const SOFT: [f64; 3] = [2e-2, 7e-3, SOFT_LAST];
const SOFT_LAST: f64 = 2e-3;
/// Residuals beyond this do not fit, rad.
const FIT: f64 = 4e-3;
/// A solution is believed when so many of the sightings fit, and with this rms.
const FIT_SHARE: f64 = 0.65;
const RMS_MAX: f64 = 1.5e-3;
/// With this rms there is no need to look for anything better, rad.
const RMS_GOOD: f64 = 4e-4;
/// Seeds lean by this much where upright ones lead nowhere, rad.
const TILT: f64 = 0.7;
/// One sighting's standard deviation in the covariance: calibration errors repeat from sighting
/// to sighting, so that they do not average out.
const SIGMA: f64 = 1e-3;
/// Wearers move slower than this, one standard deviation, m/s.
const SPEED: f64 = 2.0;
/// How far the specific force may point away from up, by its own length's deviation from 1 g.
const UP_SIGMA: (f64, f64) = (0.05, 3.0);

/// What is solved: base stations, sensors, sweeps and the motion among them.
pub(super) struct Problem<'a> {
    pub(super) stations: &'a Placed,
    pub(super) model: &'a DeviceModel,
    sightings: Vec<(Sighting, Step)>,
    /// Mean specific force at the reference time's orientation, m/s^2.
    force: DVec3,
}

#[derive(Debug, Clone, Copy)]
struct Candidate {
    position: DVec3,
    velocity: DVec3,
    rotation: DQuat,
    cost: f64,
}

type Normal = (SMatrix<f64, 9, 9>, SVector<f64, 9>, f64);

impl<'a> Problem<'a> {
    /// `force`: the mean of the specific force over the window, turned to the end's orientation.
    pub(super) fn new(
        stations: &'a Placed,
        model: &'a DeviceModel,
        sightings: impl Iterator<Item = Sighting>,
        motion: &RelativeMotion,
        force: DVec3,
    ) -> Self {
        let sightings = sightings
            .filter(|seen| station_of(stations, seen).is_some())
            .filter_map(|seen| Some((seen, motion.at(seen.time)?)))
            .collect();
        Self {
            stations,
            model,
            sightings,
            force,
        }
    }

    /// Whether there is so much light that a device should be found.
    pub(super) fn is_enough(&self) -> bool {
        let sensors = self
            .sightings
            .iter()
            .fold(0u32, |set, (seen, _)| set | 1 << (seen.sensor & 31));
        self.sightings.len() >= 3 * SIGHTINGS_MIN && sensors.count_ones() >= 2 * SENSORS_MIN
    }

    /// Solves. A rotation that may be right can be offered, but need not be there. `None` where
    /// there is too little light, or nothing fits it.
    pub(super) fn solve(&self, guess: Option<DQuat>) -> Option<Solution> {
        if self.sightings.len() < SIGHTINGS_MIN {
            return None;
        }
        let bearings = self.bearings();
        let upright = upright(self.force);
        let turn = |n: u32, of: u32| DQuat::from_rotation_y(f64::from(n * 360 / of).to_radians());
        let level = (0..12).map(|n| turn(n, 12) * upright);
        let best = self.best(&bearings, guess.into_iter().chain(level), None);
        let found = best.and_then(|best| self.finish(&best));
        if found.as_ref().is_some_and(|found| found.rms < RMS_GOOD) {
            return found;
        }
        // A device that is swung does not tell what is up: try other tilts.
        let tilt = |n: u32| turn(n, 3) * DQuat::from_rotation_x(TILT) * upright;
        let tilted = (0..24).map(|n| turn(n % 8, 8) * tilt(n / 8));
        self.best(&bearings, tilted, best)
            .and_then(|best| self.finish(&best))
    }

    /// The best of what seeds lead to, and of `best`.
    fn best(
        &self,
        bearings: &[(DVec3, DVec3, DVec3)],
        seeds: impl Iterator<Item = DQuat>,
        mut best: Option<Candidate>,
    ) -> Option<Candidate> {
        let part = SUBSET as f64 / self.sightings.len() as f64;
        for rotation in seeds {
            let Some(position) = self.place(bearings, rotation) else {
                continue;
            };
            let (velocity, cost) = (DVec3::ZERO, f64::MAX);
            let seed = Candidate {
                position,
                velocity,
                rotation,
                cost,
            };
            let found = SOFT
                .iter()
                .fold(seed, |from, soft| self.refine(from, part, *soft, 6));
            if self.faces(&found) && best.is_none_or(|best| found.cost < best.cost) {
                best = Some(found);
            }
        }
        best
    }

    /// Directions in the world in which sensors were seen, from where.
    fn bearings(&self) -> Vec<(DVec3, DVec3, DVec3)> {
        let mut bearings = Vec::new();
        for (index, (first, step)) in self.sightings.iter().enumerate() {
            let partner = self.sightings[index + 1..].iter().find(|(other, _)| {
                (other.station, other.sensor) == (first.station, first.sensor)
                    && other.plane != first.plane
            });
            let Some((second, _)) = partner else { continue };
            let (Some(station), Some(sensor)) =
                (station_of(self.stations, first), self.sensor(first))
            else {
                continue;
            };
            let mut angles = [0.0; 2];
            angles[usize::from(first.plane & 1)] = first.angle;
            angles[usize::from(second.plane & 1)] = second.angle;
            let direction = station.rotation * station.bearing(angles);
            bearings.push((station.position, direction, step.turn * sensor));
        }
        bearings
    }

    fn sensor(&self, seen: &Sighting) -> Option<DVec3> {
        self.model
            .sensors
            .get(usize::from(seen.sensor))?
            .map(|sensor| sensor.position)
    }

    /// Where the device has to be, given its rotation, for its sensors to lie nearest to their
    /// bearings: linear least squares.
    fn place(&self, bearings: &[(DVec3, DVec3, DVec3)], rotation: DQuat) -> Option<DVec3> {
        let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for &(origin, direction, sensor) in bearings {
            let across = DMat3::IDENTITY
                - DMat3::from_cols(
                    direction * direction.x,
                    direction * direction.y,
                    direction * direction.z,
                );
            normal += across;
            right += across * (origin - rotation * sensor);
        }
        let usable = bearings.len() >= 3 && normal.determinant().abs() > 1e-9;
        usable
            .then(|| normal.inverse() * right)
            .filter(|position| position.length() < 50.0)
    }

    /// Whether most sensors that saw light look at the base station it came from.
    fn faces(&self, candidate: &Candidate) -> bool {
        let (mut facing, mut all) = (0, 0);
        for (seen, step) in &self.sightings {
            let (Some(station), Some(Some(sensor))) = (
                station_of(self.stations, seen),
                self.model.sensors.get(usize::from(seen.sensor)),
            ) else {
                continue;
            };
            let rotation = candidate.rotation * step.turn;
            let to_station = station.position - candidate.position;
            all += 1;
            facing += u32::from((rotation * sensor.normal).dot(to_station) > 0.0);
        }
        facing * 5 >= all * 4
    }

    /// Levenberg and Marquardt on a part of the sightings.
    fn refine(&self, start: Candidate, part: f64, soft: f64, rounds: usize) -> Candidate {
        let mut best = start;
        let (mut matrix, mut gradient, cost) = self.normal(&best, part, soft);
        best.cost = cost;
        let mut damping = 1e-3;
        for _ in 0..rounds {
            let mut damped = matrix;
            for axis in 0..9 {
                damped[(axis, axis)] *= 1.0 + damping;
            }
            let Some(change) = damped.cholesky().map(|factor| factor.solve(&gradient)) else {
                return best;
            };
            let mut next = moved(&best, &change);
            let (next_matrix, next_gradient, cost) = self.normal(&next, part, soft);
            if cost < best.cost {
                let done = best.cost - cost < 1e-7 * best.cost;
                next.cost = cost;
                (best, matrix, gradient) = (next, next_matrix, next_gradient);
                damping = (damping * 0.2f64).max(1e-9);
                if done {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        best
    }

    /// The normal equations at a candidate, and its cost. Everything is in units of [`SIGMA`].
    fn normal(&self, at: &Candidate, part: f64, soft: f64) -> Normal {
        let mut matrix = SMatrix::<f64, 9, 9>::zeros();
        let mut gradient = SVector::<f64, 9>::zeros();
        let mut cost = 0.0;
        for (index, entry) in self.sightings.iter().enumerate() {
            // Every so-manyth would fall into step with the sensors' order; the golden ratio's
            // multiples are spread evenly and never do.
            if part < 1.0 && (index as f64 * 0.618_033_988_749_895).fract() >= part {
                continue;
            }
            let Some((residual, row)) = self.residual(at, entry) else {
                continue;
            };
            let ratio = residual / soft;
            let weight = 1.0 / (1.0 + ratio * ratio) / (SIGMA * SIGMA);
            cost += (1.0 + ratio * ratio).ln() * soft * soft / (SIGMA * SIGMA);
            matrix.ger(weight, &row, &row, 1.0);
            gradient.axpy(weight * residual, &row, 1.0);
        }
        for axis in 0..3 {
            matrix[(3 + axis, 3 + axis)] += 1.0 / (SPEED * SPEED);
            gradient[3 + axis] -= at.velocity[axis] / (SPEED * SPEED);
        }
        cost += at.velocity.length_squared() / (SPEED * SPEED);
        cost += self.up(at, &mut matrix, &mut gradient);
        (matrix, gradient, cost)
    }

    /// The specific force points up, more or less.
    fn up(
        &self,
        at: &Candidate,
        matrix: &mut SMatrix<f64, 9, 9>,
        gradient: &mut SVector<f64, 9>,
    ) -> f64 {
        let Some(force) = self.force.try_normalize() else {
            return 0.0;
        };
        let deviation = (self.force.length() / GRAVITY - 1.0).abs();
        let weight = (UP_SIGMA.0 + UP_SIGMA.1 * deviation).powi(-2);
        let residual = DVec3::Y - at.rotation * force;
        for axis in 0..3 {
            let world = DVec3::AXES[axis];
            let turned = force.cross(at.rotation.conjugate() * world);
            let mut row = SVector::<f64, 9>::zeros();
            row.fixed_rows_mut::<3>(6)
                .copy_from_slice(&turned.to_array());
            matrix.ger(weight, &row, &row, 1.0);
            gradient.axpy(weight * residual[axis], &row, 1.0);
        }
        weight * residual.length_squared()
    }

    /// Measured less expected reading, and the expected reading's derivatives over position,
    /// velocity and rotation.
    fn residual(&self, at: &Candidate, entry: &(Sighting, Step)) -> Option<(f64, SVector<f64, 9>)> {
        let (seen, step) = entry;
        let station = station_of(self.stations, seen)?;
        let sensor = self.sensor(seen)?;
        let arm = step.shift + step.turn * sensor;
        let fall = DVec3::new(0.0, -0.5 * GRAVITY * step.tau * step.tau, 0.0);
        let point = at.position + at.velocity * step.tau + fall + at.rotation * arm;
        let plane = usize::from(seen.plane & 1);
        let (expected, local) = station.reading(plane, station.to_local(point));
        let by_point = station.rotation * local;
        let by_rotation = arm.cross(at.rotation.conjugate() * by_point);
        let by_velocity = by_point * step.tau;
        let rows = [by_point, by_velocity, by_rotation];
        let row = SVector::from_iterator(rows.iter().flat_map(DVec3::to_array));
        Some((seen.angle - expected, row))
    }

    /// Whether the light is explained, and how well.
    fn finish(&self, near: &Candidate) -> Option<Solution> {
        let found = self.refine(*near, 1.0, SOFT_LAST, 20);
        let (mut squares, mut fitting, mut all, mut sensors) = (0.0, 0usize, 0usize, 0u32);
        for entry in &self.sightings {
            let Some((residual, _)) = self.residual(&found, entry) else {
                continue;
            };
            all += 1;
            if residual.abs() < FIT {
                squares += residual * residual;
                fitting += 1;
                sensors |= 1 << entry.0.sensor;
            }
        }
        let rms = (squares / fitting.max(1) as f64).sqrt();
        let enough = fitting >= SIGHTINGS_MIN && sensors.count_ones() >= SENSORS_MIN;
        let fits = fitting as f64 >= FIT_SHARE * all as f64 && rms < RMS_MAX;
        if !enough || !fits || !self.faces(&found) {
            return None;
        }
        let covariance = self.normal(&found, 1.0, SOFT_LAST).0.try_inverse()?;
        let Candidate {
            position,
            velocity,
            rotation,
            ..
        } = found;
        // Too few directions of light leave the depth open.
        let spread = covariance.diagonal().iter().take(3).sum::<f64>().sqrt();
        let sound = position.is_finite() && velocity.is_finite() && rotation.is_finite();
        (sound && spread < 0.1 && velocity.length() < 15.0).then_some(Solution {
            position,
            velocity,
            rotation,
            covariance,
            rms,
        })
    }
}

fn moved(from: &Candidate, change: &SVector<f64, 9>) -> Candidate {
    let part = |at: usize| DVec3::new(change[at], change[at + 1], change[at + 2]);
    Candidate {
        position: from.position + part(0),
        velocity: from.velocity + part(3),
        rotation: (from.rotation * DQuat::from_scaled_axis(part(6))).normalize(),
        cost: f64::MAX,
    }
}

/// A rotation that takes the specific force to straight up.
fn upright(force: DVec3) -> DQuat {
    let up = force.try_normalize().unwrap_or(DVec3::Y);
    DQuat::from_rotation_arc(up, DVec3::Y)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::lighthouse::{
        base_station::Source,
        motion::ImuSample,
        reproject::{PlaneCalibration, reproject},
    };

    /// A ball of sensors, all around.
    fn ball() -> DeviceModel {
        let points: Vec<[f64; 3]> = (0..24)
            .map(|n| {
                let (height, turn) = (f64::from(n) / 11.5 - 1.0, f64::from(n) * 2.4);
                let radius = (1.0 - height * height).sqrt();
                [radius * turn.cos(), height, radius * turn.sin()]
            })
            .collect();
        let scaled: Vec<_> = points.iter().map(|p| p.map(|x| x * 0.07)).collect();
        let text = serde_json::json!({"lighthouse_config": {
            "modelPoints": scaled, "modelNormals": points}});
        DeviceModel::from_json(&text.to_string()).unwrap()
    }

    fn stations() -> Placed {
        let station = |channel: u8, x: f64, z: f64| {
            let position = DVec3::new(x, 2.2, z);
            let away = (position - DVec3::Y).normalize();
            let right = DVec3::Y.cross(away).normalize();
            let turn = DMat3::from_cols(right, away.cross(right), away);
            let wobble = PlaneCalibration {
                curve: 0.1,
                gibmag: 0.005,
                ..Default::default()
            };
            BaseStation {
                source: Source::Channel(channel),
                id: 0,
                position,
                rotation: DQuat::from_mat3(&turn),
                calibration: [wobble; 2],
            }
        };
        let mut stations = [None; Source::COUNT];
        stations[0] = Some(station(1, 2.0, 2.0));
        stations[1] = Some(station(2, -2.0, -1.5));
        stations
    }

    struct Truth {
        position: DVec3,
        velocity: DVec3,
        rotation: DQuat,
        gyro: DVec3,
    }

    /// 60 ms of light and IMU of a ball that turns and flies, one sighting in ten a reflection.
    fn problem(truth: &Truth, model: &DeviceModel, stations: &Placed) -> Option<Solution> {
        let accel = |turn: DQuat| (truth.rotation * turn).conjugate() * (GRAVITY * DVec3::Y);
        let samples: Vec<_> = (-60..=0)
            .map(|ms| {
                let time = f64::from(ms) * 1e-3;
                let turn = DQuat::from_scaled_axis(truth.gyro * time);
                ImuSample {
                    time,
                    accel: accel(turn),
                    gyro: truth.gyro,
                    clipped: false,
                }
            })
            .collect();
        let motion = RelativeMotion::backwards(samples.iter(), -0.06);
        let mut sightings = Vec::new();
        for n in 0..240usize {
            let (station, plane, sensor) = (n % 2, n / 2 % 2, n / 4 % 24);
            let time = -0.06 + n as f64 * 0.25e-3;
            let turn = DQuat::from_scaled_axis(truth.gyro * time);
            let sensor_at = model.sensors[sensor].unwrap();
            let rotation = truth.rotation * turn;
            let point = truth.position + truth.velocity * time + rotation * sensor_at.position;
            let from = stations[station].unwrap();
            if (rotation * sensor_at.normal).dot(from.position - point) < 0.0 {
                continue;
            }
            let local = from.to_local(point);
            let clean = reproject(&from.calibration[plane], plane, local);
            // One in ten is a reflection, anywhere.
            let random = (n as u32).wrapping_mul(2_654_435_761) >> 8;
            let angle = if random % 10 == 7 {
                f64::from(random >> 4 & 0xff) * 2e-3
            } else {
                clean
            };
            let (station, plane, sensor) = (station as u8, plane as u8, sensor as u8);
            sightings.push(Sighting {
                time,
                station,
                plane,
                sensor,
                angle,
            });
        }
        let force = accel(DQuat::IDENTITY);
        Problem::new(stations, model, sightings.into_iter(), &motion, force).solve(None)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_pose_is_found_without_a_guess(
            x in -1.0f64..1.0, y in 0.3f64..1.8, z in -1.0f64..1.0,
            turn in prop::array::uniform3(-3.0f64..3.0),
            velocity in prop::array::uniform3(-2.0f64..2.0),
            gyro in prop::array::uniform3(-5.0f64..5.0),
        ) {
            let truth = Truth {
                position: DVec3::new(x, y, z),
                velocity: DVec3::from(velocity),
                rotation: DQuat::from_scaled_axis(DVec3::from(turn)),
                gyro: DVec3::from(gyro),
            };
            let found = problem(&truth, &ball(), &stations()).expect("a solution");
            prop_assert!((found.position - truth.position).length() < 5e-3);
            prop_assert!((found.velocity - truth.velocity).length() < 0.2);
            prop_assert!(found.rotation.angle_between(truth.rotation) < 1e-2);
            prop_assert!(found.rms < 1e-3);
        }
    }

    #[test]
    fn light_that_fits_nothing_gives_no_pose() {
        let model = ball();
        let stations = stations();
        let sample = ImuSample {
            time: 0.0,
            accel: DVec3::Y * GRAVITY,
            gyro: DVec3::ZERO,
            clipped: false,
        };
        let motion = RelativeMotion::backwards([sample].iter(), 0.0);
        let noise = (0..200u32).map(|n| Sighting {
            time: 0.0,
            station: (n % 2) as u8,
            plane: (n / 2 % 2) as u8,
            sensor: (n / 4 % 24) as u8,
            angle: f64::from(n.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5,
        });
        let problem = Problem::new(&stations, &model, noise, &motion, sample.accel);
        assert!(problem.solve(None).is_none());
        let none = Problem::new(&stations, &model, [].into_iter(), &motion, sample.accel);
        assert!(none.solve(None).is_none());
    }
}
