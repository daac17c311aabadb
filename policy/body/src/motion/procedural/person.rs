//! The person: from what the tracks say to a body pose.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

use super::limb::{arm_frame, bend, leg_frame};
use super::steps::{Foot, Gait, Spot, Style, Walk};
use super::track::{Drift, Random, Track};
use crate::skeleton::{BodyPose, Joint, Skeleton};

/// The stature that lengths and times below are for, metres.
const REFERENCE_STATURE: f64 = 1.75;
/// Height of the toe joints above the floor, over stature.
const TOE_JOINT_OVER_STATURE: f64 = 0.0143;
/// A standing leg's length over its bones': knees are not locked.
const STANDING_REACH: f64 = 0.985;
/// The most that a walking leg is stretched.
const WALKING_REACH: f64 = 0.988;

/// Bone lengths and offsets that the limbs need, metres.
#[derive(Debug, Clone)]
pub(super) struct Build {
    offsets: [DVec3; crate::JOINTS],
    leg: [f64; 2],
    arm: [f64; 2],
    /// Of the toe joints above the floor.
    toe_height: f64,
    /// Of the pelvis in upright standing.
    pelvis_height: f64,
    /// Over the reference stature.
    pub(super) scale: f64,
}

impl Build {
    fn new(skeleton: &Skeleton) -> Self {
        let offsets = skeleton.offsets.map(|offset| offset.as_dvec3());
        let offset = |joint: Joint| offsets[joint as usize];
        let leg = [Joint::LeftKnee, Joint::LeftAnkle].map(|joint| offset(joint).length());
        let arm = [Joint::LeftElbow, Joint::LeftWrist].map(|joint| offset(joint).length());
        let stature = f64::from(skeleton.stature());
        let toe_height = TOE_JOINT_OVER_STATURE * stature;
        let ankle_height = toe_height - offset(Joint::LeftFoot).y;
        let standing = STANDING_REACH * (leg[0] + leg[1]);
        Self {
            leg,
            arm,
            toe_height,
            pelvis_height: ankle_height + standing - offset(Joint::LeftHip).y,
            scale: stature / REFERENCE_STATURE,
            offsets,
        }
    }

    fn offset(&self, joint: Joint) -> DVec3 {
        self.offsets[joint as usize]
    }
}

/// A hand's movements: where it is in the chest's frame (metres from the shoulder at the reference
/// stature; x outward), and its turn about the forearm, the palm's hinge and the thumb's (rad).
pub(super) type HandTrack = Track<6>;

/// Everything that the person does over time.
#[derive(Debug, Clone)]
pub(super) struct Person {
    pub(super) build: Build,
    pub(super) walk: Walk,
    /// How far the pelvis is lowered and shifted back (metres at the reference stature), and how
    /// far the trunk leans (rad).
    pub(super) crouch: Track<3>,
    /// Where the head looks from the body's heading, left and up, and the trunk's turn to the
    /// left, rad.
    pub(super) gaze: Track<3>,
    pub(super) left_hand: HandTrack,
    pub(super) right_hand: HandTrack,
    sway: Drift<2>,
    look: Drift<2>,
    hands: Drift<6>,
    breath_rate: f64,
}

impl Person {
    /// Standing at `start`, hands in front of the waist as with controllers in them.
    pub(super) fn new(skeleton: &Skeleton, start: Spot, random: &mut Random) -> Self {
        let build = Build::new(skeleton);
        let hip = build.offset(Joint::RightHip);
        let pace = build.scale.sqrt();
        let style = Style {
            half_width: 1.05 * hip.x,
            forward: -hip.z,
            speed: random.between(0.65, 0.8) * pace,
            turn_speed: random.between(1.3, 1.6) / pace,
            step_s: random.between(0.54, 0.6) * pace,
        };
        Self {
            walk: Walk::new(start, style),
            crouch: Track::new([0.0; 3]),
            gaze: Track::new([0.0; 3]),
            left_hand: Track::new(super::script::HANDS_READY),
            right_hand: Track::new(super::script::HANDS_READY),
            sway: Drift::new(random, 0.005 * build.scale, 0.4),
            look: Drift::new(random, 0.05, 0.5),
            hands: Drift::new(random, 0.012, 0.8),
            breath_rate: TAU * random.between(0.22, 0.28),
            build,
        }
    }

    /// The body pose at a time in seconds.
    pub(super) fn pose(&self, t: f64) -> BodyPose {
        let mut figure = Figure::new(&self.build);
        let gait = self.walk.gait(t);
        self.place_pelvis(t, &gait, &mut figure);
        self.bend_trunk(t, &gait, &mut figure);
        for left in [true, false] {
            self.bend_leg(&self.walk.foot(t, left), left, &mut figure);
            self.bend_arm(t, &gait, left, &mut figure);
        }
        figure.pose()
    }

