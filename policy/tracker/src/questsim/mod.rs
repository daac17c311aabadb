//! QuestSim (Winkler et al. 2022): a policy drives a simulated character by torques at its hinges,
//! from what the character feels and what headset and controllers say.
//!
//! The policy steps 36 times a second under any tick ([`world`]); the pose shown lies between two
//! of its steps. Frames of the user beyond the newest measured one are carried on ([`timeline`]).
//! A kinematic tracker runs beside it: it stands in while there is no head, and where the
//! character has fallen or drifted off it puts it back on its feet.

mod level;
mod observation;
mod policy;
mod recent;
mod timeline;
mod world;

use glam::Vec3;
use posed_body::{
    BodyPose, Joint,
    scene::{OBJECTS_MAX, Scene},
};
use posed_signal::{HostTime, Lookup, Pose, Role};

use crate::{
    fade::{Fade, Place, PoseFade},
    inference::{InferenceError, Runtime},
    objects::{ObjectMove, Objects},
    presence::Sensed,
    tracker::{Forces, Input, Quality, Recoveries, Tracked, Tracker, TrackerKind},
};
use observation::{FUTURE, PARTS, Part};
use policy::Policy;
use recent::Recent;
use timeline::{Moment, STEP_NS, Timeline};
use world::World;

/// A character whose head is farther from the headset's than this has drifted off, metres
/// (issue and paper name no number; the training ends episodes at 0.5 m).
const DRIFT: f64 = 0.3;
/// One whose pelvis is below this share of the stand-in's has fallen.
const FALLEN: f64 = 0.55;
/// From the pose before a respawn over to the one after it, seconds.
const RESPAWN_S: f32 = 0.2;
/// After a longer gap between ticks the character starts anew, ns.
const GAP_NS: i64 = 250_000_000;

/// The character starts when the stand-in has been there for so long, ns: how a body moves and where
/// its legs are does not show in a first tick.
const SETTLES_NS: i64 = 500_000_000;

/// Where the six frames after a tick lie.
const AHEAD_NS: [i64; FUTURE] = [
    STEP_NS,
    2 * STEP_NS,
    3 * STEP_NS,
    4 * STEP_NS,
    5 * STEP_NS,
    6 * STEP_NS,
];

/// How the tracker works.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Measured frames that the policy may use beyond the pose's time, 0 to 6; the others are
    /// predicted. They are measured only where the pose's time lags behind the devices.
    pub lookahead: usize,
    /// What the character stands on and bumps into.
    pub scene: Scene,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            lookahead: FUTURE,
            scene: Scene::default(),
        }
    }
}

/// The tracker.
pub struct QuestSim {
    policy: Policy,
    options: Options,
    stand_in: Box<dyn Tracker>,
    world: Option<World>,
    /// Time of the character's newest pose; `None` while it is not in play.
    at: Option<HostTime>,
    timeline: Timeline,
    /// Time of the last tick.
    ticked: Option<HostTime>,
    recent: Recent,
    shown: Option<BodyPose>,
    fade: PoseFade,
    /// The pelvis's place fades apart: a fallen body's head is not where the headset is.
    root_fade: Fade,
    fade_left: f32,
    steps: u64,
    recoveries: Recoveries,
    objects: Objects,
    /// What was moved before there was a world to move it in.
    moves: [Option<ObjectMove>; OBJECTS_MAX],
}

impl QuestSim {
    /// Loads the policy `bytes`; `name` is for errors. `stand_in` shows the wearer while the
    /// character cannot.
    ///
    /// # Errors
    /// The bytes are no model, or one with other inputs and outputs than this program's.
    pub fn load(
        runtime: &Runtime,
        name: &str,
        bytes: &[u8],
        stand_in: Box<dyn Tracker>,
        options: Options,
    ) -> Result<Self, InferenceError> {
        Ok(Self {
            policy: Policy::load(runtime, name, bytes)?,
            options,
            stand_in,
            world: None,
            at: None,
            timeline: Timeline::EMPTY,
            ticked: None,
            recent: Recent::EMPTY,
            shown: None,
            fade: PoseFade::DONE,
            root_fade: Fade::DONE,
            fade_left: 0.0,
            steps: 0,
            recoveries: Recoveries::default(),
            objects: Objects::NONE,
            moves: [None; OBJECTS_MAX],
        })
    }

