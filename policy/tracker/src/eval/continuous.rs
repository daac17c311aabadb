//! A tracker that is never reset: clips joined into one long input, hands coming and going.
//!
//! A second tracker gets the same input and is reset wherever a clip begins. What the first does
//! worse is what its long memory costs.

use glam::{Quat, Vec3};
use posed_body::{
    BodyPose, JOINTS, Joint, Joints,
    motion::{Clip, Trajectory},
};
use posed_signal::{HostTime, Lookup, Pose, PoseHow, Role};

use super::{Options, START, Shown};
use crate::{
    geometry::yaw_of,
    tracker::{Input, NO_INERTIAL, Tracker},
};

/// Results are given for stretches of this length, seconds.
const STRETCH_S: f64 = 60.0;

/// What came of one minute.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stretch {
    /// Frames of it.
    pub frames: usize,
    /// Clips that began in it.
    pub clips: usize,
    /// Share of frames in which the left and the right hand were shown.
    pub hands_seen: [f64; 2],
    /// Head-aligned mean joint error of the tracker that is never reset, centimetres.
    pub through_cm: f64,
    /// The same of the one that is reset at every clip.
    pub fresh_cm: f64,
    /// Poses that were not sound.
    pub unsound: usize,
}

impl Stretch {
    fn add(&mut self, seen: [bool; 2], errors: [Option<f64>; 2]) {
        self.frames += 1;
        for (sum, seen) in self.hands_seen.iter_mut().zip(seen) {
            *sum += f64::from(u8::from(seen));
        }
        for (sum, error) in [&mut self.through_cm, &mut self.fresh_cm]
            .into_iter()
            .zip(errors)
        {
            match error {
                Some(error) => *sum += 100.0 * error,
                None => self.unsound += 1,
            }
        }
    }

    /// Sums to means.
    fn finish(mut self) -> Self {
        let count = self.frames.max(1) as f64;
        self.hands_seen = self.hands_seen.map(|sum| sum / count);
        self.through_cm /= count;
        self.fresh_cm /= count;
        self
    }
}

/// How the error of a long input changes with time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Trend {
    /// Mean over the first minutes: never reset, reset at every clip; centimetres.
    pub first_cm: [f64; 2],
    /// Mean over as many minutes at the end.
    pub last_cm: [f64; 2],
    /// Least-squares slope of what the memory costs, first less second, over time: centimetres a
    /// minute. The motions' own difficulty, which both meet, is not in it.
    pub slope_cm_per_min: f64,
}

impl Trend {
    /// Over consecutive minutes; the first and last `ends` of them are compared. A minute that was
    /// cut short counts by its frames.
    #[must_use]
    pub fn of(stretches: &[Stretch], ends: usize) -> Self {
        let mean = |part: &[Stretch], value: fn(&Stretch) -> f64| {
            let frames: f64 = part.iter().map(|one| one.frames as f64).sum();
            let sum: f64 = part.iter().map(|one| one.frames as f64 * value(one)).sum();
            sum / frames.max(1.0)
        };
        let both = |part: &[Stretch]| {
            [
                mean(part, |one| one.through_cm),
                mean(part, |one| one.fresh_cm),
            ]
        };
        let cost = |one: &Stretch| one.through_cm - one.fresh_cm;
        let ends = ends.min(stretches.len());
        let frames: f64 = stretches.iter().map(|one| one.frames as f64).sum();
        let minutes = stretches.iter().enumerate().map(|(n, one)| (n as f64, one));
        let middle = minutes
            .clone()
            .map(|(n, one)| n * one.frames as f64)
            .sum::<f64>()
            / frames.max(1.0);
        let mean_cost = mean(stretches, cost);
        let (mut joint, mut own) = (0.0, 0.0);
        for (n, one) in minutes {
            let weight = one.frames as f64;
            joint += weight * (n - middle) * (cost(one) - mean_cost);
            own += weight * (n - middle) * (n - middle);
        }
        Self {
            first_cm: both(&stretches[..ends]),
            last_cm: both(&stretches[stretches.len() - ends..]),
            slope_cm_per_min: if own > 0.0 { joint / own } else { 0.0 },
        }
    }
}

/// Runs both trackers over `clips`, each set down where the one before ended and turned the same
/// way, for at most `seconds`; a result for every minute.
pub fn continuous(
    clips: impl Iterator<Item = Clip>,
    [through, fresh]: [&mut dyn Tracker; 2],
    options: &Options,
    seconds: f64,
) -> Vec<Stretch> {
    let total = (seconds * options.rate_hz) as usize;
    let in_stretch = (STRETCH_S * options.rate_hz) as usize;
    let mut stretches: Vec<Stretch> = Vec::new();
    let mut frame = 0usize;
    let mut ground = Ground::default();
    for clip in clips {
        if frame >= total {
            break;
        }
        let trajectory = Trajectory::new(&clip);
        let shown = Shown::new(&trajectory, &clip, options.sensors, options.straps);
        let wearer = options.bones.wearer(&clip);
        ground.begin(&trajectory.pose(0.0), &clip);
        fresh.reset();
        let frames = (trajectory.duration() * options.rate_hz) as usize;
        for own in 0..frames.min(total - frame) {
            let own_s = own as f64 / options.rate_hz;
            let now = START.plus_secs(frame as f64 / options.rate_hz);
            let (parts, seen) = parts(&shown, &ground, own_s, now);
            let input = Input {
                target: now,
                parts: &parts,
                inertial: &NO_INERTIAL,
                wearer: &wearer,
            };
            let truth = ground.pose(&trajectory.pose(own_s));
            let truth = clip.skeleton.forward(&truth);
            let error = |tracker: &mut dyn Tracker| {
                let pose = tracker.track(&input).pose;
                let sound = pose.is_sound();
                sound.then(|| apart(&wearer.skeleton.forward(&pose), &truth))
            };
            let errors = [error(&mut *through), error(&mut *fresh)];
            let index = frame / in_stretch.max(1);
            if stretches.len() <= index {
                stretches.push(Stretch::default());
            }
            stretches[index].add(seen, errors);
            stretches[index].clips += usize::from(own == 0);
            frame += 1;
            ground.last = Some(truth);
        }
    }
    stretches.into_iter().map(Stretch::finish).collect()
}

