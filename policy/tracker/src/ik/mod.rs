//! The tracker without a model: inverse kinematics from the headset and two hands.
//!
//! The head joint is met exactly, and so are the wrists within reach. Spine, pelvis and elbows
//! take the posture that people mostly have with head and hands there ([`torso`], [`arms`]); the
//! feet stand still until they have to step ([`steps`], [`legs`]). What is not tracked fades to a
//! resting place and back (`presence`). Every time constant is in seconds: the pose does not
//! depend on the rate of the ticks.

mod arms;
mod gait;
mod legs;
mod steps;
mod torso;

use glam::{Quat, Vec3};
use posed_body::{BodyPose, Joint, Skeleton};
use posed_signal::{HostTime, Role};

use crate::{
    fade::Place,
    geometry::{gain, is_human},
    presence::{Hand, Head, Sensed, quality},
    sensors::TOE_JOINT_OVER_STATURE,
    tracker::{Input, Quality, Tracked, Tracker, TrackerKind},
};
use arms::{Arm, Swivel};
use gait::{Gait, Motion};
use legs::Leg;
use steps::{Footing, Load, Steps};
use torso::{Cues, Torso, TorsoPose};

/// A returning hand is where it is measured after this time, seconds.
const RETURN_S: f32 = 0.3;
/// A lost hand sinks to the side in this time, seconds.
const SINK_S: f32 = 0.9;
/// A longer gap between ticks counts as this long, seconds.
const GAP_MAX: f32 = 0.5;
/// Time constant with which the torso takes notice of hands that come and go, seconds.
const NOTICE_S: f32 = 0.3;
/// How far the feet's wanted place moves from below the pelvis to below the head.
const SUPPORT_TO_HEAD: f32 = 0.35;
/// Distance of the feet over that of the hip joints.
const STANCE_OVER_HIPS: f32 = 1.25;
/// Hands of a relaxed wearer from the head joint, over head height: left; the right is mirrored.
const HANDS_AT_REST: Vec3 = Vec3::new(-0.17, -0.34, -0.05);

/// Height of the toe joints of a standing wearer above the floor, metres.
pub(crate) fn toe_height(skeleton: &Skeleton) -> f32 {
    TOE_JOINT_OVER_STATURE * skeleton.stature()
}

/// Inverse kinematics from head and hands.
#[derive(Debug, Clone)]
pub struct Ik {
    last: Option<HostTime>,
    head: Head,
    hands: [Hand; 2],
    /// How much the torso heeds each hand, 0 to 1.
    notice: [f32; 2],
    torso: Torso,
    swivel: [Swivel; 2],
    gait: Gait,
    steps: Steps,
    /// The last pelvis, for the feet's balance before this tick's is known.
    overstretch: [f32; 2],
}

impl Default for Ik {
    fn default() -> Self {
        Self {
            last: None,
            head: Head::NEW,
            hands: [Hand::new(SINK_S, RETURN_S); 2],
            notice: [0.0; 2],
            torso: Torso::NEW,
            swivel: [None; 2],
            gait: Gait::NEW,
            steps: Steps::NEW,
            overstretch: [0.0; 2],
        }
    }
}

impl Tracker for Ik {
    fn kind(&self) -> TrackerKind {
        TrackerKind::Ik
    }

    fn reset(&mut self) {
        *self = Self::default();
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let dt = self
            .last
            .map_or(0.0, |last| input.target.since_secs(last) as f32);
        self.last = Some(input.target);
        let dt = dt.clamp(0.0, GAP_MAX);
        let skeleton = &input.wearer.skeleton;
        if !is_human(skeleton) {
            return self.give_up();
        }
        let sensed = [Role::Head, Role::LeftHand, Role::RightHand]
            .map(|role| Sensed::from_lookup(&input.part(role)));
        let [head, hands @ ..] = sensed;
        let standing = skeleton.head_height() + toe_height(skeleton);
        let (head, state) = self.head.update(head, dt, standing);
        let torso = self.torso(&head, hands, skeleton, dt);
        let legs = self.legs(&torso, &head, hands, skeleton, dt);
        let mut pose = BodyPose::rest(torso.root);
        write_torso(&mut pose, &torso, head.rotation);
        for side in 0..2 {
            write_leg(&mut pose, side, &torso, &legs[side]);
            self.arm(&mut pose, side, &torso, hands[side], skeleton, dt);
        }
        if !pose.is_sound() {
            return self.give_up();
        }
        Tracked {
            pose,
            quality: quality(state, hands),
            kind: TrackerKind::Ik,
            forces: None,
        }
    }
}

impl Ik {
    /// A pose that stands at the origin, and a fresh start: for a wearer whose bones make no sense.
    fn give_up(&mut self) -> Tracked {
        self.reset();
        let pose = BodyPose::rest(Vec3::new(0.0, 0.9, 0.0));
        Tracked {
            pose,
            quality: Quality::Held,
            kind: TrackerKind::Ik,
            forces: None,
        }
    }

