//! The network's answer moved to meet what was measured (HMD-NeMo §3.4): head and root exactly,
//! then the arms.
//!
//! The paper minimises an energy over the upper body and the root with L-BFGS. Here the head's
//! term is met in closed form by the root, the neck and the head joint, and each hand's by its arm:
//! the elbow keeps the predicted swivel, and every bone turns the short way, so that predicted
//! twists stay. The collar helps where the arm is too short. The spine is left as it is, legs keep
//! standing feet in place ([`super::plant`]). A body whose pelvis would be under the floor is turned
//! about the head.

use glam::{Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Joints, Skeleton};

use crate::{
    fade::Place,
    geometry::{Limb, direction},
};

/// Share of the head's correction that the neck takes.
const NECK_SHARE: f32 = 0.5;
/// The collar helps when the goal is farther than this share of the arm, by at most so much of its
/// own length.
const HELP_FROM: f32 = 0.97;
const HELP_MAX: f32 = 0.35;
/// Lowest place of the pelvis above the floor, metres: of one who lies.
const PELVIS_CLEAR: f32 = 0.07;
/// Scale of Barron's general robust loss with shape -2, metres: residuals well above it pull less
/// and less.
const ROBUST_SCALE: f32 = 0.12;

/// How hands are made to meet what was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Energy {
    /// Squared distances: hands are met exactly, as controllers deserve.
    #[default]
    Plain,
    /// A robust loss (Barron 2019, as HMD-NeMo uses it for hand tracking): a measurement far from
    /// the prediction is taken for an outlier and pulls less.
    Robust,
}

impl Energy {
    /// Share of the way to the measurement that a hand goes, for a residual in metres: the weight
    /// of the loss's influence against that of a square.
    pub(super) fn pull(self, residual: f32) -> f32 {
        match self {
            Self::Plain => 1.0,
            Self::Robust => {
                let scaled = residual / ROBUST_SCALE;
                (scaled * scaled / 4.0 + 1.0).powi(-2)
            }
        }
    }
}

/// A body pose under repair, with its joints in the world.
pub(super) struct Draft<'a> {
    skeleton: &'a Skeleton,
    pose: BodyPose,
    joints: Joints,
}

impl<'a> Draft<'a> {
    /// Hangs the predicted rotations from the head.
    pub(super) fn new(rotations: [Quat; JOINTS], head: &Place, skeleton: &'a Skeleton) -> Self {
        let pose = BodyPose {
            root: Vec3::ZERO,
            rotations,
        };
        let mut draft = Self {
            skeleton,
            joints: skeleton.forward(&pose),
            pose,
        };
        draft.hang(head.position);
        draft
    }

    /// The pose as it now is.
    pub(super) fn pose(&self) -> &BodyPose {
        &self.pose
    }

    /// The wrist as it now is.
    pub(super) fn wrist(&self, side: usize) -> Place {
        let joint = Joint::LeftWrist as usize + side;
        Place {
            position: self.joints.positions[joint],
            rotation: self.joints.rotations[joint],
        }
    }

    /// The shoulder with the chest's rotation.
    pub(super) fn shoulder(&self, side: usize) -> Place {
        Place {
            position: self.joints.positions[Joint::LeftShoulder as usize + side],
            rotation: self.joints.rotation(Joint::Spine3),
        }
    }

    /// Ankle and toe joint as they now are.
    pub(super) fn foot(&self, side: usize) -> [Vec3; 2] {
        [Joint::LeftAnkle, Joint::LeftFoot]
            .map(|joint| self.joints.positions[joint as usize + side])
    }

    /// Brings an ankle to `goal`, or as near as the leg reaches; the foot keeps its rotation.
    pub(super) fn meet_ankle(&mut self, side: usize, goal: Vec3) {
        let leg = [Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle];
        let leg = leg.map(|joint| joint as usize + side);
        self.reach_with(leg, Vec3::NEG_X, goal);
    }

    /// Gives the head the measured rotation.
    pub(super) fn meet_head(&mut self, head: &Place) {
        let neck = self.joints.rotation(Joint::Neck);
        let shown = self.joints.rotation(Joint::Head);
        let turn = (head.rotation * shown.inverse()).normalize();
        let neck = Quat::IDENTITY.slerp(turn, NECK_SHARE) * neck;
        self.set(Joint::Neck as usize, neck);
        self.set(Joint::Head as usize, head.rotation);
        self.hang(head.position);
    }

