//! The physics character of QuestSim (section 3.3): sixteen links and thirty-three hinges on a
//! free pelvis, built for one person.
//!
//! Lengths follow the wearer's bones; masses, torque limits, damping and rotor inertia follow
//! the stature s by dynamic similarity under the same gravity: lengths s, masses s³, inertias
//! s⁵, torques s⁴, damping s^4.5.

mod anthropometry;
mod hinges;
mod kinematics;
mod mjcf;

use glam::DVec3;

pub use anthropometry::{
    ANKLE_OVER_STATURE, FOOT_OVER_STATURE, HEEL_BEHIND_ANKLE, REFERENCE_MASS, REFERENCE_STATURE,
    Segment, average_mass, segments,
};
pub use hinges::{ARMATURE, HINGE_TABLE, Hinge, Link, hinges_of};
pub use kinematics::{CharacterPose, LinkFrames};
pub(crate) use mjcf::{put, triple};
pub use mjcf::{write_actuators, write_body};

use crate::skeleton::{BodyPose, JOINTS, Joint, Skeleton};

/// Number of links.
pub const LINKS: usize = 16;
/// Number of hinges.
pub const HINGES: usize = 33;

/// The least and the greatest stature that a character can be built for, metres.
pub const STATURES: [f64; 2] = [1.2, 2.2];

/// Why a character cannot be built.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CharacterError {
    /// The skeleton's stature is outside [`STATURES`] or not a number.
    #[error("a stature of {0:.2} m is outside 1.2 to 2.2 m; check the configured height")]
    Stature(f64),
    /// The mass is not between 10 and 300 kg.
    #[error("a mass of {0:.1} kg is outside 10 to 300 kg; check the configured mass")]
    Mass(f64),
}

/// A rigid link of one person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkBody {
    /// The joint it turns about, in its parent's frame, metres; zero for the pelvis.
    pub offset: DVec3,
    /// Mass, kilograms.
    pub mass: f64,
    /// Centre of mass in the link's frame, metres.
    pub com: DVec3,
    /// Principal moments of inertia about the centre of mass along the link's axes, kg m².
    pub inertia: DVec3,
}

/// The sole in the frame of a foot link, whose origin is the ankle joint; metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sole {
    /// Height of the sole's plane: negative, below the ankle.
    pub y: f64,
    /// The heel's end, along z: positive, behind the ankle.
    pub heel: f64,
    /// The ball of the foot, along z: negative, in front of the ankle.
    pub ball: f64,
    /// The tip of the toes, along z.
    pub tip: f64,
    /// Half the foot's width at the ball.
    pub half_width: f64,
}

/// The character of one person.
#[derive(Debug, Clone, PartialEq)]
pub struct Character {
    /// Stature, metres.
    pub stature: f64,
    /// Links, in [`Link`]'s order.
    pub links: [LinkBody; LINKS],
    /// Hinges, in the order of [`HINGE_TABLE`], with torque and damping of this person.
    pub hinges: [Hinge; HINGES],
    /// Rotor inertia of every hinge, kg m².
    pub armature: f64,
    /// Each joint of the skeleton: the link that carries it and its place in that link's frame.
    pub joints: [(Link, DVec3); JOINTS],
    /// The soles, left and right.
    pub soles: [Sole; 2],
    /// Bone offsets of the person.
    pub skeleton: Skeleton,
}

/// The link that carries a joint of the skeleton.
#[must_use]
pub fn carrier(joint: Joint) -> Link {
    match joint {
        Joint::Pelvis => Link::Pelvis,
        Joint::LeftHip => Link::LeftThigh,
        Joint::RightHip => Link::RightThigh,
        Joint::Spine1 | Joint::Spine2 => Link::Spine,
        Joint::Spine3 | Joint::LeftCollar | Joint::RightCollar => Link::Chest,
        Joint::Neck | Joint::Head => Link::Head,
        Joint::LeftKnee => Link::LeftShank,
        Joint::RightKnee => Link::RightShank,
        Joint::LeftAnkle | Joint::LeftFoot => Link::LeftFoot,
        Joint::RightAnkle | Joint::RightFoot => Link::RightFoot,
        Joint::LeftShoulder => Link::LeftUpperArm,
        Joint::RightShoulder => Link::RightUpperArm,
        Joint::LeftElbow => Link::LeftForearm,
        Joint::RightElbow => Link::RightForearm,
        Joint::LeftWrist => Link::LeftHand,
        Joint::RightWrist => Link::RightHand,
    }
}

