//! Evaluation: a recorded motion becomes what its wearer's devices would have said, goes through
//! histories, mounts and ticks as live, and the tracker's answer is measured against the truth.
//!
//! [`evaluate`] is a pure function of a clip, a fresh tracker and the options, so that clips can
//! run on any number of threads; [`Report::of`] joins the results in the order of the clips.

mod class;
mod continuous;
mod gait;
mod inertial;
mod report;
mod sensors;

use posed_body::{
    BodyPose, Joint,
    motion::{Clip, Trajectory},
};
use posed_signal::{History, HostTime, Lookup, Orientation, Pose, PoseHow, Role, time::SECOND_NS};

use crate::{
    metrics::{Metric, Scores, Track, point_masses},
    sensors::Mounts,
    tracker::{Input, Quality, Tracker, Wearer},
};

pub use class::motion_class;
pub use continuous::{Stretch, Trend, continuous};
pub use gait::gait;
pub use inertial::Straps;
pub use report::{Report, Row};
pub use sensors::{Frustum, Sensors, Shown};

/// Device poses remembered in an evaluation.
const HISTORY: usize = 64;
/// Host time of a clip's first frame: away from zero, so that times before it exist.
const START: HostTime = HostTime(10 * SECOND_NS);

/// Whose bones the tracker is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Bones {
    /// The mover's own, as a calibrated wearer's would be.
    #[default]
    Clip,
    /// Average proportions at the mover's stature: a wearer who only typed in a height.
    Height,
}

impl Bones {
    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Clip => "clip",
            Self::Height => "height",
        }
    }

    /// The inverse of [`Bones::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Clip, Self::Height]
            .into_iter()
            .find(|bones| bones.name() == name)
    }

    /// The wearer that the tracker is told for this clip.
    #[must_use]
    pub fn wearer(self, clip: &Clip) -> Wearer {
        let height = clip.skeleton.stature();
        match self {
            Self::Clip => Wearer {
                height,
                skeleton: clip.skeleton,
            },
            Self::Height => Wearer::of_height(height),
        }
    }
}

/// What is simulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The devices.
    pub sensors: Sensors,
    /// How inertial sensors sit, if they are worn.
    pub straps: Straps,
    /// The bones that the tracker is told.
    pub bones: Bones,
    /// Ticks a second; devices report at the same rate. Metrics that count frames mean 60.
    pub rate_hz: f64,
    /// Ticks that the tracker's answer lags the newest sample.
    pub lookahead: u32,
    /// What tells a clip's kind of motion.
    pub kinds: Kinds,
    /// Keep both motions in the result.
    pub dump: bool,
}

/// What tells a clip's kind of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Kinds {
    /// Its name: [`motion_class`].
    #[default]
    Name,
    /// How the mover moves: [`gait()`].
    Gait,
}

impl Kinds {
    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::Gait => "gait",
        }
    }

    /// The inverse of [`Kinds::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Name, Self::Gait]
            .into_iter()
            .find(|kinds| kinds.name() == name)
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            sensors: Sensors::HmdControllers,
            straps: Straps::Exact,
            bones: Bones::Clip,
            rate_hz: 60.0,
            lookahead: 0,
            kinds: Kinds::Name,
            dump: false,
        }
    }
}

/// Both motions of a clip, frame by frame, without the first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Dump {
    /// What the tracker said.
    pub predicted: Track,
    /// Pelvis positions are in the tracks; these are the poses themselves.
    pub predicted_poses: Vec<BodyPose>,
    /// What the wearer did.
    pub truth: Track,
    /// The same as poses.
    pub true_poses: Vec<BodyPose>,
    /// Probabilities that the left and the right foot stand, where the tracker says them.
    pub contacts: Vec<Option<[f32; 2]>>,
}