    fn place_pelvis(&self, t: f64, gait: &Gait, figure: &mut Figure) {
        let scale = self.build.scale;
        let [lower, back, lean] = self.crouch.at(t);
        let [drift_x, drift_z] = self.sway.at(t);
        let body = self.walk.body(t);
        let aside = 0.022 * scale * gait.sway + drift_x;
        let spot = body.offset(aside, back * scale + drift_z);
        let turn = DQuat::from_rotation_y(body.heading + 0.09 * gait.wave);
        let tilt = DQuat::from_rotation_x(-0.5 * lean - 0.03 * gait.going);
        let roll = DQuat::from_rotation_z(0.03 * gait.sway);
        figure.turn_to(Joint::Pelvis, turn * tilt * roll);
        let wanted = self.build.pelvis_height - (lower + 0.01 * gait.going) * scale;
        figure.root = DVec3::new(spot.x, 0.0, spot.z);
        let [left, right] = [true, false].map(|left| self.height_in_reach(t, left, figure));
        // In a gait the legs' limits alternate: rounding them off makes it soft.
        let width = (0.006 + 0.02 * gait.going) * scale;
        figure.root.y = smooth_minimum([wanted, left, right], width);
    }

    /// How high the pelvis can be for this leg to reach its foot, bent a little still.
    fn height_in_reach(&self, t: f64, left: bool, figure: &Figure) -> f64 {
        let [hip, .., toes] = leg_joints(left);
        let (ankle, _) = self.ankle(&self.walk.foot(t, left), toes);
        let away = ankle - figure.position(hip);
        let leg = WALKING_REACH * (self.build.leg[0] + self.build.leg[1]);
        let drop = (leg * leg - away.x * away.x - away.z * away.z)
            .max(0.0)
            .sqrt();
        away.y + drop
    }

    /// Where a foot's ankle is, and the foot's rotation.
    fn ankle(&self, foot: &Foot, toes: Joint) -> (DVec3, DQuat) {
        let build = &self.build;
        let flat = DQuat::from_rotation_y(foot.spot.heading);
        let raised = flat * DQuat::from_rotation_x(-foot.pitch);
        // The toe joint stays on the floor while the heel leaves it.
        let lift = 0.075 * build.scale * foot.lift;
        let over = DVec3::new(foot.spot.x, build.toe_height + lift, foot.spot.z);
        let bone = build.offset(toes);
        let toe = over + flat * DVec3::new(0.0, 0.0, bone.z);
        (toe - raised * bone, raised)
    }

    fn bend_trunk(&self, t: f64, gait: &Gait, figure: &mut Figure) {
        let [_, _, lean] = self.crouch.at(t);
        let [gaze_left, gaze_up, twist] = self.gaze.at(t);
        let [look_left, look_up] = self.look.at(t);
        let breath = (self.breath_rate * t).sin();
        // The trunk turns against the pelvis.
        let twist = (twist - 0.16 * gait.wave) / 3.0;
        let bend = (-0.5 * lean - 0.02 * gait.going) / 3.0 + 0.004 * breath;
        let roll = -0.02 * gait.sway / 3.0;
        let spine = DQuat::from_rotation_y(twist)
            * DQuat::from_rotation_x(bend)
            * DQuat::from_rotation_z(roll);
        for joint in [Joint::Spine1, Joint::Spine2, Joint::Spine3] {
            figure.turn_by(joint, spine);
        }
        let heading = self.walk.body(t).heading + gaze_left + look_left;
        let head = DQuat::from_rotation_y(heading) * DQuat::from_rotation_x(gaze_up + look_up);
        // Neck and head share the turn.
        let against_chest = figure.world(Joint::Spine3).conjugate() * head;
        let half = DQuat::IDENTITY.slerp(against_chest, 0.5);
        figure.turn_by(Joint::Neck, half);
        figure.turn_to(Joint::Head, head);
        for (joint, side) in [(Joint::LeftCollar, -1.0), (Joint::RightCollar, 1.0)] {
            figure.turn_by(joint, DQuat::from_rotation_z(side * (0.01 + 0.01 * breath)));
        }
    }

