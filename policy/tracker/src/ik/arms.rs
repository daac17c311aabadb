//! Arms between the chest and the wrists.

use std::f32::consts::FRAC_PI_2;

use glam::{Mat3, Quat, Vec3};
use posed_body::{Joint, Skeleton};

use crate::{
    fade::Place,
    geometry::{Limb, direction, gain, twist_about},
};

/// The collar helps when the arm is stretched by more than this share of its length, and moves
/// the shoulder by at most so much of the collar's.
const HELP_FROM: f32 = 0.92;
const HELP_MAX: f32 = 0.35;
/// Time constant of the elbow's swivel, seconds.
const SWIVEL_S: f32 = 0.06;
/// Share of the hand's turn about the forearm that the elbow takes: the forearm's two bones cross
/// along its whole length.
const FOREARM_TWIST: f32 = 0.5;

/// Direction in which a left elbow is displaced from the line between shoulder and wrist, in the
/// chest's frame, linear in: 1, the wrist from the shoulder over arm length (3), and the hand's
/// axes X, Y, Z (3 each). Least squares on the training clips of the CMU and FuBOT motion sets; on
/// each set, fitted to the others, it is 15 degrees off in the mean.
const SWIVEL: [[f32; 3]; 13] = [
    [-0.24, -0.28, 0.08],
    [-0.18, 0.01, -0.44],
    [-0.34, 0.09, -0.82],
    [0.44, 0.57, 0.27],
    [0.32, -0.16, -0.06],
    [-0.02, 0.29, -0.10],
    [0.05, 0.04, 0.32],
    [0.00, -0.06, -0.04],
    [-0.01, 0.14, -0.01],
    [0.14, 0.07, 0.07],
    [0.23, -0.01, 0.02],
    [0.06, 0.09, 0.10],
    [-0.11, 0.01, 0.11],
];

/// One arm's bones.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arm {
    limb: Limb,
    /// Collar in the chest's frame, and shoulder in the collar's.
    collar: Vec3,
    shoulder: Vec3,
    /// -1 on the left, 1 on the right.
    side: f32,
}

/// Rotations of an arm's joints, joint to world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ArmPose {
    pub collar: Quat,
    pub shoulder: Quat,
    pub elbow: Quat,
    pub wrist: Quat,
}

/// The elbow's swivel over ticks: its direction in the chest's frame.
pub(crate) type Swivel = Option<Vec3>;

impl Arm {
    /// Left (0) or right (1).
    pub(crate) fn new(skeleton: &Skeleton, side: usize) -> Self {
        let bone = |joint: Joint| skeleton.offsets[joint as usize + side];
        let sign = if side == 0 { -1.0 } else { 1.0 };
        Self {
            limb: Limb {
                upper: bone(Joint::LeftElbow),
                lower: bone(Joint::LeftWrist),
                hinge: Vec3::new(0.0, sign, 0.0),
            },
            collar: bone(Joint::LeftCollar),
            shoulder: bone(Joint::LeftShoulder),
            side: sign,
        }
    }

    /// The shoulder joint of a relaxed collar, from the chest joint `at`.
    pub(crate) fn shoulder_at(&self, at: Vec3, chest: Quat) -> Vec3 {
        at + chest * (self.collar + self.shoulder)
    }

    /// Where the wrist hangs at the side, from the shoulder and in the chest's heading frame.
    pub(crate) fn rest(&self) -> Place {
        let length = self.limb.length();
        let position = Vec3::new(self.side * 0.16, -0.95, -0.12) * length;
        Place {
            position,
            rotation: Quat::from_rotation_z(-self.side * FRAC_PI_2),
        }
    }

    /// The arm with its wrist at `goal`, or as near as it reaches.
    pub(crate) fn solve(
        &self,
        at: Vec3,
        chest: Quat,
        goal: &Place,
        swivel: &mut Swivel,
        dt: f32,
    ) -> ArmPose {
        let collar = self.reach_collar(at, chest, goal.position);
        let shoulder = at + chest * self.collar + collar * self.shoulder;
        let wanted = self.guess_swivel(
            chest.inverse() * (goal.position - shoulder),
            &(chest.inverse() * goal.rotation),
        );
        let shown = match *swivel {
            Some(last) => direction(last.lerp(wanted, gain(dt, SWIVEL_S)), wanted),
            None => wanted,
        };
        *swivel = Some(shown);
        let solved = self.limb.reach(shoulder, goal.position, chest * shown);
        let along = direction(self.limb.lower, Vec3::X);
        let hand = (solved.lower.inverse() * goal.rotation).normalize();
        let hand = if hand.w < 0.0 { -hand } else { hand };
        let twist = Quat::IDENTITY.slerp(twist_about(hand, along), FOREARM_TWIST);
        let elbow = (solved.lower * twist).normalize();
        ArmPose {
            collar,
            shoulder: solved.upper,
            elbow,
            wrist: goal.rotation,
        }
    }

    /// The collar's rotation: towards goals that the arm alone hardly reaches.
    fn reach_collar(&self, at: Vec3, chest: Quat, goal: Vec3) -> Quat {
        let rest = self.shoulder_at(at, chest);
        let to_goal = goal - rest;
        let length = self.limb.length();
        let lacking = to_goal.length() - HELP_FROM * length;
        let bone = chest * self.shoulder;
        if lacking <= 0.0 {
            return chest;
        }
        let most = HELP_MAX * bone.length();
        // Saturates smoothly: full help only for goals out of reach.
        let help = most * (1.0 - (-lacking / most).exp());
        let moved = bone + direction(to_goal, Vec3::NEG_Y) * help;
        let turn = Quat::from_rotation_arc(direction(bone, Vec3::X), direction(moved, Vec3::X));
        (turn * chest).normalize()
    }