/// What came of one clip.
#[derive(Debug, Clone, PartialEq)]
pub struct ClipResult {
    /// The clip's name.
    pub name: String,
    /// Its kind of motion.
    pub class: String,
    /// Frames measured.
    pub frames: usize,
    /// Seconds measured.
    pub seconds: f64,
    /// The metrics.
    pub scores: Scores,
    /// Share of frames in which the left and right hand were shown.
    pub hands_seen: [f64; 2],
    /// Share of frames whose pose the tracker called full or partial.
    pub sure: f64,
    /// Share of frames that the tracker made itself, without a stand-in.
    pub own: f64,
    /// How often a simulated body had to be put back on its feet.
    pub recoveries: u64,
    /// Seconds until it first had to be; the whole clip where it never had.
    pub held_s: f64,
    /// Both motions, if they were asked for.
    pub dump: Option<Dump>,
}

/// Runs `tracker`, which must be fresh or reset, over a clip.
#[must_use]
pub fn evaluate(clip: &Clip, tracker: &mut dyn Tracker, options: &Options) -> ClipResult {
    let trajectory = Trajectory::new(clip);
    let wearer = options.bones.wearer(clip);
    let mut stage = Stage::new(&trajectory, &wearer, clip, options);
    // PIP is evaluated with its first pose known, as its authors do: a wearer has calibrated.
    tracker.begin(&trajectory.pose(0.0));
    let frames = (trajectory.duration() * options.rate_hz + 1e-6) as usize + 1;
    let mut predicted = Vec::with_capacity(frames);
    let mut contacts = Vec::with_capacity(frames);
    let (mut sure, mut own, mut held_s) = (0usize, 0usize, 0.0);
    for frame in 0..frames {
        stage.push_until(frame + options.lookahead as usize);
        let target = stage.time(frame);
        for (index, &by_ns) in tracker.foresight().iter().enumerate() {
            let at = target.plus_ns(by_ns);
            tracker.foresee(index, at, &stage.parts(at));
        }
        let input = Input {
            target,
            parts: &stage.parts(target),
            inertial: &stage.inertial(target),
            wearer: &wearer,
        };
        let tracked = tracker.track(&input);
        if recoveries(tracker) == 0 {
            held_s = (frame + 1) as f64 / options.rate_hz;
        }
        sure += usize::from(tracked.quality >= Quality::Partial);
        own += usize::from(tracked.kind == tracker.kind());
        predicted.push(tracked.pose);
        contacts.push(tracker.contacts());
    }
    let hands_seen = stage.hands_seen();
    let at = |frame: usize| trajectory.pose(frame as f64 / options.rate_hz);
    let true_poses: Vec<BodyPose> = (0..frames).map(at).collect();
    let first = 1.min(frames - 1);
    let (predicted, true_poses) = (&predicted[first..], &true_poses[first..]);
    let tracks = [
        Track::new(options.rate_hz, &wearer.skeleton, predicted),
        Track::new(options.rate_hz, &clip.skeleton, true_poses),
    ];
    let scores = Scores::measure(&tracks[0], &tracks[1], &point_masses(&clip.skeleton));
    let [predicted_track, truth] = tracks;
    ClipResult {
        name: clip.name.clone(),
        class: match options.kinds {
            Kinds::Name => motion_class(&clip.name),
            Kinds::Gait => gait(clip).to_owned(),
        },
        frames: predicted.len(),
        seconds: predicted.len() as f64 / options.rate_hz,
        scores,
        hands_seen,
        sure: sure as f64 / frames as f64,
        own: own as f64 / frames as f64,
        recoveries: recoveries(tracker),
        held_s,
        dump: options.dump.then(|| Dump {
            predicted: predicted_track,
            predicted_poses: predicted.to_vec(),
            truth,
            true_poses: true_poses.to_vec(),
            contacts: contacts.split_off(first),
        }),
    }
}

fn recoveries(tracker: &dyn Tracker) -> u64 {
    tracker.recoveries().map_or(0, |counts| counts.total())
}

