//! One device's track: from inertial samples and sweeps to poses, through searching, tracking,
//! coasting and finding again.
//!
//! Light reaches the host some milliseconds after the inertial samples of the same time. The
//! filter therefore stands at the newest light; poses are foretold from there to the newest
//! inertial sample, which leaves nothing to wait for.

use std::{collections::VecDeque, sync::Arc};

use glam::{DQuat, DVec3};
use posed_signal::PoseHow;

use super::{
    base_station::Source,
    filter::{Filter, Nominal, Trial, Verdict},
    model::{DeviceModel, Frame, GRAVITY},
    motion::{ImuSample, RelativeMotion},
    room::{
        Placed,
        snapshot::{Glimpse, Snapshot},
    },
    solve::{Problem, Sighting},
};

/// Inertial samples kept: 256 ms of a headset's.
const SAMPLES_MAX: usize = 256;
/// Sightings kept for solving.
const SIGHTINGS_MAX: usize = 256;
/// Solutions look back over this time, s: three revolutions of a rotor.
const WINDOW: f64 = 0.06;
/// After a search without success, the next one waits this long, s.
const SEARCH_INTERVAL: f64 = 0.1;
/// Without any light, the filter stays this far behind the newest inertial sample, s; more where
/// light has been coming later than that, as it does where a host cannot keep up with its devices.
const HORIZON: f64 = 0.03;
const HORIZON_MAX: f64 = 0.13;
/// Light is taken to come this much later than it has come, s; what is known about that fades at
/// this rate, s/s.
const DELAY_MARGIN: f64 = 0.015;
const DELAY_FADES: f64 = 0.01;
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
/// Doubtful sweeps are tried again after so many others were taken, or after this long, s; no more
/// than so many wait.
const AGREED: u32 = 3;
const DOUBTFUL: f64 = 4e-3;
const DOUBTFUL_MAX: usize = 16;
/// Weight of a sweep in the running figures.
const RUNNING: f64 = 0.01;
/// A device is held still while it turns and is pushed by no more than this, rad/s and m/s^2, and
/// moves by no more than this, m/s; a tracked one moves calmly up to the second limits.
const STILL: (f64, f64) = (0.2, 0.4);
const CALM: (f64, f64) = (1.5, 3.0);
const SLOW: (f64, f64) = (0.3, 1.2);
/// Standard deviation of what a snapshot's accelerometer says of up: what factory calibrations leave
/// in captures, rad, and what is added for each rad/s and m/s at which a body moves, that then is
/// likely to be pushed as well.
const UP_SIGMA: (f64, f64, f64) = (0.004, 0.2, 0.3);
/// The filter's state stands for the moment of a snapshot up to this far from it, s.
const AHEAD: f64 = 2e-3;
/// After so long without being found in plenty of light, base stations are doubted, s; and one that
/// disagrees with the others for so long has moved, s.
const ASTRAY: f64 = 1.5;
const SUSPECT: f64 = 1.5;

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

impl Tracking {
    /// Gives a sweep to the filter, and keeps account of how well they fit.
    fn sweep(
        &mut self,
        stations: &Placed,
        model: &DeviceModel,
        seen: &Sighting,
        trial: Trial,
    ) -> Verdict {
        let verdict = self.filter.sweep(stations, model, seen, trial);
        match verdict {
            Verdict::Accepted(residual, weight) => {
                self.light = self.light.max(seen.time);
                self.square += RUNNING * weight * (residual * residual - self.square);
                self.fitting += RUNNING * (1.0 - self.fitting);
            }
            Verdict::Rejected => self.fitting -= RUNNING * self.fitting,
            Verdict::Doubtful | Verdict::Ignored => {}
        }
        verdict
    }
}

/// The track of one device.
pub(super) struct Track {
    model: Arc<DeviceModel>,
    stations: Placed,
    samples: VecDeque<ImuSample>,
    /// Sweeps of the last [`WINDOW`], for solving.
    sightings: VecDeque<Sighting>,
    /// Sweeps newer than every inertial sample.
    waiting: VecDeque<Sighting>,
    tracking: Option<Tracking>,
    /// Sweeps that did not fit well, and how many have been taken since they were last tried.
    doubtful: Vec<Sighting>,
    agreed: u32,
    /// No search before this time.
    search_after: f64,
    /// Since when searches fail though there is light of placed stations.
    astray: Option<f64>,
    /// A station that disagrees with the others, and since when.
    suspect: Option<(usize, f64)>,
    /// How much later than the inertial samples of its time light comes at worst, s.
    delay: f64,
}

