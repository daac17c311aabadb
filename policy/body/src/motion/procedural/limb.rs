//! Two-bone limbs: from where an ankle or a wrist shall be to the joints' rotations.

use glam::{DMat3, DQuat, DVec3};

/// A limb never stretches further than this share of its length: beyond, its middle joint would
/// move without bound.
const REACH: f64 = 0.995;

/// The two bones of a limb in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bones {
    /// From the root to the middle joint, unit.
    pub(super) upper: DVec3,
    /// From the middle joint to the end, unit.
    pub(super) lower: DVec3,
    /// Square to both: (end - root) x (direction in which the middle joint points).
    pub(super) normal: DVec3,
}

/// Bends a limb of these bone lengths from `root` to `end`, its middle joint towards `pole`.
pub(super) fn bend(root: DVec3, end: DVec3, lengths: [f64; 2], pole: DVec3) -> Bones {
    let [a, b] = lengths;
    let straight = end - root;
    let distance = straight
        .length()
        .clamp((a - b).abs() + 1e-3, (a + b) * REACH);
    let along = straight.normalize();
    let aside = (pole - along * pole.dot(along)).normalize();
    let cosine = (a * a + distance * distance - b * b) / (2.0 * a * distance);
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let upper = along * cosine + aside * sine;
    let lower = (along * distance - upper * a) / b;
    Bones {
        upper,
        lower: lower.normalize(),
        normal: along.cross(aside),
    }
}

/// The frame of a leg bone: -Y along the bone, X along the hinge.
pub(super) fn leg_frame(bone: DVec3, normal: DVec3) -> DQuat {
    let y = -bone;
    DQuat::from_mat3(&DMat3::from_cols(normal, y, normal.cross(y)))
}

/// The frame of an arm bone: -X (left) or X (right) along the bone, Y along the hinge.
pub(super) fn arm_frame(bone: DVec3, normal: DVec3, left: bool) -> DQuat {
    let (x, y) = if left {
        (-bone, normal)
    } else {
        (bone, -normal)
    };
    DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn frames_are_the_rest_pose_s() {
        // A leg that hangs down with the knee forward; arms stretched out with elbows back.
        let leg = bend(DVec3::ZERO, DVec3::NEG_Y * 0.7, [0.4, 0.4], DVec3::NEG_Z);
        assert!((leg.normal - DVec3::X).length() < 1e-12);
        assert!(leg_frame(DVec3::NEG_Y, leg.normal).angle_between(DQuat::IDENTITY) < 1e-6);
        for (left, out) in [(true, DVec3::NEG_X), (false, DVec3::X)] {
            let arm = bend(DVec3::ZERO, out * 0.4, [0.3, 0.3], DVec3::Z);
            let rest = arm_frame(out, arm.normal, left);
            assert!(rest.angle_between(DQuat::IDENTITY) < 1e-6, "{left}");
            // The elbow bends about -Y on the left, about +Y on the right.
            let local = arm_frame(arm.upper, arm.normal, left).conjugate()
                * arm_frame(arm.lower, arm.normal, left);
            let (axis, angle) = local.to_axis_angle();
            let expected = if left { DVec3::NEG_Y } else { DVec3::Y };
            assert!((axis * angle).dot(expected) > 0.5, "{axis} {angle}");
        }
    }

    proptest! {
        #[test]
        fn the_end_is_met_within_reach(
            direction in prop::array::uniform3(-1.0f64..1.0), distance in 0.15f64..0.75,
        ) {
            let direction = DVec3::from(direction);
            prop_assume!(direction.length() > 0.1);
            let direction = direction.normalize();
            let pole = DVec3::new(0.3, 0.2, -1.0);
            prop_assume!(direction.cross(pole).length() > 0.1);
            let end = direction * distance;
            let bones = bend(DVec3::ZERO, end, [0.42, 0.36], pole);
            let met = bones.upper * 0.42 + bones.lower * 0.36;
            prop_assert!((met - end).length() < 1e-9);
            prop_assert!(bones.upper.dot(bones.normal).abs() < 1e-9);
            prop_assert!((bones.upper * 0.42).dot(pole) >= end.dot(pole) * 0.42 / 0.78 - 0.5);
        }
    }
}
