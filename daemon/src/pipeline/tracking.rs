//! The tracker loop: rings in, a published pose out, once a tick.
//!
//! After [`TrackerLoop::new`] nothing here waits, locks, logs or allocates. The loop does not know
//! who ticks it: a real-time thread, a replay that steps time, or a test.

use posed_signal::{
    Clock, DeviceId, History, HostTime, Lookup, Motion, Orientation, Pose, Role, Sample,
    device::DEVICES_MAX, latest::Reader, ring::Consumer,
};
use posed_tracker::{
    Forces, Input, ObjectMove, Objects, Tracked, Tracker, TrackerKind, Wearer,
    ik::Ik,
    sensors::{Mounts, rescale},
    tracker::NO_INERTIAL,
    worn::{self, Fitting, Stance},
};

use super::{latency::LatencyModel, stature::Stature};
use crate::{
    heights::{Avatar, Heights},
    published::PublishedPose,
};

/// Device poses remembered: at 500 Hz the last half second, the span after which one is stale.
const HISTORY: usize = 256;
/// Orientations remembered: at 200 Hz, twice what any inertial tracker sends, the same span.
const ORIENTATIONS: usize = 128;
/// Samples taken from one device at one tick: more than a ring holds.
const DRAIN_MAX: usize = 4096;
/// Requests taken at one tick.
const REQUESTS_MAX: usize = 16;

/// What each device stands for, by device id; told by the thread that owns the devices.
pub type RoleTable = [Role; DEVICES_MAX];

/// A request to the tracker, from a client or the command line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request {
    /// Forget the past and start from what the devices say now.
    Reset,
    /// The wearer's height, metres, and what becomes of the avatar's.
    Height {
        /// Metres.
        metres: f32,
        /// The avatar's height.
        avatar: Avatar,
    },
    /// Work with this tracker from now on.
    Tracker(TrackerKind),
    /// The wearer is about to hold this posture, from which inertial trackers are calibrated.
    Calibrate(Stance),
    /// Put a thing in the scene somewhere else.
    Move(ObjectMove),
}

/// Where samples come from and requests arrive.
#[derive(Debug)]
pub struct Inputs {
    /// One ring for each device id.
    pub rings: Vec<Consumer<Sample>>,
    /// Who plays which role.
    pub roles: Reader<RoleTable>,
    /// Requests.
    pub requests: Consumer<Request>,
}

/// What the loop starts with.
pub struct Setup {
    /// Trackers that can be chosen; `ik` is always there besides.
    pub trackers: Vec<Box<dyn Tracker>>,
    /// The one to begin with.
    pub choice: TrackerKind,
    /// How tall the wearer is, and the body shown.
    pub heights: Heights,
    /// Whether the wearer's first seconds upright tell the height.
    pub measure_height: bool,
    /// The body shown.
    pub wearer: Wearer,
    /// How far beyond the tick poses are made for, ns.
    pub horizon_ns: i64,
}

/// Counters that only grow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Ticks done.
    pub ticks: u64,
    /// Samples taken from the rings.
    pub samples: u64,
    /// Samples refused because they were not newer than the ones before.
    pub out_of_order: u64,
    /// Tracker answers that were not finite or not unit and were replaced by the fallback's.
    pub quarantined: u64,
}

/// The loop's state.
pub struct TrackerLoop {
    inputs: Inputs,
    histories: Vec<History<Pose, HISTORY>>,
    orientations: Vec<History<Orientation, ORIENTATIONS>>,
    roles: RoleTable,
    trackers: Vec<Box<dyn Tracker>>,
    fallback: Ik,
    choice: TrackerKind,
    heights: Heights,
    stature: Stature,
    /// The body shown.
    wearer: Wearer,
    mounts: Mounts,
    fitting: Fitting,
    latency: LatencyModel,
    last: Tracked,
    counters: Counters,
}

