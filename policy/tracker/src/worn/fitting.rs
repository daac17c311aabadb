//! The state machine of calibration and headings, one tick at a time.

use glam::Quat;
use posed_signal::{HostTime, Lookup, Orientation, Pose, PoseHow, Role};

use super::{
    fit::{Fit, Stance, Stances},
    heading::HeadingWatch,
};
use crate::{
    geometry::{yaw_confidence, yaw_of},
    tracker::NO_INERTIAL,
};

/// A posture is held for this long, seconds.
const HOLD_S: f32 = 1.0;
/// Whoever moves a tracker faster than this does not hold still, rad/s.
const STILL_RAD_S: f32 = 0.35;
/// A posture that is not held within this time fails, seconds.
const PATIENCE_S: f32 = 15.0;
/// A heading can be told of a bone that leans less than about 35 degrees.
const LEVEL: f32 = 0.91;

/// Where a calibration is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Phase {
    /// None was asked for.
    #[default]
    Idle,
    /// The wearer is to hold the posture.
    Holding,
    /// The posture was taken.
    Done,
    /// The posture was not held still in time, or there is no tracker.
    Failed,
}

impl Phase {
    /// The word in JSON output and in the API.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Holding => "holding",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// What people are told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Report {
    /// Where the calibration is.
    pub phase: Phase,
    /// Its posture; `None` before the first.
    pub stance: Option<Stance>,
    /// Goes up with every posture that was asked for.
    pub number: u32,
    /// Trackers that are calibrated.
    pub calibrated: u8,
    /// How fast each role's heading wanders, degrees a minute, counter-clockwise from above.
    pub drift: [Option<f32>; Role::COUNT],
}

/// A posture that is being held.
#[derive(Debug, Clone, Copy)]
struct Hold {
    stance: Stance,
    still_s: f32,
    waited_s: f32,
    /// Nobody asked: it waits without end, and fits only what has no fit yet.
    unasked: bool,
    sums: [Option<Quat>; Role::COUNT],
}

impl Hold {
    fn new(stance: Stance, unasked: bool) -> Self {
        Self {
            stance,
            still_s: 0.0,
            waited_s: 0.0,
            unasked,
            sums: [None; Role::COUNT],
        }
    }

    fn start_over(&mut self) {
        (self.still_s, self.sums) = (0.0, [None; Role::COUNT]);
    }
}

/// Calibration and headings of every role.
#[derive(Debug, Clone)]
pub struct Fitting {
    postures: [Stances; Role::COUNT],
    fits: [Option<Fit>; Role::COUNT],
    watches: [HeadingWatch; Role::COUNT],
    hold: Option<Hold>,
    report: Report,
    last: Option<HostTime>,
}

impl Default for Fitting {
    /// Nothing is calibrated. Until somebody asks for a posture, the first second in which
    /// trackers hold still counts as a straight stance.
    fn default() -> Self {
        Self {
            postures: Default::default(),
            fits: [None; Role::COUNT],
            watches: Default::default(),
            hold: Some(Hold::new(Stance::Straight, true)),
            report: Report::default(),
            last: None,
        }
    }
}

impl Fitting {
    /// The wearer is about to hold a posture: it is taken as soon as all trackers hold still for a
    /// second.
    pub fn calibrate(&mut self, stance: Stance) {
        self.hold = Some(Hold::new(stance, false));
        self.report.phase = Phase::Holding;
        self.report.stance = Some(stance);
        self.report.number += 1;
    }

    /// What people are told.
    #[must_use]
    pub fn report(&self) -> Report {
        self.report
    }

    /// How a role's tracker sits, if it is calibrated.
    #[must_use]
    pub fn fit(&self, role: Role) -> Option<Fit> {
        self.fits[role as usize]
    }

    /// Takes what the trackers say at `now`, in their own frames and worlds, and the headset's
    /// part, if there is one. Answers with what the bones do; roles without a fit stay empty.
    pub fn tick(
        &mut self,
        now: HostTime,
        devices: &[Lookup<Orientation>; Role::COUNT],
        head: &Lookup<Pose>,
    ) -> [Lookup<Orientation>; Role::COUNT] {
        let dt = self
            .last
            .map_or(0.0, |last| now.since_secs(last).clamp(0.0, 1.0)) as f32;
        self.last = Some(now);
        let head_yaw = optical_yaw(head);
        self.hold_on(dt, devices, head_yaw);
        let mut bones = NO_INERTIAL;
        for role in Role::ALL {
            if let Some(fit) = self.fits[role as usize] {
                bones[role as usize] = devices[role as usize].map(|device| fit.bone(&device));
            }
        }
        self.watch(dt, &bones, head_yaw);
        bones
    }