    /// Turns the body about the head joint, head and all, as much as brings the pelvis to the
    /// height of [`PELVIS_CLEAR`]; one that is above it stays. The head is to be met again.
    ///
    /// Networks that have seen nobody lie hang the body into the floor below a low head. The body
    /// then lies the way it leans, and the more it has to be turned, the way that the head's lower
    /// side points.
    pub(super) fn clear_floor(&mut self) {
        let head = self.joints.position(Joint::Head);
        let to_pelvis = self.joints.position(Joint::Pelvis) - head;
        let length = to_pelvis.length().max(1e-3);
        let lacking = PELVIS_CLEAR - (head.y + to_pelvis.y);
        if lacking <= 0.0 {
            return;
        }
        let down = self.joints.rotation(Joint::Head) * Vec3::NEG_Y;
        let way = to_pelvis / length + down * (lacking / length);
        let way = direction(way * Vec3::new(1.0, 0.0, 1.0), Vec3::NEG_Z);
        let sine = ((PELVIS_CLEAR - head.y) / length).clamp(-1.0, 1.0);
        let lying = way * (1.0 - sine * sine).max(0.0).sqrt() + Vec3::Y * sine;
        let turn = short_way(to_pelvis, lying);
        self.pose.rotations[0] = (turn * self.pose.rotations[0]).normalize();
        self.hang(head);
    }

    /// Brings a wrist to `goal`, or as near as the arm reaches.
    pub(super) fn meet_hand(&mut self, side: usize, goal: &Place, energy: Energy) {
        let wrist = self.wrist(side);
        let pull = energy.pull(wrist.position.distance(goal.position));
        let goal = Place {
            position: wrist.position.lerp(goal.position, pull),
            rotation: wrist.rotation.slerp(goal.rotation, pull).normalize(),
        };
        self.reach_with_collar(side, goal.position);
        self.reach_with_arm(side, goal.position);
        self.set(Joint::LeftWrist as usize + side, goal.rotation);
    }

    fn reach_with_collar(&mut self, side: usize, goal: Vec3) {
        let [collar, shoulder, elbow, wrist] = arm(side);
        let at = |joint: usize| self.joints.positions[joint];
        let length = at(elbow).distance(at(shoulder)) + at(wrist).distance(at(elbow));
        let to_goal = goal - at(shoulder);
        let lacking = to_goal.length() - HELP_FROM * length;
        let bone = at(shoulder) - at(collar);
        let most = HELP_MAX * bone.length();
        if lacking <= 0.0 || most < 1e-4 {
            return;
        }
        let help = most * (1.0 - (-lacking / most).exp());
        let moved = bone + direction(to_goal, Vec3::NEG_Y) * help;
        let turn = short_way(bone, moved);
        self.set(collar, turn * self.joints.rotations[collar]);
        self.refresh();
    }

    fn reach_with_arm(&mut self, side: usize, goal: Vec3) {
        let [_, shoulder, elbow, wrist] = arm(side);
        let sign = if side == 0 { -1.0 } else { 1.0 };
        let hinge = Vec3::new(0.0, sign, 0.0);
        self.reach_with([shoulder, elbow, wrist], hinge, goal);
    }

    /// Brings a limb's end to `goal`. `hinge` is the axis about which its middle joint bends, in
    /// the frame of its first.
    fn reach_with(&mut self, [first, middle, last]: [usize; 3], hinge: Vec3, goal: Vec3) {
        let at = |joint: usize| self.joints.positions[joint];
        let (root, bend, end) = (at(first), at(middle), at(last));
        let (upper, lower) = (bend - root, end - bend);
        // The side to which the limb bends: as predicted, by the hinge's axis while it is straight.
        let hinge = self.joints.rotations[first] * hinge;
        let straight = direction(end - root, upper);
        let by_hinge = straight.cross(hinge) * (0.05 * upper.length());
        let pole = upper - straight * upper.dot(straight) + by_hinge;
        let limb = Limb {
            upper,
            lower,
            hinge,
        };
        let (new_upper, new_lower) = limb.bones_to(root, goal, pole);
        let first_turn = short_way(upper, new_upper);
        self.set(first, first_turn * self.joints.rotations[first]);
        let middle_turn = short_way(lower, new_lower);
        self.set(middle, middle_turn * self.joints.rotations[middle]);
        self.refresh();
    }

