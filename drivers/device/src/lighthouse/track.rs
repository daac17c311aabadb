//! One device's track: from inertial samples and sweeps to poses, through searching, tracking,
//! coasting and finding again.
//!
//! Light reaches the host some milliseconds after the inertial samples of the same time. The
//! filter therefore stands at the newest light; poses are foretold from there to the newest
//! inertial sample, which leaves nothing to wait for.

use std::collections::VecDeque;

use glam::{DQuat, DVec3};
use posed_signal::PoseHow;

use super::{
    base_station::BaseStation,
    filter::{Filter, Nominal, Verdict},
    model::DeviceModel,
    motion::{ImuSample, RelativeMotion},
    solve::{Problem, Sighting},
};

/// Inertial samples kept: 128 ms of a headset's.
const SAMPLES_MAX: usize = 128;
/// Sightings kept for solving.
const SIGHTINGS_MAX: usize = 256;
/// Solutions look back over this time, s: three revolutions of a rotor.
const WINDOW: f64 = 0.06;
/// After a search without success, the next one waits this long, s.
const SEARCH_INTERVAL: f64 = 0.1;
/// Without any light, the filter stays this far behind the newest inertial sample, s.
const HORIZON: f64 = 0.03;
/// Light older than the filter by more than this is too late for it, s.
const LATE: f64 = 0.008;
/// A pose is an optical one while the light it rests on is no older than this, s.
const OPTICAL: f64 = 0.1;
/// After this long without light the filter is not trusted to take it up again by itself, s.
const BRIDGE: f64 = 0.3;
/// After this long without light the position is held, s.
const COAST: f64 = 0.5;
/// After this long without light the device is lost, s.
const LOST: f64 = 3.0;
/// A gap in the inertial samples over which the filter cannot be carried, s.
const IMU_GAP: f64 = 0.08;
/// Share of the sweeps that has to fit, over about the last hundred.
const FITTING: f64 = 0.35;
/// Weight of a sweep in the running figures.
const RUNNING: f64 = 0.01;

/// A pose of the head frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Output {
    pub(super) position: DVec3,
    pub(super) rotation: DQuat,
    pub(super) velocity: DVec3,
    pub(super) angular_velocity: DVec3,
    pub(super) residual: f64,
    pub(super) how: PoseHow,
}

struct Tracking {
    filter: Filter,
    /// Time of the newest accepted light.
    light: f64,
    /// Running weighted mean of squared residuals, rad^2, and share of sweeps accepted.
    square: f64,
    fitting: f64,
}

/// The track of one device.
pub(super) struct Track {
    model: DeviceModel,
    stations: Vec<BaseStation>,
    samples: VecDeque<ImuSample>,
    /// Sweeps of the last [`WINDOW`], for solving.
    sightings: VecDeque<Sighting>,
    /// Sweeps newer than every inertial sample.
    waiting: VecDeque<Sighting>,
    tracking: Option<Tracking>,
    /// No search before this time.
    search_after: f64,
}

impl Track {
    pub(super) fn new(model: DeviceModel, stations: Vec<BaseStation>) -> Self {
        Self {
            model,
            stations,
            samples: VecDeque::with_capacity(SAMPLES_MAX),
            sightings: VecDeque::with_capacity(SIGHTINGS_MAX),
            waiting: VecDeque::with_capacity(SIGHTINGS_MAX),
            tracking: None,
            search_after: f64::NEG_INFINITY,
        }
    }

    pub(super) fn model(&self) -> &DeviceModel {
        &self.model
    }

    /// A sample's rates in the head frame, as well as biases are known: gyroscope, accelerometer.
    pub(super) fn unbiased(&self, sample: &ImuSample) -> (DVec3, DVec3) {
        let sample = match &self.tracking {
            Some(tracking) => tracking.filter.unbiased(sample),
            None => *sample,
        };
        let turn = self.model.head.rotation.conjugate();
        (turn * sample.gyro, turn * sample.accel)
    }

    /// Forgets the device's whereabouts.
    pub(super) fn reset(&mut self) {
        self.clear();
        self.tracking = None;
    }

