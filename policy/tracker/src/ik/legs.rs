//! Legs between the hips and feet on the floor.

use glam::{Quat, Vec3};
use posed_body::{Joint, Skeleton};

use super::{steps::Footing, toe_height};
use crate::geometry::{Limb, direction};

/// How far a heel can rise over the toes, radians.
const HEEL_MAX: f32 = 1.0;
/// A standing knee is never quite straight: share of the leg's length that may be used.
const STRETCH: f32 = 0.9995;

/// One leg's bones.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Leg {
    limb: Limb,
    /// Hip in the pelvis' frame.
    hip: Vec3,
    /// Toe joint in the ankle's frame.
    toe: Vec3,
    toe_height: f32,
}

/// Rotations of a leg's joints, joint to world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LegPose {
    pub hip: Quat,
    pub knee: Quat,
    pub ankle: Quat,
    pub toe: Quat,
}

impl Leg {
    /// Left (0) or right (1).
    pub(crate) fn new(skeleton: &Skeleton, side: usize) -> Self {
        let bone = |joint: Joint| skeleton.offsets[joint as usize + side];
        Self {
            limb: Limb {
                upper: bone(Joint::LeftKnee),
                lower: bone(Joint::LeftAnkle),
                hinge: Vec3::NEG_X,
            },
            hip: bone(Joint::LeftHip),
            toe: bone(Joint::LeftFoot),
            toe_height: toe_height(skeleton),
        }
    }

    /// Length of thigh and shank together, metres.
    pub(crate) fn length(&self) -> f32 {
        self.limb.length()
    }

    /// How far a flat foot on the floor is out of the leg's reach, metres.
    pub(crate) fn overstretch(&self, root: Vec3, pelvis: Quat, footing: &Footing) -> f32 {
        let (toe, heading) = self.toe_on_floor(footing);
        let ankle = toe - heading * (Quat::from_rotation_x(-HEEL_MAX) * self.toe);
        (ankle - self.hip_at(root, pelvis)).length() - self.length()
    }

    fn hip_at(&self, root: Vec3, pelvis: Quat) -> Vec3 {
        root + pelvis * self.hip
    }

    /// The toe joint when it touches the floor there, and the foot's heading.
    fn toe_on_floor(&self, footing: &Footing) -> (Vec3, Quat) {
        let heading = Quat::from_rotation_y(footing.ground.yaw);
        let half = Vec3::new(self.toe.x, 0.0, self.toe.z) * 0.5;
        let place = footing.ground.position + heading * half;
        (place + Vec3::Y * self.toe_height, heading)
    }

    /// Moves an ankle that is too near to its hip for the knee out along the floor.
    fn unfold(&self, hip: Vec3, ankle: Vec3, heading: Quat) -> Vec3 {
        let least = self.limb.shortest();
        let offset = ankle - hip;
        if offset.length() >= least {
            return ankle;
        }
        let level = Vec3::new(offset.x, 0.0, offset.z) + heading * Vec3::NEG_Z * (0.1 * least);
        let out = direction(level, Vec3::NEG_Z);
        let far = (least * least - offset.y * offset.y).max(0.0).sqrt();
        hip + out * far + Vec3::Y * offset.y
    }