    /// Policy steps since the start.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Torques and contact forces of the last policy step; `None` while the stand-in shows.
    #[must_use]
    pub fn forces(&self) -> Option<Forces> {
        self.at?;
        let forces = self.world.as_ref()?.forces();
        forces.is_sound().then_some(forces)
    }

    /// A world for these bones: the one there is, or a fresh one. Building one allocates, which
    /// happens at the first tick and when the wearer changes.
    fn prepare(&mut self, input: &Input<'_>) {
        let skeleton = &input.wearer.skeleton;
        if self
            .world
            .as_ref()
            .is_none_or(|world| world.skeleton != *skeleton)
        {
            self.world = World::new(skeleton, &self.options.scene).ok();
            self.at = None;
            if let Some(world) = &mut self.world {
                let moves = std::mem::take(&mut self.moves);
                moves.iter().flatten().for_each(|to| world.move_object(to));
            }
        }
    }

    /// Puts the character where the stand-in is.
    fn spawn(&mut self, now: HostTime, pose: &BodyPose) {
        let Some(world) = &mut self.world else { return };
        world.spawn(pose, self.recent.earlier(now));
        self.at = Some(now);
    }

    /// Runs the policy until its newest pose is not older than `now`.
    fn advance(&mut self, now: HostTime, pelvis: f32) {
        let (Some(world), Some(mut at)) = (&mut self.world, self.at) else {
            return;
        };
        while at < now {
            let future = self.timeline.future(at, self.options.lookahead);
            let Some((user, hands)) = future else { return };
            self.steps += 1;
            let sound = world.step(&mut self.policy, &user, hands);
            at = at.plus_ns(STEP_NS);
            self.at = Some(at);
            let head = self.timeline.at(at).map(|moment| moment.user[0]);
            let lost = if sound {
                lost(world, head.as_ref(), pelvis)
            } else {
                Some(Lost::Fault)
            };
            if let Some(why) = lost {
                match why {
                    Lost::Fallen => self.recoveries.falls += 1,
                    Lost::Drifted => self.recoveries.drifts += 1,
                    Lost::Fault => self.recoveries.faults += 1,
                }
                self.at = None;
                return;
            }
        }
    }

    /// The character's pose at `now`, put back on its feet if it must be.
    /// `pelvis` is the height of the stand-in's above its floor, metres.
    fn follow(&mut self, now: HostTime, stand_in: &BodyPose, pelvis: f32) -> Option<BodyPose> {
        let stale = self
            .at
            .is_some_and(|at| !(-2 * STEP_NS..GAP_NS).contains(&now.since_ns(at)));
        if stale {
            self.at = None;
        }
        self.advance(now, pelvis);
        if self.at.is_none() {
            self.objects = self.world.as_ref()?.objects_between(1.0);
            // Rounding must not cost a tick.
            if self.recent.lasting_ns(now) + 1000 < SETTLES_NS {
                return None;
            }
            self.spawn(now, stand_in);
            self.fade_left = RESPAWN_S;
        }
        let (world, at) = (self.world.as_ref()?, self.at?);
        let share = 1.0 - at.since_ns(now) as f64 / STEP_NS as f64;
        let pose = world.between(share.clamp(0.0, 1.0));
        self.objects = world.objects_between(share.clamp(0.0, 1.0));
        pose.is_sound().then_some(pose)
    }

    fn moment(
        &self,
        at: HostTime,
        parts: &[Lookup<Pose>; Role::COUNT],
        measured: bool,
    ) -> Option<Moment> {
        let sensed = |role: Role| {
            let lookup = &parts[role as usize];
            let there = matches!(lookup, Lookup::Exact(_) | Lookup::Interpolated(_));
            Sensed::from_lookup(lookup).filter(|_| there || !measured)
        };
        let head = sensed(Role::Head)?.place;
        let hands = [Role::LeftHand, Role::RightHand].map(sensed);
        let part = |place: Place| Part {
            position: place.position.as_dvec3(),
            rotation: place.rotation.as_dquat().normalize(),
        };
        let hand = |side: usize| part(hands[side].map_or(head, |hand| hand.place));
        let user: [Part; PARTS] = [part(head), hand(0), hand(1)];
        let hands = hands.iter().flatten().filter(|hand| hand.solid).count() == 2;
        Some(Moment { at, user, hands })
    }
}

fn root(pose: &BodyPose) -> Place {
    Place {
        position: pose.root,
        rotation: pose.rotations[Joint::Pelvis as usize],
    }
}

/// Why the character is put back.
enum Lost {
    Fallen,
    Drifted,
    Fault,
}