    fn torso(
        &mut self,
        head: &Place,
        hands: [Option<Sensed>; 2],
        skeleton: &Skeleton,
        dt: f32,
    ) -> TorsoPose {
        let tall = skeleton.head_height().max(0.1);
        let level = Quat::from_rotation_y(-self.torso.head_yaw(head.rotation));
        let mut cues = Cues {
            hands: [HANDS_AT_REST, HANDS_AT_REST * Vec3::new(-1.0, 1.0, 1.0)],
            over_feet: Vec3::ZERO,
            raised: head.position.y / (tall + toe_height(skeleton)) - 1.0,
        };
        for (side, hand) in hands.into_iter().enumerate() {
            let seen = if hand.is_some() { 1.0 } else { 0.0 };
            self.notice[side] += (seen - self.notice[side]) * gain(dt, NOTICE_S);
            let Some(hand) = hand else { continue };
            let from_head = level * (hand.place.position - head.position) / tall;
            let from_head = from_head.clamp_length_max(1.0);
            cues.hands[side] = cues.hands[side].lerp(from_head, self.notice[side]);
        }
        if self.steps.started() {
            let over_feet = (head.position - self.steps.middle()) / tall;
            let level = Quat::from_rotation_y(-self.torso.chest_yaw());
            cues.over_feet = level * Vec3::new(over_feet.x, 0.0, over_feet.z);
        }
        self.torso.update(head, &cues, skeleton, dt)
    }

    fn legs(
        &mut self,
        torso: &TorsoPose,
        head: &Place,
        hands: [Option<Sensed>; 2],
        skeleton: &Skeleton,
        dt: f32,
    ) -> [legs::LegPose; 2] {
        let tall = skeleton.head_height().max(0.1);
        let apart = match hands {
            [Some(left), Some(right)] => left.place.position - right.place.position,
            _ => Vec3::ZERO,
        };
        let motion = Motion {
            head: head.position / tall,
            hands: apart / tall,
        };
        let swinging = self.gait.update(motion, dt);
        let legs = [Leg::new(skeleton, 0), Leg::new(skeleton, 1)];
        let center = torso.root.lerp(head.position, SUPPORT_TO_HEAD);
        let load = Load {
            center: Vec3::new(center.x, 0.0, center.z),
            yaw: self.torso.pelvis_yaw(),
            leg: legs[0].length().max(0.1),
            half_width: STANCE_OVER_HIPS * skeleton.offsets[Joint::LeftHip as usize].x.abs(),
            overstretch: self.overstretch,
            swinging,
        };
        let feet: [Footing; 2] = self.steps.update(&load, dt);
        for side in 0..2 {
            self.overstretch[side] = legs[side].overstretch(torso.root, torso.pelvis, &feet[side]);
        }
        [0, 1].map(|side: usize| legs[side].solve(torso.root, torso.pelvis, &feet[side]))
    }

    fn arm(
        &mut self,
        pose: &mut BodyPose,
        side: usize,
        torso: &TorsoPose,
        hand: Option<Sensed>,
        skeleton: &Skeleton,
        dt: f32,
    ) {
        let arm = Arm::new(skeleton, side);
        let chest = torso.spine[2];
        let at = torso.chest_at(skeleton);
        let heading = Quat::from_rotation_y(self.torso.chest_yaw());
        let base = Place {
            position: arm.shoulder_at(at, chest),
            rotation: heading,
        };
        let goal = self.hands[side].update(hand, &base, &arm.rest(), dt);
        let solved = arm.solve(at, chest, &goal, &mut self.swivel[side], dt);
        let chain = [
            (Joint::LeftCollar, chest, solved.collar),
            (Joint::LeftShoulder, solved.collar, solved.shoulder),
            (Joint::LeftElbow, solved.shoulder, solved.elbow),
            (Joint::LeftWrist, solved.elbow, solved.wrist),
        ];
        write_chain(pose, side, chain);
    }
}

fn write_torso(pose: &mut BodyPose, torso: &TorsoPose, head: Quat) {
    let [low, middle, chest] = torso.spine;
    pose.rotations[Joint::Pelvis as usize] = torso.pelvis;
    let chain = [
        (Joint::Spine1, torso.pelvis, low),
        (Joint::Spine2, low, middle),
        (Joint::Spine3, middle, chest),
        (Joint::Neck, chest, torso.neck),
        (Joint::Head, torso.neck, head),
    ];
    write_chain(pose, 0, chain);
}

fn write_leg(pose: &mut BodyPose, side: usize, torso: &TorsoPose, leg: &legs::LegPose) {
    let chain = [
        (Joint::LeftHip, torso.pelvis, leg.hip),
        (Joint::LeftKnee, leg.hip, leg.knee),
        (Joint::LeftAnkle, leg.knee, leg.ankle),
        (Joint::LeftFoot, leg.ankle, leg.toe),
    ];
    write_chain(pose, side, chain);
}

/// Local rotations from those of parent and joint in the world; `side` 1 is the joint to the right.
fn write_chain<const N: usize>(pose: &mut BodyPose, side: usize, chain: [(Joint, Quat, Quat); N]) {
    for (joint, parent, own) in chain {
        pose.rotations[joint as usize + side] = (parent.inverse() * own).normalize();
    }
}

#[cfg(test)]
mod tests;