impl TrackerLoop {
    /// Allocates everything that the loop will ever need.
    #[must_use]
    pub fn new(inputs: Inputs, setup: Setup) -> Self {
        let hips = setup.wearer.skeleton.head_height() * 0.6;
        let pose = posed_body::BodyPose::rest(glam::Vec3::new(0.0, hips, 0.0));
        Self {
            inputs,
            histories: (0..DEVICES_MAX).map(|_| History::default()).collect(),
            orientations: (0..DEVICES_MAX).map(|_| History::default()).collect(),
            roles: [Role::None; DEVICES_MAX],
            trackers: setup.trackers,
            fallback: Ik::default(),
            choice: setup.choice,
            heights: setup.heights,
            stature: Stature::new(setup.measure_height),
            wearer: setup.wearer,
            mounts: setup.heights.mounts(&setup.wearer),
            fitting: Fitting::default(),
            latency: LatencyModel::new(setup.horizon_ns),
            last: Tracked {
                pose,
                quality: posed_tracker::Quality::Held,
                kind: TrackerKind::Ik,
                forces: None,
            },
            counters: Counters::default(),
        }
    }

    /// One tick: takes what arrived and answers with the body pose at the target time. `observe`
    /// is shown every sample on its way in.
    pub fn tick(
        &mut self,
        clock: &impl Clock,
        observe: &mut dyn FnMut(DeviceId, &Sample),
    ) -> PublishedPose {
        let now = clock.now();
        self.take_requests();
        self.drain(observe);
        let target = self.latency.target(now);
        self.measure(now);
        let parts = self.parts(target);
        let devices = self.inertial(target);
        let head = &parts[Role::Head as usize];
        let before = self.fitting.report();
        let inertial = self.fitting.tick(target, &devices, head);
        self.tell_calibration(&before);
        let tracked = self.track(target, &parts, &inertial);
        self.counters.ticks += 1;
        self.publication(clock, now, target, &parts, tracked)
    }

    /// What another loop needs to go on in this one's place, its past forgotten.
    #[must_use]
    pub fn into_setup(mut self) -> Setup {
        self.reset();
        Setup {
            trackers: self.trackers,
            choice: self.choice,
            heights: self.heights,
            measure_height: self.stature.is_wanted(),
            wearer: self.wearer,
            horizon_ns: self.latency.horizon_ns(),
        }
    }

    /// Counters so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The wearer as the loop now sees them.
    #[must_use]
    pub fn wearer(&self) -> &Wearer {
        &self.wearer
    }

    fn take_requests(&mut self) {
        for _ in 0..REQUESTS_MAX {
            match self.inputs.requests.pop() {
                None => break,
                Some(Request::Reset) => {
                    self.stature.reset();
                    self.reset();
                }
                Some(Request::Height { metres, avatar }) => {
                    self.stature.told();
                    self.wear(self.heights.told(metres, avatar));
                }
                Some(Request::Move(to)) => {
                    let trackers = self.trackers.iter_mut();
                    trackers.for_each(|tracker| tracker.move_object(&to));
                }
                Some(Request::Tracker(kind)) => {
                    self.choice = kind;
                    self.reset();
                }
                Some(Request::Calibrate(posture)) => self.fitting.calibrate(posture),
            }
        }
    }

    fn wear(&mut self, heights: Heights) {
        self.heights = heights;
        self.wearer = heights.body();
        self.mounts = heights.mounts(&self.wearer);
        self.reset();
    }

    /// Takes the wearer's height from the first seconds upright, if it is to be.
    fn measure(&mut self, now: HostTime) {
        let Some(index) = self.roles.iter().position(|&role| role == Role::Head) else {
            return;
        };
        let newest = self.histories[index].newest();
        let Some(measured) = self.stature.watch(now, newest.as_ref()) else {
            return;
        };
        self.wear(self.heights.told(measured, Avatar::Keep));
    }

    /// Tells trackers when a stance has been taken that was not `before`.
    fn tell_calibration(&mut self, before: &worn::Report) {
        let after = self.fitting.report();
        let taken = after.phase == worn::Phase::Done && before.phase == worn::Phase::Holding;
        if let Some(stance) = after.stance.filter(|_| taken) {
            self.fallback.calibrate(stance);
            for tracker in &mut self.trackers {
                tracker.calibrate(stance);
            }
        }
    }

    fn reset(&mut self) {
        self.fallback.reset();
        for tracker in &mut self.trackers {
            tracker.reset();
        }
    }

    fn drain(&mut self, observe: &mut dyn FnMut(DeviceId, &Sample)) {
        if let Some((_, roles)) = self.inputs.roles.get() {
            self.roles = roles;
        }
        let histories = self.histories.iter_mut().zip(&mut self.orientations);
        let devices = self.inputs.rings.iter_mut().zip(histories);
        for (index, (ring, (poses, orientations))) in devices.enumerate() {
            for _ in 0..DRAIN_MAX {
                let Some(sample) = ring.pop() else { break };
                self.counters.samples += 1;
                observe(DeviceId(index as u8), &sample);
                let in_order = match sample {
                    Sample::Pose(pose) => take(poses, pose),
                    Sample::Orientation(orientation) => take(orientations, orientation),
                    _ => true,
                };
                self.counters.out_of_order += u64::from(!in_order);
            }
        }
    }