    /// The elbow's direction from the wrist and hand in the chest's frame.
    fn guess_swivel(&self, wrist: Vec3, hand: &Quat) -> Vec3 {
        // The table is for a left arm; a right one is mirrored in X.
        let mirror = Vec3::new(-self.side, 1.0, 1.0);
        let wrist = (wrist / self.limb.length()).clamp_length_max(1.2) * mirror;
        let axes = Mat3::from_quat(*hand);
        // M R M: the X axis is flipped once by its own mirror image.
        let x = axes.x_axis * mirror * -self.side;
        let features: [f32; 13] = [
            1.0,
            wrist.x,
            wrist.y,
            wrist.z,
            x.x,
            x.y,
            x.z,
            axes.y_axis.x * mirror.x,
            axes.y_axis.y,
            axes.y_axis.z,
            axes.z_axis.x * mirror.x,
            axes.z_axis.y,
            axes.z_axis.z,
        ];
        let mut pole = Vec3::ZERO;
        for (feature, row) in features.into_iter().zip(SWIVEL) {
            pole += Vec3::from_array(row) * feature;
        }
        let pole = direction(pole * mirror, Vec3::NEG_Y);
        // Square to the arm, so that the filter over ticks does not mix in the arm's own motion.
        let along = direction(wrist * mirror, Vec3::NEG_Y);
        direction(pole - along * pole.dot(along), pole)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ends(arm: &Arm, at: Vec3, chest: Quat, pose: &ArmPose) -> (Vec3, Vec3) {
        let shoulder = at + chest * arm.collar + pose.collar * arm.shoulder;
        let elbow = shoulder + pose.shoulder * arm.limb.upper;
        (elbow, elbow + pose.elbow * arm.limb.lower)
    }

    proptest! {
        #[test]
        fn hands_within_reach_are_met_and_left_mirrors_right(
            goal in prop::array::uniform3(-0.45f32..0.45),
            turn in prop::array::uniform3(-2.0f32..2.0),
        ) {
            let skeleton = Skeleton::of_height(1.75);
            let chest_at = Vec3::new(0.0, 1.2, 0.0);
            let mut elbows = [Vec3::ZERO; 2];
            for (side, shown) in elbows.iter_mut().enumerate() {
                let arm = Arm::new(&skeleton, side);
                let mirror = Vec3::new(-arm.side, 1.0, 1.0);
                let shoulder = arm.shoulder_at(chest_at, Quat::IDENTITY);
                let [x, y, z] = turn;
                let sign = -arm.side;
                let rotation = Quat::from_scaled_axis(Vec3::new(x, y * sign, z * sign));
                let position = shoulder + Vec3::from(goal) * mirror;
                let place = Place { position, rotation };
                let mut swivel = None;
                let pose = arm.solve(chest_at, Quat::IDENTITY, &place, &mut swivel, 0.01);
                let (elbow, wrist) = ends(&arm, chest_at, Quat::IDENTITY, &pose);
                let distance = (place.position - shoulder).length();
                let reach = 1.001 * arm.limb.shortest()..0.999 * arm.limb.length();
                if reach.contains(&distance) {
                    prop_assert!(wrist.distance(place.position) < 1e-3, "{wrist} {place:?}");
                }
                prop_assert_eq!(pose.wrist, rotation);
                *shown = elbow;
            }
            let mirrored = elbows[0] * Vec3::new(-1.0, 1.0, 1.0);
            prop_assert!(mirrored.distance(elbows[1]) < 2e-3, "{} {}", elbows[0], elbows[1]);
        }
    }

    #[test]
    fn elbows_point_down_and_back_with_the_hands_in_front() {
        let skeleton = Skeleton::of_height(1.75);
        for side in 0..2 {
            let arm = Arm::new(&skeleton, side);
            let at = Vec3::new(0.0, 1.2, 0.0);
            let shoulder = arm.shoulder_at(at, Quat::IDENTITY);
            let position = shoulder + Vec3::new(-arm.side * 0.08, -0.15, -0.3);
            // Fingers forward, thumb up.
            let rotation = Quat::from_rotation_z(-arm.side * FRAC_PI_2)
                * Quat::from_rotation_y(arm.side * FRAC_PI_2);
            let goal = Place { position, rotation };
            let pose = arm.solve(at, Quat::IDENTITY, &goal, &mut None, 0.01);
            let (elbow, _) = ends(&arm, at, Quat::IDENTITY, &pose);
            assert!(
                elbow.y < shoulder.y - 0.15,
                "elbow {elbow}, shoulder {shoulder}"
            );
            assert!(
                (elbow.x - shoulder.x) * arm.side > -0.05,
                "not across the body: {elbow}"
            );
        }
    }

    #[test]
    fn the_collar_helps_only_far_reaches() {
        let skeleton = Skeleton::of_height(1.75);
        let arm = Arm::new(&skeleton, 1);
        let at = Vec3::Y;
        let shoulder = arm.shoulder_at(at, Quat::IDENTITY);
        assert_eq!(
            arm.reach_collar(at, Quat::IDENTITY, shoulder + Vec3::NEG_Z * 0.3),
            Quat::IDENTITY
        );
        let far = arm.reach_collar(at, Quat::IDENTITY, shoulder + Vec3::NEG_Z * 0.7);
        assert!((far * arm.shoulder).z < arm.shoulder.z - 0.02);
    }
}
