//! The optimiser's rigid body: every joint of the skeleton a ball joint, the pelvis free.
//!
//! PIP's physics model (section 3.2.1) with the masses of de Leva's table in place of its own.

use glam::{DMat3, DVec3};

use crate::character::{LINKS, Link, Segment, segments};
use crate::skeleton::{BodyPose, JOINTS, Joint, Skeleton};

/// Generalised velocities: the pelvis's linear velocity in the world, then for each joint its
/// angular velocity against its parent (the pelvis's: against the world) in its own frame.
pub const VELOCITIES: usize = 3 + 3 * JOINTS;

/// First generalised velocity of a joint's rotation.
#[must_use]
pub(super) const fn rotation_of(joint: usize) -> usize {
    3 + 3 * joint
}

/// Rotor inertia of each joint of a person 1.75 m tall, kg m²: keeps light links at the ends of
/// the limbs from dominating the inverse of the inertia matrix.
const ARMATURE: f64 = 0.01;

/// One person's tree.
#[derive(Debug, Clone, PartialEq)]
pub struct Tree {
    /// Each joint in its parent's frame, metres.
    pub offsets: [DVec3; JOINTS],
    /// Masses of the links that the joints carry, kilograms.
    pub masses: [f64; JOINTS],
    /// Centres of mass in the joints' frames, metres.
    pub coms: [DVec3; JOINTS],
    /// Principal moments of inertia about the centre of mass along the joint's axes, kg m².
    pub inertias: [DVec3; JOINTS],
    /// Rotor inertia of each joint, kg m².
    pub armature: f64,
    /// Stature, metres.
    pub stature: f64,
}

/// Takes a share of a segment's mass to a joint of its own: the joint, the share, and where its
/// centre of mass lies between that joint and another.
struct Part {
    joint: Joint,
    share: f64,
    towards: Joint,
    along: f64,
}

const fn part(joint: Joint, share: f64, towards: Joint, along: f64) -> Part {
    Part {
        joint,
        share,
        towards,
        along,
    }
}

/// How a segment is spread over the joints of the skeleton: the main joint gets what the parts
/// leave, so that mass and centre of mass stay the segment's.
fn parts(link: Link) -> (Joint, &'static [Part]) {
    const SPINE: &[Part] = &[part(Joint::Spine1, 0.5, Joint::Spine2, 0.5)];
    const CHEST: &[Part] = &[
        part(Joint::LeftCollar, 0.08, Joint::LeftShoulder, 0.6),
        part(Joint::RightCollar, 0.08, Joint::RightShoulder, 0.6),
    ];
    const HEAD: &[Part] = &[part(Joint::Neck, 0.2, Joint::Head, 0.5)];
    const LEFT_FOOT: &[Part] = &[part(Joint::LeftFoot, 0.25, Joint::LeftAnkle, -0.2)];
    const RIGHT_FOOT: &[Part] = &[part(Joint::RightFoot, 0.25, Joint::RightAnkle, -0.2)];
    match link {
        Link::Spine => (Joint::Spine2, SPINE),
        Link::Chest => (Joint::Spine3, CHEST),
        Link::Head => (Joint::Head, HEAD),
        Link::LeftFoot => (Joint::LeftAnkle, LEFT_FOOT),
        Link::RightFoot => (Joint::RightAnkle, RIGHT_FOOT),
        _ => (link.anchor(), &[]),
    }
}

impl Tree {
    /// The tree of a person with these bones and this mass in kilograms.
    #[must_use]
    pub fn new(skeleton: &Skeleton, mass: f64) -> Self {
        let rest = skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
        let place = |joint: Joint| rest.position(joint).as_dvec3();
        let stature = f64::from(skeleton.stature());
        let mut tree = Self {
            offsets: skeleton.offsets.map(|offset| offset.as_dvec3()),
            masses: [0.0; JOINTS],
            coms: [DVec3::ZERO; JOINTS],
            inertias: [DVec3::ZERO; JOINTS],
            armature: ARMATURE * (stature / 1.75).powi(5),
            stature,
        };
        let bodies: [Segment; LINKS] = segments(skeleton, mass);
        for link in Link::ALL {
            let whole = bodies[link as usize];
            let (main, parts) = parts(link);
            let (mut share, mut moment) = (1.0, whole.com);
            for part in parts {
                let com = place(part.joint).lerp(place(part.towards), part.along);
                share -= part.share;
                moment -= part.share * com;
                tree.put(part.joint, part.share, whole, com - place(part.joint));
            }
            tree.put(main, share, whole, moment / share - place(main));
        }
        tree
    }

    fn put(&mut self, joint: Joint, share: f64, whole: Segment, com: DVec3) {
        let joint = joint as usize;
        self.masses[joint] = share * whole.mass;
        self.coms[joint] = com;
        // A shorter piece of the same girth.
        self.inertias[joint] = share * share * whole.inertia;
    }

    /// Mass of the whole body, kilograms.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.masses.iter().sum()
    }

    /// Inertia of a link about its centre of mass, for its rotation to the world.
    pub(super) fn inertia(&self, joint: usize, turn: DMat3) -> DMat3 {
        turn * DMat3::from_diagonal(self.inertias[joint]) * turn.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_segments_are_spread_without_loss() {
        let skeleton = Skeleton::of_height(1.75);
        let tree = Tree::new(&skeleton, 72.0);
        assert!((tree.mass() - 72.0).abs() < 1e-9);
        assert!(
            tree.masses.iter().all(|&mass| mass > 0.05),
            "{:?}",
            tree.masses
        );
        let rest = skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
        let com = (0..JOINTS)
            .map(|joint| tree.masses[joint] * (rest.positions[joint].as_dvec3() + tree.coms[joint]))
            .sum::<DVec3>()
            / 72.0;
        let whole = segments(&skeleton, 72.0);
        let expected = whole.iter().map(|s| s.mass * s.com).sum::<DVec3>() / 72.0;
        assert!(com.abs_diff_eq(expected, 1e-9), "{com} {expected}");
    }
}