impl Track {
    pub(super) fn new(model: DeviceModel, stations: Placed) -> Self {
        Self {
            model: Arc::new(model),
            stations,
            samples: VecDeque::with_capacity(SAMPLES_MAX),
            sightings: VecDeque::with_capacity(SIGHTINGS_MAX),
            waiting: VecDeque::with_capacity(SIGHTINGS_MAX),
            tracking: None,
            doubtful: Vec::with_capacity(DOUBTFUL_MAX),
            agreed: 0,
            search_after: f64::NEG_INFINITY,
            astray: None,
            suspect: None,
            delay: 0.0,
        }
    }

    /// How far behind the newest inertial sample light has to be waited for, s.
    fn horizon(&self) -> f64 {
        (self.delay + DELAY_MARGIN).clamp(HORIZON, HORIZON_MAX)
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

    /// Base stations have got, changed or lost their places.
    pub(super) fn set_stations(&mut self, stations: Placed) {
        self.stations = stations;
        self.suspect = None;
        if let Some(tracking) = &mut self.tracking {
            tracking.filter.loosen();
        }
    }

    /// The world was moved as a whole; `None`: it is another one.
    pub(super) fn carry(&mut self, by: Option<&Frame>) {
        match (by, &mut self.tracking) {
            (Some(by), Some(tracking)) => tracking.filter.carry(by),
            _ => {
                self.tracking = None;
                self.search_after = f64::NEG_INFINITY;
            }
        }
        self.astray = None;
    }

    /// How old light may be that an optical pose rests on, s.
    fn optical_for(&self) -> f64 {
        OPTICAL + self.horizon() - HORIZON
    }

    /// The IMU's frame in the world at the newest light, while the device is tracked.
    fn optical(&self) -> Option<(&Filter, f64)> {
        let tracking = self.tracking.as_ref()?;
        let newest = self.samples.back()?.time;
        let sound = newest - tracking.light < self.optical_for() && tracking.fitting > FITTING;
        sound.then_some((&tracking.filter, tracking.light))
    }

    /// Where the head frame is and how fast it turns (rad/s), while the device is tracked.
    pub(super) fn head_now(&self) -> Option<(Frame, f64)> {
        let (filter, _) = self.optical()?;
        let Nominal {
            position, rotation, ..
        } = filter.nominal;
        let head = Frame {
            position: position + rotation * self.model.head.position,
            rotation: rotation * self.model.head.rotation,
        };
        Some((head, filter.unbiased(self.samples.back()?).gyro.length()))
    }

    /// What the device sees, if it is tracked and moves calmly, or has been held still for a moment.
    pub(super) fn snapshot(&self) -> Option<Snapshot> {
        let newest = self
            .sightings
            .iter()
            .map(|seen| seen.time)
            .reduce(f64::max)?;
        let begin = newest - WINDOW;
        let first = self.samples.partition_point(|sample| sample.time < begin);
        let end = self.samples.partition_point(|sample| sample.time <= newest);
        let filter = self.optical().map(|(filter, _)| filter);
        let unbiased = |sample: &ImuSample| match filter {
            Some(filter) => filter.unbiased(sample),
            None => *sample,
        };
        let samples: Vec<ImuSample> = self
            .samples
            .range(first.min(end)..end)
            .map(unbiased)
            .collect();
        let last = samples.last()?;
        let within = |(turn, push): (f64, f64)| {
            let calm = |sample: &ImuSample| {
                !sample.clipped
                    && sample.gyro.length() < turn
                    && (sample.accel.length() - GRAVITY).abs() < push
            };
            samples.iter().all(calm)
        };
        let still = within(STILL);
        let allowed = still || (filter.is_some() && within(CALM));
        if last.time - samples[0].time < 0.7 * WINDOW || !allowed {
            return None;
        }
        let motion = RelativeMotion::backwards(samples.iter(), begin);
        let force = mean_force(&samples, &motion, begin);
        let (mut pose, mut drift, mut fall) = (None, DVec3::ZERO, -force);
        if let Some(filter) = filter {
            let ahead = last.time - filter.time;
            if ahead.abs() > AHEAD {
                return None;
            }
            let Nominal {
                position,
                velocity,
                rotation,
            } = filter.nominal;
            let back = rotation.conjugate();
            (drift, fall) = (back * velocity, back * filter.gravity());
            pose = Some(Frame {
                position: position + ahead * velocity,
                rotation,
            });
        }
        let slow = drift.length() < if still { SLOW.0 } else { SLOW.1 };
        if !slow {
            return None;
        }
        let glimpse = |seen: &Sighting| {
            let sensor = self
                .model
                .sensors
                .get(usize::from(seen.sensor))
                .copied()??;
            let step = motion.at(seen.time)?;
            let shift = step.shift + 0.5 * step.tau * step.tau * fall + step.tau * drift;
            Some(Glimpse {
                source: Source::from_index(usize::from(seen.station))?,
                plane: seen.plane,
                sensor: seen.sensor,
                angle: seen.angle,
                arm: shift + step.turn * sensor.position,
                tau: step.tau,
            })
        };
        let recent = self.sightings.iter().filter(|seen| seen.time >= begin);
        // The filter's bias would tell again what the room is level by now: it is left in.
        let up = force + filter.map_or(DVec3::ZERO, |filter| filter.accel_bias);
        let turning = samples
            .iter()
            .map(|sample| sample.gyro.length())
            .sum::<f64>();
        let turning = turning / samples.len() as f64;
        Some(Snapshot {
            model: Arc::clone(&self.model),
            up: up.try_normalize()?,
            up_sigma: UP_SIGMA.0 + UP_SIGMA.1 * turning + UP_SIGMA.2 * drift.length(),
            pose,
            glimpses: recent.filter_map(glimpse).collect(),
        })
    }

    /// Whether the device has not been found for long in the light of stations that have places.
    pub(super) fn is_astray(&self, now: f64) -> bool {
        self.astray.is_some_and(|since| now - since > ASTRAY)
    }

    /// A station that has kept disagreeing with the others.
    pub(super) fn take_suspect(&mut self) -> Option<Source> {
        let now = self.samples.back()?.time;
        let outlier = self.optical().and_then(|(filter, _)| filter.outlier());
        let (Some(outlier), Some((suspect, since))) = (outlier, self.suspect) else {
            self.suspect = outlier.map(|outlier| (outlier, now));
            return None;
        };
        if suspect != outlier {
            self.suspect = Some((outlier, now));
        } else if now - since > SUSPECT {
            self.suspect = None;
            return Source::from_index(outlier);
        }
        None
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
        self.doubtful.clear();
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
            self.delay = (self.delay - DELAY_FADES * step.abs()).max(0.0);
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
        let late = newest - seen.time;
        if late.abs() > HORIZON_MAX {
            return;
        }
        self.delay = self.delay.max(late);
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
            dark if dark <= self.optical_for() => PoseHow::Optical,
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
        match tracking.sweep(&self.stations, &self.model, seen, Trial::First) {
            Verdict::Accepted(..) => self.agreed += 1,
            Verdict::Doubtful if self.doubtful.len() < DOUBTFUL_MAX => self.doubtful.push(*seen),
            _ => {}
        }
        let oldest = self.doubtful.first().map_or(seen.time, |seen| seen.time);
        if self.agreed >= AGREED || seen.time - oldest > DOUBTFUL {
            self.agreed = 0;
            for seen in self.doubtful.drain(..) {
                tracking.sweep(&self.stations, &self.model, &seen, Trial::Second);
            }
        }
    }

    /// Moves the filter on where no light does.
    fn coast(&mut self, now: f64) {
        let horizon = self.horizon();
        let Some(tracking) = &mut self.tracking else {
            return;
        };
        let before = tracking.filter.time;
        advance(&mut tracking.filter, &self.samples, now - horizon);
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
        let horizon = self.horizon();
        while self
            .sightings
            .front()
            .is_some_and(|seen| seen.time < now - WINDOW - horizon)
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
        if self.solve(newest) {
            self.astray = None;
        }
    }

    fn solve(&mut self, newest: f64) -> bool {
        let end = self.samples.partition_point(|sample| sample.time <= newest);
        let Some(imu) = end
            .checked_sub(1)
            .and_then(|last| self.samples.get(last))
            .copied()
        else {
            return false;
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
            if problem.is_enough() {
                self.astray.get_or_insert(newest);
            }
            return false;
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
        true
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
