//! Geometry that arms and legs share: headings, safe directions, limbs of two bones.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Quat, Vec3};
use posed_body::{Joint, Skeleton};

/// Heading of a rotation: its twist about +Y, radians. The swing-twist split stays smooth when
/// the wearer looks straight down, where the forward axis has no heading.
pub(crate) fn yaw_of(rotation: Quat) -> f32 {
    wrap(2.0 * rotation.y.atan2(rotation.w))
}

/// How well the heading is defined: 1 for a level rotation, 0 for one that is upside down.
pub(crate) fn yaw_confidence(rotation: Quat) -> f32 {
    rotation.y * rotation.y + rotation.w * rotation.w
}

/// An angle taken into -PI to PI.
pub(crate) fn wrap(angle: f32) -> f32 {
    angle - TAU * ((angle + PI) / TAU).floor()
}

/// `vector` at unit length; `fallback` where it has no direction.
pub(crate) fn direction(vector: Vec3, fallback: Vec3) -> Vec3 {
    vector.try_normalize().unwrap_or(fallback)
}

/// The unit direction of `vector` square to the unit `axis`; some square direction where that
/// vanishes.
pub(crate) fn square_to(vector: Vec3, axis: Vec3) -> Vec3 {
    direction(
        vector - axis * vector.dot(axis),
        axis.any_orthonormal_vector(),
    )
}

/// Smooth step from 0 to 1 with vanishing first and second derivatives at both ends.
pub(crate) fn min_jerk(fraction: f32) -> f32 {
    let s = fraction.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// Share of the way to its target that an exponential filter of time constant `tau` goes in `dt`.
pub(crate) fn gain(dt: f32, tau: f32) -> f32 {
    1.0 - (-dt / tau).exp()
}

/// Whether bones are those of somebody: finite, shorter than a person, arms and legs not nothing.
pub(crate) fn is_human(skeleton: &Skeleton) -> bool {
    let limbs = [
        Joint::LeftKnee,
        Joint::LeftAnkle,
        Joint::LeftElbow,
        Joint::LeftWrist,
    ];
    let long = |joint: Joint| {
        let side = |side: usize| skeleton.offsets[joint as usize + side].length() > 0.02;
        side(0) && side(1)
    };
    let short = |bone: &Vec3| bone.is_finite() && bone.abs().max_element() < 2.0;
    skeleton.offsets.iter().all(short)
        && limbs.into_iter().all(long)
        && (0.3..4.0).contains(&skeleton.head_height())
}

/// Knees and elbows bend this far, radians.
pub(crate) const BEND_MAX: f32 = 2.75;

/// A limb of two bones with a hinge between them, in its rest pose.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limb {
    /// First bone in the frame of its joint, metres.
    pub upper: Vec3,
    /// Second bone in the frame of the hinge, metres.
    pub lower: Vec3,
    /// Direction of the cross product of the two bones when the hinge bends.
    pub hinge: Vec3,
}

/// A limb brought to its goal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reached {
    /// Rotation of the first joint, joint to world.
    pub upper: Quat,
    /// Rotation of the hinge, joint to world.
    pub lower: Quat,
}

impl Limb {
    /// Length when stretched.
    pub(crate) fn length(&self) -> f32 {
        self.upper.length() + self.lower.length()
    }

    /// Distance of the limb's end from its root when bent as far as it goes.
    pub(crate) fn shortest(&self) -> f32 {
        let (a, b) = (self.upper.length(), self.lower.length());
        (a * a + b * b + 2.0 * a * b * BEND_MAX.cos())
            .max(0.0)
            .sqrt()
    }

    /// The two bones in the world that carry the limb's end from `root` to `goal`, or as near as
    /// they allow, with the hinge displaced towards `pole`.
    pub(crate) fn bones_to(&self, root: Vec3, goal: Vec3, pole: Vec3) -> (Vec3, Vec3) {
        let (a, b) = (self.upper.length(), self.lower.length());
        let to_goal = goal - root;
        let along = direction(to_goal, Vec3::NEG_Y);
        let out = square_to(pole, along);
        let distance = to_goal
            .length()
            .max(self.shortest())
            .min(a + b - 1e-5)
            .max(1e-6);
        let cosine = (a * a + distance * distance - b * b) / (2.0 * a * distance);
        let cosine = cosine.clamp(-1.0, 1.0);
        let upper = (along * cosine + out * (1.0 - cosine * cosine).sqrt()) * a;
        (upper, direction(along * distance - upper, along) * b)
    }