/// `pelvis` is the height of the stand-in's above its floor, metres.
fn lost(world: &World, head: Option<&Part>, pelvis: f32) -> Option<Lost> {
    let (height, own) = world.pelvis_and_head();
    if height < FALLEN * f64::from(pelvis) {
        return Some(Lost::Fallen);
    }
    head.is_some_and(|head| head.position.distance(own) > DRIFT)
        .then_some(Lost::Drifted)
}

impl Tracker for QuestSim {
    fn kind(&self) -> TrackerKind {
        TrackerKind::QuestSim
    }

    fn reset(&mut self) {
        self.stand_in.reset();
        self.timeline = Timeline::EMPTY;
        (self.at, self.ticked, self.shown) = (None, None, None);
        self.recent = Recent::EMPTY;
        (self.fade, self.root_fade, self.fade_left) = (PoseFade::DONE, Fade::DONE, 0.0);
        self.moves = [None; OBJECTS_MAX];
        if let Some(world) = &mut self.world {
            world.put_objects_back();
            world.leave_floor();
            self.objects = world.objects_between(1.0);
        }
    }

    fn foresight(&self) -> &'static [i64] {
        &AHEAD_NS[..self.options.lookahead.min(FUTURE)]
    }

    fn foresee(&mut self, index: usize, at: HostTime, parts: &[Lookup<Pose>; Role::COUNT]) {
        let moment = self.moment(at, parts, true);
        self.timeline.foresee(index, moment);
    }

    fn recoveries(&self) -> Option<Recoveries> {
        Some(self.recoveries)
    }

    fn objects(&self) -> Objects {
        self.objects
    }

    fn move_object(&mut self, to: &ObjectMove) {
        match &mut self.world {
            Some(world) => world.move_object(to),
            None => {
                if let Some(slot) = self.moves.get_mut(to.index) {
                    *slot = Some(*to);
                }
            }
        }
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let now = input.target;
        let mut kinematic = self.stand_in.track(input);
        let joints = input.wearer.skeleton.forward(&kinematic.pose);
        // The wearer walks on a level floor, the character on the scene's ground.
        let pelvis = kinematic.pose.root.y;
        let Vec3 { x, z, .. } = kinematic.pose.root;
        let ground = &self.options.scene.ground;
        kinematic.pose.root.y += ground.around(f64::from(x), f64::from(z)) as f32;
        let dt = self
            .ticked
            .map_or(0.0, |last| now.since_secs(last) as f32)
            .clamp(0.0, 0.5);
        let moment = self.moment(now, input.parts, false);
        if let Some(moment) = moment {
            self.timeline.push(moment);
        }
        let mut own = None;
        if kinematic.quality > Quality::Held && moment.is_some() {
            self.prepare(input);
            if let Some(world) = &mut self.world {
                world.stand_on(&joints, f64::from(dt));
            }
            let fading = self.fade_left;
            own = self.follow(now, &kinematic.pose, pelvis);
            if self.fade_left > fading {
                // The character has just been put where the stand-in was shown, or back.
                self.start_fade(own.as_ref());
            }
        } else if self.at.take().is_some() {
            self.fade_left = RESPAWN_S;
            self.start_fade(Some(&kinematic.pose));
        }
        self.ticked = Some(now);
        if kinematic.quality > Quality::Held {
            self.recent.push(now, &kinematic.pose);
        }
        let source = own.unwrap_or(kinematic.pose);
        let mut pose = self.fade.apply(&source, &input.wearer.skeleton);
        if !self.root_fade.is_done() {
            pose.root = self.root_fade.apply(&root(&source)).position;
        }
        self.fade.advance(dt);
        self.root_fade.advance(dt);
        let settled = self.fade_left <= 0.0;
        self.fade_left = (self.fade_left - dt).max(0.0);
        self.shown = Some(pose);
        Tracked {
            pose,
            quality: kinematic.quality,
            kind: if own.is_some() && settled {
                TrackerKind::QuestSim
            } else {
                kinematic.kind
            },
            forces: own.and_then(|_| self.forces()),
        }
    }
}

impl QuestSim {
    fn start_fade(&mut self, source: Option<&BodyPose>) {
        if let (Some(shown), Some(source)) = (&self.shown, source) {
            self.fade = PoseFade::start(shown, source, RESPAWN_S);
            self.root_fade = Fade::start(&root(shown), &root(source), RESPAWN_S);
        }
    }
}

#[cfg(test)]
mod tests;