    fn hold_on(
        &mut self,
        dt: f32,
        devices: &[Lookup<Orientation>; Role::COUNT],
        head_yaw: Option<f32>,
    ) {
        let Some(mut hold) = self.hold else { return };
        hold.waited_s += dt;
        let worn = |role: Role| devices[role as usize].fresh();
        let moving = |device: Orientation| device.angular_velocity.length() > STILL_RAD_S;
        let there = Role::ALL.into_iter().filter(|&role| worn(role).is_some());
        let same = there.clone().count() == hold.sums.iter().flatten().count();
        if there.clone().filter_map(worn).any(moving) || (hold.still_s > 0.0 && !same) {
            hold.start_over();
        } else if there.clone().next().is_some() {
            hold.still_s += dt.max(1e-6);
            for role in there {
                let Some(device) = worn(role) else { continue };
                let sum = &mut hold.sums[role as usize];
                let near = |sum: Quat| {
                    let same = sum.dot(device.rotation) >= 0.0;
                    sum + if same {
                        device.rotation
                    } else {
                        -device.rotation
                    }
                };
                *sum = Some(sum.map_or(device.rotation, near));
            }
        }
        let late = !hold.unasked && hold.waited_s > PATIENCE_S;
        let done = hold.still_s >= HOLD_S;
        self.hold = Some(hold);
        if done {
            self.finish(&hold, head_yaw.unwrap_or(0.0));
        } else if late {
            self.hold = Some(Hold::new(Stance::Straight, true));
            self.report.phase = Phase::Failed;
        }
    }

    fn finish(&mut self, hold: &Hold, facing: f32) {
        for role in Role::ALL {
            let index = role as usize;
            let Some(sum) = hold.sums[index] else {
                continue;
            };
            if hold.unasked && self.fits[index].is_some() {
                continue;
            }
            // What nobody asked for may not be what it was taken for: it is not remembered.
            let mut postures = if hold.unasked {
                Stances::default()
            } else {
                self.postures[index]
            };
            postures.set(hold.stance, sum.normalize());
            if !hold.unasked {
                self.postures[index] = postures;
            }
            if let Some(fit) = postures.fit(role, facing) {
                self.fits[index] = Some(fit);
                self.watches[index] = HeadingWatch::default();
            }
        }
        self.report.calibrated = self.fits.iter().flatten().count() as u8;
        if !hold.unasked {
            self.report.phase = Phase::Done;
        }
        // Trackers that are switched on later get their turn.
        self.hold = Some(Hold::new(Stance::Straight, true));
    }

    /// Compares every bone that stands upright with where the wearer faces: the headset where
    /// there is one, else the mean of the other bones, which tells drift but puts nothing right.
    fn watch(
        &mut self,
        dt: f32,
        bones: &[Lookup<Orientation>; Role::COUNT],
        head_yaw: Option<f32>,
    ) {
        let yaws = Role::ALL.map(|role| upright_yaw(role, bones[role as usize].fresh()?));
        for role in Role::ALL {
            let index = role as usize;
            let Some(fit) = &mut self.fits[index] else {
                continue;
            };
            let others = yaws.iter().enumerate().filter(|(other, _)| *other != index);
            let reference = head_yaw.or_else(|| circular_mean(others.filter_map(|(_, yaw)| *yaw)));
            let offset = yaws[index].zip(reference).map(|(yaw, other)| yaw - other);
            let correction = self.watches[index].update(dt, offset, head_yaw.is_some());
            fit.heading += correction;
            self.report.drift[index] = self.watches[index].drift();
        }
    }
}

/// Where the wearer faces, by the headset, while it looks level and sees its base stations.
fn optical_yaw(head: &Lookup<Pose>) -> Option<f32> {
    let pose = head.fresh().filter(|pose| pose.how == PoseHow::Optical)?;
    (yaw_confidence(pose.rotation) > LEVEL).then(|| yaw_of(pose.rotation))
}

/// The heading of a bone that stands as in the straight stance.
fn upright_yaw(role: Role, bone: Orientation) -> Option<f32> {
    let stance = Stance::Straight.bone(role)?;
    let turn = bone.rotation * stance.inverse();
    (yaw_confidence(turn) > LEVEL).then(|| yaw_of(turn))
}

fn circular_mean(yaws: impl Iterator<Item = f32>) -> Option<f32> {
    let sum = yaws.fold(glam::Vec2::ZERO, |sum, yaw| {
        sum + glam::Vec2::from_angle(yaw)
    });
    (sum.length() > 0.5).then(|| sum.y.atan2(sum.x))
}