/// Mean distance of joints with the heads laid on each other, metres.
fn apart(found: &Joints, truth: &Joints) -> f64 {
    let from_head = |joints: &Joints, joint: Joint| {
        (joints.position(joint) - joints.position(Joint::Head)).as_dvec3()
    };
    let sum: f64 = Joint::ALL
        .into_iter()
        .map(|joint| from_head(found, joint).distance(from_head(truth, joint)))
        .sum();
    sum / JOINTS as f64
}

/// Where a clip is set down.
#[derive(Default)]
struct Ground {
    turn: Quat,
    shift: Vec3,
    /// Joints in the last frame of the clip before.
    last: Option<Joints>,
}

impl Ground {
    /// The head's place and heading go on.
    fn begin(&mut self, first: &BodyPose, clip: &Clip) {
        let joints = clip.skeleton.forward(first);
        let level = |joints: &Joints| joints.position(Joint::Head) * Vec3::new(1.0, 0.0, 1.0);
        let yaw = |joints: &Joints| yaw_of(joints.rotation(Joint::Head));
        let (place, heading) = match &self.last {
            Some(last) => (level(last), yaw(last)),
            None => (Vec3::ZERO, 0.0),
        };
        self.turn = Quat::from_rotation_y(heading - yaw(&joints));
        self.shift = place - self.turn * level(&joints);
    }

    fn pose(&self, pose: &BodyPose) -> BodyPose {
        let mut placed = *pose;
        placed.root = self.turn * pose.root + self.shift;
        placed.rotations[0] = (self.turn * pose.rotations[0]).normalize();
        placed
    }

    fn part(&self, part: &Pose) -> Pose {
        Pose {
            position: self.turn * part.position + self.shift,
            rotation: (self.turn * part.rotation).normalize(),
            velocity: self.turn * part.velocity,
            angular_velocity: self.turn * part.angular_velocity,
            ..*part
        }
    }
}

/// What the devices say, and which hands are there.
fn parts(
    shown: &Shown<'_>,
    ground: &Ground,
    seconds: f64,
    now: HostTime,
) -> ([Lookup<Pose>; Role::COUNT], [bool; 2]) {
    let mut parts = [Lookup::Empty; Role::COUNT];
    for role in Role::ALL {
        if let Some(pose) = shown.pose(role, seconds, now) {
            parts[role as usize] = Lookup::Exact(ground.part(&pose));
        }
    }
    let mut seen = [false; 2];
    for (side, role) in [Role::LeftHand, Role::RightHand].into_iter().enumerate() {
        if let Lookup::Exact(pose) = &mut parts[role as usize] {
            if is_lost(side, now.since_secs(START)) {
                pose.how = PoseHow::Lost;
            }
            seen[side] = pose.how != PoseHow::Lost;
        }
    }
    (parts, seen)
}

/// Hands go for a quarter of the time, for up to two seconds, on a schedule that does not repeat.
fn is_lost(side: usize, seconds: f64) -> bool {
    let side = side as f64;
    (0.9 * seconds + 2.0 * side).sin() + (2.3 * seconds - side).sin() > 0.85
}

#[cfg(test)]
mod tests {
    use posed_body::motion::procedural;

    use super::*;
    use crate::Ik;

    #[test]
    fn a_cost_that_grows_is_told_from_motions_that_get_harder() {
        let stretch = |minute: u8| {
            let minute = f64::from(minute);
            Stretch {
                frames: 3600,
                through_cm: 2.0 + 0.5 * minute + 0.02 * minute,
                fresh_cm: 2.0 + 0.5 * minute,
                ..Stretch::default()
            }
        };
        let ten: Vec<_> = (0..10).map(stretch).collect();
        let trend = Trend::of(&ten, 2);
        assert!((trend.slope_cm_per_min - 0.02).abs() < 1e-9, "{trend:?}");
        assert!((trend.first_cm[1] - 2.25).abs() < 1e-9, "{trend:?}");
        assert!((trend.last_cm[0] - (6.25 + 0.17)).abs() < 1e-9, "{trend:?}");
        assert_eq!(Trend::of(&ten[..1], 2).slope_cm_per_min, 0.0);
        assert_eq!(Trend::of(&[], 2), Trend::default());
    }

    #[test]
    fn a_reset_where_clips_begin_is_all_that_tells_the_two_apart() {
        let clip = procedural::timeline(1.75, 3);
        let mut trackers = [Ik::default(), Ik::default()];
        let [through, fresh] = &mut trackers;
        let clips = [clip.clone(), clip].into_iter();
        let found = continuous(clips, [through, fresh], &Options::default(), 70.0);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].frames, found[0].clips), (3600, 2));
        assert!(found.iter().all(|minute| minute.unsound == 0));
        let seen = found[0].hands_seen[0];
        assert!((0.6..0.9).contains(&seen), "{seen}");
        for minute in &found {
            let apart = (minute.through_cm - minute.fresh_cm).abs();
            assert!(apart < 0.5 && minute.through_cm < 25.0, "{minute:?}");
        }
    }
}