    /// The leg with its foot as near to `footing` as it reaches.
    pub(crate) fn solve(&self, root: Vec3, pelvis: Quat, footing: &Footing) -> LegPose {
        let hip = self.hip_at(root, pelvis);
        let (toe, heading) = self.toe_on_floor(footing);
        let toe = toe + Vec3::Y * footing.lift;
        let reach = self.length() * STRETCH;
        let ankle_at = |pitch: f32| toe - heading * (Quat::from_rotation_x(-pitch) * self.toe);
        let pitch = heel_rise(footing.pitch, |pitch| {
            ankle_at(pitch).distance(hip) <= reach
        });
        let foot = heading * Quat::from_rotation_x(-pitch);
        let ankle = ankle_at(pitch);
        let goal = hip + (ankle - hip).clamp_length_max(reach);
        // A leg too short to reach leaves the floor, and must not go through it either.
        let floor = self.toe_height - (foot * self.toe).y;
        let goal = Vec3::new(goal.x, goal.y.max(floor.min(hip.y)), goal.z);
        let goal = self.unfold(hip, goal, heading);
        let knees = direction(
            heading * Vec3::NEG_Z + pelvis * Vec3::NEG_Z,
            heading * Vec3::NEG_Z,
        );
        let solved = self.limb.reach(hip, goal, knees);
        let flat = if footing.planted { heading } else { foot };
        LegPose {
            hip: solved.upper,
            knee: solved.lower,
            ankle: foot,
            toe: flat,
        }
    }
}

/// The least rise of the heel, from `least` on, with which the leg reaches; the greatest where
/// none does.
fn heel_rise(least: f32, reaches: impl Fn(f32) -> bool) -> f32 {
    if reaches(least) || least >= HEEL_MAX {
        return least;
    }
    if !reaches(HEEL_MAX) {
        return HEEL_MAX;
    }
    let (mut low, mut high) = (least, HEEL_MAX);
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if reaches(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ik::steps::Ground;

    fn standing(x: f32) -> Footing {
        let ground = Ground {
            position: Vec3::new(x, 0.0, 0.0),
            yaw: 0.0,
        };
        Footing {
            ground,
            lift: 0.0,
            pitch: 0.0,
            planted: true,
        }
    }

    /// Hip, ankle and toe joint in the world.
    fn joints(leg: &Leg, root: Vec3, pose: &LegPose) -> (Vec3, Vec3, Vec3) {
        let hip = root + leg.hip;
        let ankle = hip + pose.hip * leg.limb.upper + pose.knee * leg.limb.lower;
        (hip, ankle, ankle + pose.ankle * leg.toe)
    }

    #[test]
    fn the_toe_stays_on_the_floor_until_the_leg_is_too_short() {
        let skeleton = Skeleton::of_height(1.75);
        let leg = Leg::new(&skeleton, 0);
        let footing = standing(-0.1);
        let (wanted, _) = leg.toe_on_floor(&footing);
        let mut heel_before = 0.0;
        for step in 0..60 {
            let root = Vec3::new(0.0, 0.6 + 0.006 * step as f32, 0.0);
            let pose = leg.solve(root, Quat::IDENTITY, &footing);
            let (_, ankle, toe) = joints(&leg, root, &pose);
            assert!(toe.distance(wanted) < 2e-3, "pelvis at {}: {toe}", root.y);
            assert!(
                ankle.y >= heel_before - 1e-4,
                "the heel rises and never falls back"
            );
            heel_before = ankle.y;
            // Knees bend forward.
            let knee = leg.hip + root + pose.hip * leg.limb.upper;
            assert!(knee.z < ankle.z.max(root.z) + 0.02);
        }
        let pose = leg.solve(Vec3::Y * 1.2, Quat::IDENTITY, &footing);
        let (_, _, toe) = joints(&leg, Vec3::Y * 1.2, &pose);
        assert!(toe.y > leg.toe_height + 0.05, "in the air");
    }

    #[test]
    fn nothing_goes_through_the_floor() {
        let skeleton = Skeleton::of_height(1.6);
        for side in 0..2 {
            let leg = Leg::new(&skeleton, side);
            for step in 0..40 {
                let root = Vec3::new(0.02 * step as f32, 0.12 + 0.02 * step as f32, 0.1);
                let pose = leg.solve(root, Quat::IDENTITY, &standing(0.3));
                let (_, ankle, toe) = joints(&leg, root, &pose);
                assert!(toe.y > leg.toe_height - 2e-3, "{toe}");
                assert!(ankle.y > leg.toe_height - 2e-3, "{ankle}");
            }
        }
    }
}