    fn bend_leg(&self, foot: &Foot, left: bool, figure: &mut Figure) {
        let [hip, knee, ankle, toes] = leg_joints(left);
        let (target, raised) = self.ankle(foot, toes);
        let root = figure.position(hip);
        let forward = figure.world(Joint::Pelvis) * DVec3::NEG_Z;
        let ahead = DQuat::from_rotation_y(foot.spot.heading) * DVec3::NEG_Z;
        let pole = forward + ahead + DVec3::Y * 0.2;
        let bones = bend(root, target, self.build.leg, pole);
        figure.turn_to(hip, leg_frame(bones.upper, bones.normal));
        figure.turn_to(knee, leg_frame(bones.lower, bones.normal));
        figure.turn_to(ankle, raised);
        // Toes stay flat while the heel rises.
        figure.turn_by(toes, DQuat::from_rotation_x(foot.pitch.max(0.0)));
    }

    fn bend_arm(&self, t: f64, gait: &Gait, left: bool, figure: &mut Figure) {
        use Joint::{LeftElbow, LeftShoulder, LeftWrist};
        use Joint::{RightElbow, RightShoulder, RightWrist};
        let [shoulder, elbow, wrist] = if left {
            [LeftShoulder, LeftElbow, LeftWrist]
        } else {
            [RightShoulder, RightElbow, RightWrist]
        };
        let (track, side) = if left {
            (&self.left_hand, -1.0)
        } else {
            (&self.right_hand, 1.0)
        };
        let [x, y, z, roll, nod, turn] = track.at(t);
        let drift = self.hands.at(t);
        let [drift_x, drift_y, drift_z] = if left {
            [drift[0], drift[1], drift[2]]
        } else {
            [drift[3], drift[4], drift[5]]
        };
        // The arms swing against the legs.
        let swing = side * 0.07 * gait.wave;
        let place = DVec3::new(side * (x + drift_x), y + drift_y, z + drift_z + swing);
        let chest = figure.world(Joint::Spine3);
        let root = figure.position(shoulder);
        let target = root + chest * (place * self.build.scale);
        let pole = chest * DVec3::new(side * 0.45, -0.8, 0.5);
        let bones = bend(root, target, self.build.arm, pole);
        figure.turn_to(shoulder, arm_frame(bones.upper, bones.normal, left));
        figure.turn_to(elbow, arm_frame(bones.lower, bones.normal, left));
        let hand = DQuat::from_rotation_x(side * roll)
            * DQuat::from_rotation_z(side * nod)
            * DQuat::from_rotation_y(side * turn);
        figure.turn_by(wrist, hand);
    }
}

/// Hip, knee, ankle and toes of a side.
fn leg_joints(left: bool) -> [Joint; 4] {
    use Joint::{LeftAnkle, LeftFoot, LeftHip, LeftKnee};
    use Joint::{RightAnkle, RightFoot, RightHip, RightKnee};
    if left {
        [LeftHip, LeftKnee, LeftAnkle, LeftFoot]
    } else {
        [RightHip, RightKnee, RightAnkle, RightFoot]
    }
}

/// The smallest of three values, rounded off where two come within about `width`.
fn smooth_minimum(values: [f64; 3], width: f64) -> f64 {
    let least = values.into_iter().fold(f64::MAX, f64::min);
    let sum: f64 = values
        .iter()
        .map(|value| ((least - value) / width).exp())
        .sum();
    least - width * sum.ln()
}

/// A body under construction: joints are set from the pelvis outwards.
struct Figure<'a> {
    build: &'a Build,
    root: DVec3,
    local: [DQuat; crate::JOINTS],
}

impl<'a> Figure<'a> {
    fn new(build: &'a Build) -> Self {
        Self {
            build,
            root: DVec3::ZERO,
            local: [DQuat::IDENTITY; crate::JOINTS],
        }
    }

    /// A joint's rotation in the world.
    fn world(&self, joint: Joint) -> DQuat {
        let parent = joint
            .parent()
            .map_or(DQuat::IDENTITY, |parent| self.world(parent));
        parent * self.local[joint as usize]
    }

    /// A joint's position in the world.
    fn position(&self, joint: Joint) -> DVec3 {
        joint.parent().map_or(self.root, |parent| {
            self.position(parent) + self.world(parent) * self.build.offset(joint)
        })
    }

    /// Gives a joint this rotation against its parent.
    fn turn_by(&mut self, joint: Joint, local: DQuat) {
        self.local[joint as usize] = local;
    }

    /// Gives a joint this rotation in the world.
    fn turn_to(&mut self, joint: Joint, world: DQuat) {
        let parent = joint
            .parent()
            .map_or(DQuat::IDENTITY, |parent| self.world(parent));
        self.local[joint as usize] = parent.conjugate() * world;
    }

    fn pose(&self) -> BodyPose {
        BodyPose {
            root: self.root.as_vec3(),
            rotations: self.local.map(|rotation| rotation.normalize().as_quat()),
        }
    }
}