impl Character {
    /// The character of an average person, `stature` metres tall.
    ///
    /// # Errors
    /// When the stature is out of range.
    pub fn of_height(stature: f64) -> Result<Self, CharacterError> {
        Self::new(&Skeleton::of_height(stature as f32), None)
    }

    /// The character of a person with these bones and this mass in kilograms, the average one
    /// where none is given.
    ///
    /// # Errors
    /// When stature or mass are out of range.
    pub fn new(skeleton: &Skeleton, mass: Option<f64>) -> Result<Self, CharacterError> {
        let stature = f64::from(skeleton.stature());
        // A little slack for the rounding of single precision.
        if !(STATURES[0] - 1e-4..=STATURES[1] + 1e-4).contains(&stature) {
            return Err(CharacterError::Stature(stature));
        }
        let mass = mass.unwrap_or_else(|| average_mass(stature));
        if !(10.0..=300.0).contains(&mass) {
            return Err(CharacterError::Mass(mass));
        }
        let rest = skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
        let place = |joint: Joint| rest.position(joint).as_dvec3();
        let bodies = segments(skeleton, mass);
        let links = Link::ALL.map(|link| {
            let segment = bodies[link as usize];
            let parent = link
                .parent()
                .map_or(DVec3::ZERO, |parent| place(parent.anchor()));
            LinkBody {
                offset: place(link.anchor()) - parent,
                mass: segment.mass,
                com: segment.com - place(link.anchor()),
                inertia: segment.inertia,
            }
        });
        let joints = Joint::ALL.map(|joint| {
            (
                carrier(joint),
                place(joint) - place(carrier(joint).anchor()),
            )
        });
        let s = stature / REFERENCE_STATURE;
        let hinges = HINGE_TABLE.map(|hinge| Hinge {
            torque: hinge.torque * s.powi(4),
            damping: hinge.damping * s.powf(4.5),
            ..hinge
        });
        let soles = [Joint::LeftFoot, Joint::RightFoot]
            .map(|toe| Sole::new(stature, joints[toe as usize].1));
        Ok(Self {
            stature,
            links,
            hinges,
            armature: ARMATURE * s.powi(5),
            joints,
            soles,
            skeleton: *skeleton,
        })
    }

    /// Mass, kilograms.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.links.iter().map(|link| link.mass).sum()
    }

    /// Height of the pelvis joint above the ground when the person stands in the rest pose,
    /// metres.
    #[must_use]
    pub fn standing_height(&self) -> f64 {
        let rest = self.skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
        let sole = |ankle: Joint, sole: &Sole| f64::from(rest.position(ankle).y) + sole.y;
        let left = sole(Joint::LeftAnkle, &self.soles[0]);
        -left.min(sole(Joint::RightAnkle, &self.soles[1]))
    }
}

impl Sole {
    /// The sole of a foot whose toe joint lies at `toe` from the ankle.
    #[must_use]
    pub fn new(stature: f64, toe: DVec3) -> Self {
        let length = FOOT_OVER_STATURE * stature;
        let heel = HEEL_BEHIND_ANKLE * length;
        // Rigs differ in where they put the toe joint; the sole is always below it.
        let y = (-ANKLE_OVER_STATURE * stature).min(toe.y - 0.007 * stature);
        let tip = (heel - length).min(toe.z - 0.02 * stature);
        Self {
            y,
            heel,
            ball: toe.z,
            tip,
            half_width: 0.027 * stature,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_character_of_every_height() {
        for stature in [1.2, 1.4, 1.75, 2.0, 2.2] {
            let character = Character::of_height(stature).expect("a stature in range");
            let s = stature / 1.75;
            assert!((character.mass() - 72.0 * s.powi(3)).abs() < 0.02 * s.powi(3));
            // The pelvis joint of the proportions lies 10 cm above the hips: 0.62 of stature.
            assert!((0.55..0.65).contains(&(character.standing_height() / stature)));
            for link in &character.links {
                let [a, b, c] = link.inertia.to_array();
                assert!(
                    link.mass > 0.0 && a + b > c && b + c > a && c + a > b,
                    "{link:?}"
                );
            }
        }
    }

    #[test]
    fn statures_and_masses_out_of_range_are_refused() {
        assert!(matches!(
            Character::of_height(1.0),
            Err(CharacterError::Stature(_))
        ));
        assert!(matches!(
            Character::of_height(f64::NAN),
            Err(CharacterError::Stature(_))
        ));
        let skeleton = Skeleton::of_height(1.75);
        assert!(matches!(
            Character::new(&skeleton, Some(5.0)),
            Err(CharacterError::Mass(_))
        ));
    }
}