    /// Rotations that do so, with the hinge turning about its axis only.
    pub(crate) fn reach(&self, root: Vec3, goal: Vec3, pole: Vec3) -> Reached {
        let (upper, lower) = self.bones_to(root, goal, pole);
        let along = direction(goal - root, Vec3::NEG_Y);
        let normal = square_to(pole, along).cross(along);
        Reached {
            upper: frame(upper, normal) * frame(self.upper, self.hinge).inverse(),
            lower: frame(lower, normal) * frame(self.lower, self.hinge).inverse(),
        }
    }
}

/// The rotation whose X axis is `along` and whose Z axis is nearest to `normal`.
fn frame(along: Vec3, normal: Vec3) -> Quat {
    let x = direction(along, Vec3::X);
    let z = square_to(normal, x);
    Quat::from_mat3(&Mat3::from_cols(x, z.cross(x), z)).normalize()
}

/// The part of a rotation that turns about the unit `axis`.
pub(crate) fn twist_about(rotation: Quat, axis: Vec3) -> Quat {
    let along = Vec3::new(rotation.x, rotation.y, rotation.z).dot(axis);
    let twist = Quat::from_xyzw(axis.x * along, axis.y * along, axis.z * along, rotation.w);
    if twist.length_squared() < 1e-8 {
        Quat::IDENTITY
    } else {
        twist.normalize()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn arm() -> Limb {
        let upper = Vec3::new(-0.3, 0.0, 0.0);
        Limb {
            upper,
            lower: Vec3::new(-0.2, 0.01, 0.0),
            hinge: Vec3::NEG_Y,
        }
    }

    #[test]
    fn yaw_survives_looking_down_and_wraps() {
        let look = Quat::from_rotation_y(2.0) * Quat::from_rotation_x(-1.5);
        assert!((yaw_of(look) - 2.0).abs() < 1e-5);
        assert!(
            (yaw_of(-look) - 2.0).abs() < 1e-5,
            "q and -q are one rotation"
        );
        assert!((wrap(3.0 * PI + 0.1) + PI - 0.1).abs() < 1e-5);
        assert!(yaw_confidence(Quat::from_rotation_x(PI)) < 1e-6);
    }

    #[test]
    fn a_twist_is_the_turn_about_its_axis() {
        let turn = Quat::from_rotation_x(0.7) * Quat::from_rotation_y(0.4);
        let twist = twist_about(turn, Vec3::X);
        assert!(
            twist.angle_between(Quat::from_rotation_x(0.7)) < 0.02,
            "{twist}"
        );
    }

    proptest! {
        #[test]
        fn a_goal_within_reach_is_met_and_the_hinge_bends_forward(
            goal in prop::array::uniform3(-0.6f32..0.6),
            pole in prop::array::uniform3(-1.0f32..1.0),
        ) {
            let (limb, root, goal) = (arm(), Vec3::new(0.1, 1.4, 0.0), Vec3::from(goal));
            let distance = goal.length();
            let reached = limb.reach(root, root + goal, pole.into());
            let elbow = root + reached.upper * limb.upper;
            let end = elbow + reached.lower * limb.lower;
            let nearest = distance.clamp(limb.shortest(), limb.length());
            prop_assert!(((end - root).length() - nearest).abs() < 1e-3);
            if (limb.shortest()..limb.length()).contains(&distance) {
                prop_assert!(end.distance(root + goal) < 2e-4, "{end} {goal}");
            }
            // The hinge only turns about its axis, and never backwards.
            let local = reached.upper.inverse() * reached.lower;
            let turned = (if local.w < 0.0 { -local } else { local }).to_scaled_axis();
            prop_assert!(turned.dot(limb.hinge) > -1e-2, "{turned}");
            prop_assert!(turned.reject_from(limb.hinge).length() < 0.15, "{turned}");
        }
    }
}