    /// Gives a joint a rotation to the world; its children keep theirs.
    fn set(&mut self, joint: usize, rotation: Quat) {
        let rotation = rotation.normalize();
        for child in Joint::ALL {
            if child
                .parent()
                .is_some_and(|parent| parent as usize == joint)
            {
                let own = self.joints.rotations[child as usize];
                self.pose.rotations[child as usize] = (rotation.inverse() * own).normalize();
            }
        }
        let parent = Joint::ALL[joint].parent();
        let base = parent.map_or(Quat::IDENTITY, |parent| self.joints.rotation(parent));
        self.joints.rotations[joint] = rotation;
        self.pose.rotations[joint] = (base.inverse() * rotation).normalize();
    }

    fn refresh(&mut self) {
        self.joints = self.skeleton.forward(&self.pose);
    }

    /// Moves the root so that the head joint is at `head`.
    fn hang(&mut self, head: Vec3) {
        self.refresh();
        self.pose.root += head - self.joints.position(Joint::Head);
        self.refresh();
    }
}

/// Collar, shoulder, elbow and wrist of a side.
fn arm(side: usize) -> [usize; 4] {
    [
        Joint::LeftCollar,
        Joint::LeftShoulder,
        Joint::LeftElbow,
        Joint::LeftWrist,
    ]
    .map(|joint| joint as usize + side)
}

/// The least rotation that turns one direction into another.
fn short_way(from: Vec3, to: Vec3) -> Quat {
    let from = direction(from, Vec3::X);
    Quat::from_rotation_arc(from, direction(to, from))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A draft of the rest pose bent forward at the pelvis by `lean` radians, its head at `height`
    /// and pitched by `pitch`.
    fn met(skeleton: &Skeleton, lean: f32, height: f32, pitch: f32) -> Draft<'_> {
        let head = Place {
            position: Vec3::new(0.3, height, -0.2),
            rotation: Quat::from_rotation_x(pitch),
        };
        let mut rotations = [Quat::IDENTITY; JOINTS];
        rotations[0] = Quat::from_rotation_x(-lean);
        rotations[Joint::Head as usize] = Quat::from_rotation_x(pitch + lean);
        let mut draft = Draft::new(rotations, &head, skeleton);
        draft.clear_floor();
        draft.meet_head(&head);
        assert!(draft.joints.position(Joint::Head).distance(head.position) < 1e-4);
        assert!(
            draft
                .joints
                .rotation(Joint::Head)
                .angle_between(head.rotation)
                < 2e-3
        );
        draft
    }

    #[test]
    fn who_stands_is_left_as_predicted() {
        let skeleton = Skeleton::of_height(1.75);
        let draft = met(&skeleton, 0.1, skeleton.head_height() + 0.02, -0.2);
        assert!(draft.pose.rotations[0].angle_between(Quat::from_rotation_x(-0.1)) < 1e-3);
        for leg in [
            Joint::LeftHip,
            Joint::LeftKnee,
            Joint::RightHip,
            Joint::RightKnee,
        ] {
            assert!(draft.pose.rotations[leg as usize].angle_between(Quat::IDENTITY) < 1e-3);
        }
    }

    #[test]
    fn a_body_under_the_floor_lies_on_it() {
        let skeleton = Skeleton::of_height(1.75);
        // On the back, and face down: the network says that they stand.
        for (pitch, up) in [(1.5, 1.0), (-1.5, -1.0)] {
            let draft = met(&skeleton, 0.0, 0.12, pitch);
            let at = |joint| draft.joints.position(joint);
            assert!(
                (at(Joint::Pelvis).y - PELVIS_CLEAR).abs() < 0.08,
                "{}",
                at(Joint::Pelvis).y
            );
            for joint in Joint::ALL {
                assert!(at(joint).y > -0.3, "{} is at {}", joint.name(), at(joint).y);
            }
            let front = draft.joints.rotation(Joint::Pelvis) * Vec3::NEG_Z;
            assert!(front.y * up > 0.9, "the front faces {front}");
        }
    }

    #[test]
    fn sinking_turns_the_body_without_a_jump() {
        let skeleton = Skeleton::of_height(1.75);
        let mut last: Option<Joints> = None;
        for n in 0..240u8 {
            let height = 1.3 - 0.005 * f32::from(n);
            let joints = met(&skeleton, 0.3, height, -0.5).joints;
            for joint in Joint::ALL {
                let before = last.as_ref().map(|last| last.position(joint));
                let step = before.map_or(0.0, |before| before.distance(joints.position(joint)));
                assert!(step < 0.06, "{} jumps {step} m at {height} m", joint.name());
            }
            last = Some(joints);
        }
    }
}
