//! The room that a body takes up, as capsules between joints: enough to tell what it hides.

use glam::DVec3;

use super::trajectory::Trajectory;
use crate::skeleton::Joint;

/// A capsule between two joints, or beyond the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limb {
    /// Where its axis begins.
    pub from: Joint,
    /// The joint that its axis points to.
    pub to: Joint,
    /// How far the axis goes: 1 ends at the second joint.
    pub reach: f64,
    /// Over the wearer's stature.
    radius: f64,
}

const fn limb(from: Joint, to: Joint, reach: f64, radius: f64) -> Limb {
    Limb {
        from,
        to,
        reach,
        radius,
    }
}

/// Trunk, head, arms without hands, and legs; radii after the circumferences of adults.
pub const LIMBS: [Limb; 10] = [
    limb(Joint::Pelvis, Joint::Neck, 0.9, 0.075),
    limb(Joint::Neck, Joint::Head, 1.5, 0.045),
    limb(Joint::LeftShoulder, Joint::LeftElbow, 1.0, 0.027),
    limb(Joint::RightShoulder, Joint::RightElbow, 1.0, 0.027),
    limb(Joint::LeftElbow, Joint::LeftWrist, 0.75, 0.022),
    limb(Joint::RightElbow, Joint::RightWrist, 0.75, 0.022),
    limb(Joint::LeftHip, Joint::LeftKnee, 1.0, 0.045),
    limb(Joint::RightHip, Joint::RightKnee, 1.0, 0.045),
    limb(Joint::LeftKnee, Joint::LeftAnkle, 1.0, 0.03),
    limb(Joint::RightKnee, Joint::RightAnkle, 1.0, 0.03),
];

impl Limb {
    /// The ends of its axis at a time in seconds, metres.
    #[must_use]
    pub fn axis(&self, trajectory: &Trajectory, seconds: f64) -> [DVec3; 2] {
        let from = trajectory.joint(self.from, seconds).position;
        let to = trajectory.joint(self.to, seconds).position;
        [from, from.lerp(to, self.reach)]
    }

    /// Metres, for a wearer of this stature.
    #[must_use]
    pub fn radius(&self, stature: f64) -> f64 {
        self.radius * stature
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::procedural;

    #[test]
    fn limbs_follow_the_body() {
        let trajectory = Trajectory::new(&procedural::timeline(1.75, 1));
        for limb in LIMBS {
            for t in [0.0, 7.5, 20.0] {
                let [from, to] = limb.axis(&trajectory, t);
                assert!((0.05..0.7).contains(&from.distance(to)), "{limb:?}");
                let wrist = trajectory.joint(Joint::LeftWrist, t).position;
                assert!(
                    wrist.distance(to) > limb.radius(1.75),
                    "{limb:?} around the wrist"
                );
            }
        }
    }
}