/// The devices of one clip and what the tracker side has heard from them.
struct Stage<'a> {
    shown: Shown<'a>,
    mounts: Mounts,
    histories: [History<Pose, HISTORY>; Role::COUNT],
    orientations: [History<Orientation, HISTORY>; Role::COUNT],
    rate_hz: f64,
    /// Frames that the devices have reported.
    pushed: usize,
    seen: [usize; 2],
}

impl<'a> Stage<'a> {
    fn new(trajectory: &'a Trajectory, wearer: &Wearer, clip: &Clip, options: &Options) -> Self {
        Self {
            shown: Shown::new(trajectory, clip, options.sensors, options.straps),
            mounts: Mounts::index(wearer),
            histories: std::array::from_fn(|_| History::default()),
            orientations: std::array::from_fn(|_| History::default()),
            rate_hz: options.rate_hz,
            pushed: 0,
            seen: [0; 2],
        }
    }

    fn time(&self, frame: usize) -> HostTime {
        START.plus_secs(frame as f64 / self.rate_hz)
    }

    /// Lets the devices report up to `frame`.
    fn push_until(&mut self, frame: usize) {
        while self.pushed <= frame {
            let (at, seconds) = (self.time(self.pushed), self.pushed as f64 / self.rate_hz);
            if seconds > self.shown.duration() + 1e-6 {
                break;
            }
            for role in Role::ALL {
                if let Some(orientation) = self.shown.orientation(role, seconds, at) {
                    self.orientations[role as usize].push(orientation);
                }
                let Some(part) = self.shown.pose(role, seconds, at) else {
                    continue;
                };
                let device = self.mounts.get(role).device_pose(&part);
                self.histories[role as usize].push(device);
                self.count_hand(role, &part);
            }
            self.pushed += 1;
        }
    }

    fn count_hand(&mut self, role: Role, part: &Pose) {
        let seen = usize::from(part.how != PoseHow::Lost);
        match role {
            Role::LeftHand => self.seen[0] += seen,
            Role::RightHand => self.seen[1] += seen,
            _ => {}
        }
    }

    fn hands_seen(&self) -> [f64; 2] {
        self.seen
            .map(|seen| seen as f64 / self.pushed.max(1) as f64)
    }

    fn parts(&self, target: HostTime) -> [Lookup<Pose>; Role::COUNT] {
        Role::ALL.map(|role| {
            self.mounts
                .part(role, self.histories[role as usize].at(target))
        })
    }

    fn inertial(&self, target: HostTime) -> [Lookup<Orientation>; Role::COUNT] {
        Role::ALL.map(|role| self.orientations[role as usize].at(target))
    }
}

/// Errors over time for a plot: centimetres, head-aligned, one a frame.
#[must_use]
pub fn error_curve(dump: &Dump) -> Vec<f64> {
    let frames = dump.predicted.len().min(dump.truth.len());
    let one = |frame: usize| {
        let slice = |track: &Track| Track {
            fps: track.fps,
            positions: vec![track.positions[frame]],
            local: vec![track.local[frame]],
            world: vec![track.world[frame]],
        };
        let scores = Scores::measure(&slice(&dump.predicted), &slice(&dump.truth), &[]);
        scores.get(Metric::MpjpeHead).unwrap_or(0.0)
    };
    (0..frames).map(one).collect()
}

/// A toe joint slower than this stands, m/s.
const STANDS: f64 = 0.2;

/// Which feet stand in each frame, left and right: for a plot of contacts against the truth's.
#[must_use]
pub fn contact_curve(track: &Track) -> Vec<[bool; 2]> {
    let toes = [Joint::LeftFoot, Joint::RightFoot];
    let stands = |frame: usize, toe: Joint| {
        let at = |frame: usize| track.positions[frame][toe as usize];
        let moved = f64::from(at(frame).distance(at(frame.saturating_sub(1))));
        moved * track.fps < STANDS
    };
    (0..track.len())
        .map(|frame| toes.map(|toe| stands(frame, toe)))
        .collect()
}

#[cfg(test)]
mod tests;
