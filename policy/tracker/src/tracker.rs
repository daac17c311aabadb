//! The interface of every tracker: what the devices say at a time, in; a body pose, out.

use glam::Vec3;
use posed_body::{
    BodyPose, JOINTS, Skeleton,
    optimiser::{FootForce, Solved},
};
use posed_signal::{HostTime, Lookup, Orientation, Pose, Role};

use crate::{
    objects::{ObjectMove, Objects},
    worn::Stance,
};

/// Which tracker made a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[repr(u8)]
pub enum TrackerKind {
    /// Inverse kinematics, without any learned model.
    #[default]
    Ik,
    /// HMD-NeMo (Aliakbarian et al. 2023).
    HmdNemo,
    /// PIP (Yi et al. 2022).
    Pip,
    /// QuestSim (Winkler et al. 2022).
    QuestSim,
}

impl TrackerKind {
    /// Every tracker.
    pub const ALL: [Self; 4] = [Self::Ik, Self::HmdNemo, Self::Pip, Self::QuestSim];

    /// The name on the command line, in configuration and in the API.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ik => "ik",
            Self::HmdNemo => "hmd_nemo",
            Self::Pip => "pip",
            Self::QuestSim => "questsim",
        }
    }

    /// The inverse of [`TrackerKind::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// How far a pose can be trusted, worst part first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[repr(u8)]
pub enum Quality {
    /// Nothing is heard: the last pose, held.
    #[default]
    Held,
    /// The headset's pose is old or carried on by its IMU, or most of PIP's six sensors are silent.
    Degraded,
    /// The headset is tracked, a hand is not; or one or two of PIP's six sensors are silent.
    Partial,
    /// Headset and both hands are tracked, or all of PIP's six sensors are heard.
    Full,
}

impl Quality {
    /// The word used in JSON output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::Degraded => "degraded",
            Self::Partial => "partial",
            Self::Full => "full",
        }
    }
}

/// The wearer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wearer {
    /// Stature, metres.
    pub height: f32,
    /// Bone offsets.
    pub skeleton: Skeleton,
}

impl Wearer {
    /// Average proportions at `height` metres.
    #[must_use]
    pub fn of_height(height: f32) -> Self {
        Self {
            height,
            skeleton: Skeleton::of_height(height),
        }
    }
}

/// What a tracker sees at one tick. Device poses are those of the body parts themselves: the
/// caller has taken the offset from headset to head joint and from controller to wrist out.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// The time that the body pose shall be valid for.
    pub target: HostTime,
    /// The pose of each role's body part at `target`, and how it was made; indexed by
    /// [`Role`] as a number.
    pub parts: &'a [Lookup<Pose>; Role::COUNT],
    /// The orientation at `target` of the bone that carries each role's inertial tracker, in
    /// posed's world, with the acceleration (without gravity) of the place where it sits; empty
    /// for roles without one, which includes a headset that has a pose. Indexed by [`Role`] as a
    /// number. [`Role::Waist`] is carried by the pelvis, [`Role::Chest`] by the upper chest,
    /// knees by the shanks, wrists by the forearms, elbows by the upper arms.
    pub inertial: &'a [Lookup<Orientation>; Role::COUNT],
    /// The wearer.
    pub wearer: &'a Wearer,
}

impl Input<'_> {
    /// The pose of a role's body part at the target time.
    #[must_use]
    pub fn part(&self, role: Role) -> Lookup<Pose> {
        self.parts[role as usize]
    }

    /// What a role's inertial tracker says of the bone that carries it, at the target time.
    #[must_use]
    pub fn inertial(&self, role: Role) -> Lookup<Orientation> {
        self.inertial[role as usize]
    }
}

/// [`Input::inertial`] of a wearer without inertial trackers.
pub const NO_INERTIAL: [Lookup<Orientation>; Role::COUNT] = [Lookup::Empty; Role::COUNT];

/// What moves the body and what carries it, of a tracker that solves for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces {
    /// Joint torques, N m, each on the child link in its joint's own frame; that of the pelvis is
    /// the residual moment, which a real body would not need.
    pub torques: [Vec3; JOINTS],
    /// What the ground does to the left and to the right foot.
    pub feet: [FootForce; 2],
    /// Force of the ground on the whole body, N, in the world.
    pub ground: Vec3,
}

impl Forces {
    /// Those of a solved tick.
    #[must_use]
    pub fn of(solved: &Solved) -> Self {
        Self {
            torques: solved.torques,
            feet: solved.feet,
            ground: solved.ground_force,
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let foot = |foot: &FootForce| {
            foot.force.is_finite() && foot.centre.is_finite() && foot.contact.is_finite()
        };
        self.torques.iter().all(|torque| torque.is_finite())
            && self.feet.iter().all(foot)
            && self.ground.is_finite()
    }
}

/// A tracker's answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked {
    /// The body pose at the target time; sound even when nothing is tracked.
    pub pose: BodyPose,
    /// How far to trust it.
    pub quality: Quality,
    /// The tracker that made it: a fallback's own name if one stood in.
    pub kind: TrackerKind,
    /// Torques and ground forces, of a tracker with physics.
    pub forces: Option<Forces>,
}

/// How often a simulated body had to be put back on its feet, and why; counts only grow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recoveries {
    /// It lay on the ground.
    pub falls: u64,
    /// It had lost the headset.
    pub drifts: u64,
    /// Its numbers were none, or the policy had no answer.
    pub faults: u64,
}

impl Recoveries {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.falls + self.drifts + self.faults
    }
}

/// A tracker: a state machine over ticks. It cannot fail; it degrades and says so. `track`
/// neither allocates, waits nor logs.
pub trait Tracker: Send {
    /// Which one this is.
    fn kind(&self) -> TrackerKind;

    /// Forgets the past: the next tick starts from what the devices then say.
    fn reset(&mut self);

    /// The wearer has held `stance` until this tick, and inertial trackers were calibrated from it:
    /// what they say from now on may differ from what they said before.
    fn calibrate(&mut self, _stance: Stance) {}

    /// Tells the pose that the wearer is in at the next tick, from calibration: a tracker that
    /// remembers (PIP) begins its memory with it. Others need not listen.
    fn begin(&mut self, _pose: &BodyPose) {}

    /// Times beyond the target, ns and ascending, that the tracker wants the body parts of where
    /// they are measured already: where the answer lags behind the devices.
    fn foresight(&self) -> &'static [i64] {
        &[]
    }

    /// The body parts at `at`, the `index`th of [`Tracker::foresight`] after the next target; told
    /// before each tick.
    fn foresee(&mut self, _index: usize, _at: HostTime, _parts: &[Lookup<Pose>; Role::COUNT]) {}

    /// How often a simulated body had to be put back on its feet since the start; `None` where
    /// nothing is simulated.
    fn recoveries(&self) -> Option<Recoveries> {
        None
    }

    /// Where the things in its scene were at the last tick; none where nothing is simulated.
    fn objects(&self) -> Objects {
        Objects::NONE
    }

    /// Puts a thing in its scene somewhere else. A reset puts all of them back.
    fn move_object(&mut self, _to: &ObjectMove) {}

    /// The body pose at `input.target`. Target times never decrease between resets.
    fn track(&mut self, input: &Input<'_>) -> Tracked;

    /// Probabilities that the left and the right foot stand in the pose given last, by a tracker
    /// that estimates them.
    fn contacts(&self) -> Option<[f32; 2]> {
        None
    }
}