    /// Goes on after a gap, or a jump of the device's clock: what was learnt about biases stays,
    /// the pose is held until it is found again.
    fn skip_to(&mut self, sample: &ImuSample) {
        self.clear();
        if let Some(tracking) = &mut self.tracking {
            tracking.filter.skip_to(sample);
            tracking.light = sample.time - COAST;
        }
    }

    fn clear(&mut self) {
        self.samples.clear();
        self.sightings.clear();
        self.waiting.clear();
        self.search_after = f64::NEG_INFINITY;
    }

    /// Takes an inertial sample, in the order of time.
    pub(super) fn imu(&mut self, sample: ImuSample) {
        if let Some(last) = self.samples.back() {
            let step = sample.time - last.time;
            if step.abs() > IMU_GAP {
                self.skip_to(&sample);
            } else if step <= 0.0 {
                return;
            }
        }
        if self.samples.len() == SAMPLES_MAX {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        while let Some(seen) = self.waiting.front().copied() {
            if seen.time > sample.time {
                break;
            }
            self.waiting.pop_front();
            self.light(&seen);
        }
        self.coast(sample.time);
        self.search(sample.time);
    }

    /// Takes a sweep.
    pub(super) fn sighting(&mut self, seen: Sighting) {
        let newest = self
            .samples
            .back()
            .map_or(f64::NEG_INFINITY, |sample| sample.time);
        // Light from a future far off, or long past, is not this device's present.
        if (seen.time - newest).abs() > 2.0 * WINDOW {
            return;
        }
        if seen.time <= newest {
            self.light(&seen);
        } else if self.waiting.len() < SIGHTINGS_MAX {
            self.waiting.push_back(seen);
        }
    }

    /// The pose at the newest inertial sample; `None` before the device was found first.
    pub(super) fn output(&self) -> Option<Output> {
        let tracking = self.tracking.as_ref()?;
        let newest = self.samples.back()?;
        let filter = &tracking.filter;
        let mut nominal = filter.nominal;
        let mut held: Option<ImuSample> = None;
        let begin = self
            .samples
            .partition_point(|sample| sample.time < filter.time);
        let mut time = filter.time;
        for sample in self.samples.range(begin..) {
            let unbiased = filter.unbiased(sample);
            let before = held.replace(unbiased).unwrap_or(unbiased);
            let mean = before.mean(&unbiased);
            nominal.advance(sample.time - time, &mean, filter.gravity());
            time = sample.time;
        }
        let gyro = filter.unbiased(newest).gyro;
        let dark = newest.time - tracking.light;
        let how = match dark {
            dark if dark <= OPTICAL => PoseHow::Optical,
            dark if dark <= LOST => PoseHow::Inertial,
            _ => PoseHow::Lost,
        };
        if dark > COAST {
            nominal.velocity = DVec3::ZERO;
            nominal.position = filter.nominal.position;
        }
        Some(self.head(&nominal, gyro, tracking.square.sqrt(), how))
    }

    fn head(&self, nominal: &Nominal, gyro: DVec3, residual: f64, how: PoseHow) -> Output {
        let head = self.model.head;
        let Nominal {
            position,
            velocity,
            rotation,
        } = *nominal;
        Output {
            position: position + rotation * head.position,
            rotation: (rotation * head.rotation).normalize(),
            velocity: velocity + rotation * gyro.cross(head.position),
            angular_velocity: rotation * gyro,
            residual,
            how,
        }
    }

    fn light(&mut self, seen: &Sighting) {
        if self.sightings.len() == SIGHTINGS_MAX {
            self.sightings.pop_front();
        }
        self.sightings.push_back(*seen);
        let Some(tracking) = &mut self.tracking else {
            return;
        };
        if seen.time < tracking.filter.time - LATE {
            return;
        }
        if seen.time - tracking.light > BRIDGE {
            return;
        }
        advance(&mut tracking.filter, &self.samples, seen.time);
        match tracking.filter.sweep(&self.stations, &self.model, seen) {
            Verdict::Accepted(residual, weight) => {
                tracking.light = tracking.light.max(seen.time);
                tracking.square += RUNNING * weight * (residual * residual - tracking.square);
                tracking.fitting += RUNNING * (1.0 - tracking.fitting);
            }
            Verdict::Rejected => {
                tracking.fitting -= RUNNING * tracking.fitting;
            }
            Verdict::Ignored => {}
        }
    }

    /// Moves the filter on where no light does.
    fn coast(&mut self, now: f64) {
        let Some(tracking) = &mut self.tracking else {
            return;
        };
        let before = tracking.filter.time;
        advance(&mut tracking.filter, &self.samples, now - HORIZON);
        if now - tracking.light > COAST {
            let share = (10.0 * (tracking.filter.time - before)).clamp(0.0, 1.0);
            tracking.filter.brake(share);
        }
        if !tracking.filter.is_sound() {
            self.tracking = None;
        }
    }

    /// Solves for the pose where the filter has none, or has lost the light.
    fn search(&mut self, now: f64) {
        let trusted = self
            .tracking
            .as_ref()
            .is_some_and(|tracking| tracking.fitting > FITTING && now - tracking.light < BRIDGE);
        if trusted || now < self.search_after {
            return;
        }
        while self
            .sightings
            .front()
            .is_some_and(|seen| seen.time < now - WINDOW - HORIZON)
        {
            self.sightings.pop_front();
        }
        let Some(newest) = self.sightings.iter().map(|seen| seen.time).reduce(f64::max) else {
            return;
        };
        // The window ends with the newest light, and is full.
        let oldest = self
            .sightings
            .iter()
            .map(|seen| seen.time)
            .fold(newest, f64::min);
        if newest - oldest < 0.7 * WINDOW {
            return;
        }
        self.search_after = now + SEARCH_INTERVAL;
        self.solve(newest);
    }

    fn solve(&mut self, newest: f64) {
        let end = self.samples.partition_point(|sample| sample.time <= newest);
        let Some(imu) = end
            .checked_sub(1)
            .and_then(|last| self.samples.get(last))
            .copied()
        else {
            return;
        };
        let biases = self
            .tracking
            .as_ref()
            .map(|tracking| (tracking.filter.accel_bias, tracking.filter.gyro_bias))
            .unwrap_or_default();
        let unbiased: Vec<_> = self
            .samples
            .range(..end)
            .map(|sample| sample.less(biases.0, biases.1))
            .collect();
        let begin = imu.time - WINDOW;
        let motion = RelativeMotion::backwards(unbiased.iter(), begin);
        let seen = self
            .sightings
            .iter()
            .filter(|seen| seen.time >= begin)
            .copied();
        let force = mean_force(&unbiased, &motion, begin);
        let problem = Problem::new(&self.stations, &self.model, seen, &motion, force);
        let guess = self
            .tracking
            .as_ref()
            .map(|tracking| tracking.filter.nominal.rotation);
        let Some(solution) = problem.solve(guess) else {
            return;
        };
        let filter = match self.tracking.take() {
            Some(mut tracking) => {
                tracking.filter.restart(&solution, &imu);
                tracking.filter
            }
            None => Filter::new(&solution, &imu),
        };
        let square = solution.rms * solution.rms;
        self.tracking = Some(Tracking {
            filter,
            light: newest,
            square,
            fitting: 1.0,
        });
    }
}

/// Moves a filter on by the samples up to a time.
fn advance(filter: &mut Filter, samples: &VecDeque<ImuSample>, until: f64) {
    let begin = samples.partition_point(|sample| sample.time <= filter.time);
    for sample in samples.range(begin..) {
        if sample.time > until {
            break;
        }
        filter.propagate(sample);
    }
}

/// Mean specific force over a window, turned to the orientation at its end.
fn mean_force(samples: &[ImuSample], motion: &RelativeMotion, begin: f64) -> DVec3 {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for sample in samples.iter().filter(|sample| sample.time >= begin) {
        if let Some(step) = motion.at(sample.time) {
            sum += step.turn * sample.accel;
            count += 1.0;
        }
    }
    if count > 0.0 {
        sum / count
    } else {
        DVec3::ZERO
    }
}
