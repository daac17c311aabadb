//! From the networks' motion status to a body in the world: the physics optimiser of PIP section
//! 3.2, or for comparison what its Table 2 leaves of it.

use glam::Vec3;
use posed_body::{
    BodyPose, JOINTS, Joint, Skeleton,
    optimiser::{Optimiser, Reference, Settings},
    scene::Ground,
};

use super::network::Answer;
use crate::{
    physics::average_mass,
    sensors::TOE_JOINT_OVER_STATURE,
    steps::STEP_NS,
    tracker::{Forces, Wearer},
};

/// What makes the body's motion out of the networks' answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Physics {
    /// The optimiser under both controllers.
    #[default]
    DualPd,
    /// The optimiser under the rotation controller and the pelvis's velocity alone.
    RotationsOnly,
    /// None: rotations as they are, the pelvis's velocity integrated.
    Off,
}

/// Seconds of a step.
const STEP_S: f32 = STEP_NS as f32 * 1e-9;
/// A foot that stands with this probability shows where the floor is.
const STANDS: f32 = 0.6;
/// An error in the height of a standing foot is gone after this time, seconds.
const SETTLE_S: f32 = 0.25;
/// Fastest correction of that, m/s.
const SETTLE_MAX: f32 = 0.3;
/// A standing foot that is further off than this is on something else, metres.
const STEP_HEIGHT: f32 = 0.25;

/// The body of one wearer.
pub(super) struct Dynamics {
    optimiser: Optimiser,
    physics: Physics,
    wearer: Wearer,
    /// The last pose.
    pose: Option<BodyPose>,
    /// Height of a standing toe joint above the floor, metres.
    clearance: f32,
}

impl Dynamics {
    pub(super) fn new(wearer: &Wearer, physics: Physics) -> Self {
        let mut settings = Settings::default();
        if physics == Physics::RotationsOnly {
            settings.position_shares = [0.0; JOINTS];
            settings.position_shares[0] = 1.0;
        }
        let mass = average_mass(wearer);
        let tick = f64::from(STEP_S);
        Self {
            optimiser: Optimiser::new(&wearer.skeleton, mass, tick, settings),
            physics,
            wearer: *wearer,
            pose: None,
            clearance: TOE_JOINT_OVER_STATURE * wearer.height,
        }
    }

    /// Forgets the past.
    pub(super) fn reset(&mut self) {
        self.optimiser.reset();
        self.pose = None;
    }

    /// Whether the body is this wearer's.
    pub(super) fn fits(&self, wearer: &Wearer) -> bool {
        self.wearer == *wearer
    }

    /// Takes over another wearer, and forgets the past. Nothing is allocated.
    pub(super) fn wear(&mut self, wearer: &Wearer) {
        self.wearer = *wearer;
        self.optimiser.wear(&wearer.skeleton, average_mass(wearer));
        self.clearance = TOE_JOINT_OVER_STATURE * wearer.height;
        self.reset();
    }

    /// Moves the body on by one step. `first` is where the pelvis begins, if that is known;
    /// `head` is where a headset says that the head joint is.
    pub(super) fn step(
        &mut self,
        answer: &Answer,
        first: Option<Vec3>,
        head: Option<Vec3>,
    ) -> (BodyPose, Option<Forces>) {
        let skeleton = &self.wearer.skeleton;
        let mut pose = answer.pose;
        let hung = head.map(|head| head - skeleton.forward(&pose).position(Joint::Head));
        let Some(last) = self.pose else {
            pose.root = hung.or(first).unwrap_or_else(|| self.on_floor(&pose));
            self.clearance = self.first_clearance(&pose);
            return self.finish(&pose, None, answer);
        };
        if let Some(root) = hung {
            pose.root = root;
            return self.finish(&pose, None, answer);
        }
        let mut velocities = answer.velocities;
        if self.physics != Physics::Off {
            let settle = Vec3::Y * self.settle(&last, answer.contact);
            velocities = velocities.map(|velocity| velocity + settle);
        }
        pose.root = last.root + velocities[0] * STEP_S;
        self.finish(&pose, Some(&velocities), answer)
    }

    fn finish(
        &mut self,
        pose: &BodyPose,
        velocities: Option<&[Vec3; JOINTS]>,
        answer: &Answer,
    ) -> (BodyPose, Option<Forces>) {
        if self.physics == Physics::Off {
            self.pose = Some(*pose);
            return (*pose, None);
        }
        let reference = Reference {
            pose,
            velocities,
            contacts: Some(answer.contact),
        };
        let solved = self.optimiser.step(&reference, &Ground::Flat);
        self.pose = Some(solved.pose);
        (solved.pose, Some(Forces::of(&solved)))
    }

    /// Where the pelvis is when the lower foot stands.
    fn on_floor(&self, pose: &BodyPose) -> Vec3 {
        Vec3::Y * (self.clearance - lowest_toe(&self.wearer.skeleton, pose))
    }

    /// Height of the lower toe in the first pose, if a foot stands in it.
    fn first_clearance(&self, pose: &BodyPose) -> f32 {
        let usual = TOE_JOINT_OVER_STATURE * self.wearer.height;
        let low = lowest_toe(&self.wearer.skeleton, pose);
        if (0.0..4.0 * usual).contains(&low) {
            low
        } else {
            usual
        }
    }

    /// Vertical velocity that takes standing feet back to the floor: velocities alone would let
    /// the body drift up or down, as PIP's translation does without its optimiser.
    fn settle(&self, last: &BodyPose, contact: [f32; 2]) -> f32 {
        let joints = self.wearer.skeleton.forward(last);
        let feet = [Joint::LeftFoot, Joint::RightFoot];
        let stands = |foot: usize| (contact[foot] > STANDS).then(|| joints.position(feet[foot]).y);
        let height = match (stands(0), stands(1)) {
            (Some(left), Some(right)) => left.min(right),
            (one, other) => match one.or(other) {
                Some(height) => height,
                None => return 0.0,
            },
        };
        let off = self.clearance - height;
        if off.abs() > STEP_HEIGHT {
            return 0.0;
        }
        (off / SETTLE_S).clamp(-SETTLE_MAX, SETTLE_MAX)
    }
}

fn lowest_toe(skeleton: &Skeleton, pose: &BodyPose) -> f32 {
    let joints = skeleton.forward(pose);
    let toe = |joint| joints.position(joint).y;
    toe(Joint::LeftFoot).min(toe(Joint::RightFoot))
}