    /// The body part that each role stands for, at `target`.
    fn parts(&self, target: HostTime) -> [Lookup<Pose>; Role::COUNT] {
        let mut parts = [Lookup::Empty; Role::COUNT];
        for (history, &role) in self.histories.iter().zip(&self.roles) {
            let slot = &mut parts[role as usize];
            if role != Role::None && matches!(slot, Lookup::Empty) {
                *slot = self.mounts.part(role, history.at(target));
            }
        }
        rescale(&mut parts, self.heights.scale());
        parts
    }

    /// What each role's inertial tracker says, in its own frame and world, at `target`.
    fn inertial(&self, target: HostTime) -> [Lookup<Orientation>; Role::COUNT] {
        let mut inertial = NO_INERTIAL;
        for (history, &role) in self.orientations.iter().zip(&self.roles) {
            let slot = &mut inertial[role as usize];
            if role != Role::None && matches!(slot, Lookup::Empty) {
                *slot = history.at(target);
            }
        }
        inertial
    }

    fn track(
        &mut self,
        target: HostTime,
        parts: &[Lookup<Pose>; Role::COUNT],
        inertial: &[Lookup<Orientation>; Role::COUNT],
    ) -> Tracked {
        let input = Input {
            target,
            parts,
            inertial,
            wearer: &self.wearer,
        };
        let chosen = self
            .trackers
            .iter()
            .position(|tracker| tracker.kind() == self.choice);
        if let Some(chosen) = chosen {
            let foresight = self.trackers[chosen].foresight();
            for (index, &by_ns) in foresight.iter().enumerate() {
                let at = target.plus_ns(by_ns);
                let parts = self.parts(at);
                self.trackers[chosen].foresee(index, at, &parts);
            }
        }
        let answer = match chosen {
            Some(index) => self.trackers[index].track(&input),
            None => self.fallback.track(&input),
        };
        if answer.pose.is_sound() {
            self.last = answer;
            return answer;
        }
        self.counters.quarantined += 1;
        let stand_in = self.fallback.track(&input);
        if stand_in.pose.is_sound() {
            self.last = stand_in;
        }
        self.last
    }

    fn publication(
        &mut self,
        clock: &impl Clock,
        now: HostTime,
        target: HostTime,
        parts: &[Lookup<Pose>; Role::COUNT],
        tracked: Tracked,
    ) -> PublishedPose {
        let head = self
            .histories
            .iter()
            .zip(&self.roles)
            .find(|(_, role)| **role == Role::Head);
        let newest = head.and_then(|(history, _)| history.newest());
        let sample_at = newest.map_or(HostTime(0), |pose| pose.at);
        if newest.is_some() {
            self.latency.observe(now, sample_at);
        }
        let mut trackers = self.trackers.iter();
        let chosen = trackers.find(|tracker| tracker.kind() == self.choice);
        PublishedPose {
            sequence: self.counters.ticks,
            sample_at,
            target_at: target,
            publish_at: clock.now(),
            quality: tracked.quality,
            kind: tracked.kind,
            pose: tracked.pose,
            forces: tracked.forces.filter(Forces::is_sound),
            joints: self.wearer.skeleton.forward(&tracked.pose),
            parts: *parts,
            worn: self.fitting.report(),
            objects: chosen.map_or(Objects::NONE, |tracker| tracker.objects()),
            recoveries: chosen.and_then(|tracker| tracker.recoveries()),
            measured_m: self.stature.measured(),
        }
    }
}

/// Puts a sample into its history. A stream whose time falls back far has started anew: its past
/// is of another clock.
fn take<T: Motion, const N: usize>(history: &mut History<T, N>, sample: T) -> bool {
    if history
        .newest()
        .is_some_and(|newest| newest.at().since_ns(sample.at()) > RESTART_NS)
    {
        history.clear();
    }
    history.push(sample)
}

/// A stream that falls back further than this has started anew.
const RESTART_NS: i64 = posed_signal::time::SECOND_NS as i64;
