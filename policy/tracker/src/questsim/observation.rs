//! The policy's observation: 312 numbers of the character, 162 of the user, and the stature.
//!
//! The same as `policy/training/questsim/observation.py`, where the order is described; golden
//! vectors hold both to it (QuestSim, sections 3.3, 3.5 and 3.6).

use glam::{DMat3, DQuat, DVec3};
use posed_body::character::{Character, CharacterPose, HINGES, LINKS, Link, hinges_of};

/// Policy steps a second.
pub const RATE_HZ: f64 = 36.0;
/// Physics steps to a policy step.
pub const SUBSTEPS: usize = 4;
/// Frames of the user that the policy sees.
pub const FUTURE: usize = 6;
/// Parts of the user: head, left and right wrist.
pub const PARTS: usize = 3;
/// Numbers in an observation.
pub const SIZE: usize = 475;
/// Velocities of the character's coordinates: six of the pelvis, then the hinges.
pub const VELOCITIES: usize = 6 + HINGES;
/// A velocity that is carried beyond the newest frame decays with this time constant, seconds.
const CARRY_S: f64 = 0.2;

/// Where a part is: metres in the world, and its rotation to the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Metres.
    pub position: DVec3,
    /// Unit.
    pub rotation: DQuat,
}

impl Part {
    /// `ahead` frames after `self`, which was `before` one frame earlier: its velocities decay.
    #[must_use]
    pub fn carried(&self, before: &Self, ahead: usize) -> Self {
        let seconds = ahead as f64 / RATE_HZ;
        let span = CARRY_S * (1.0 - (-seconds / CARRY_S).exp());
        let turn = self.rotation * before.rotation.inverse();
        let turn = if turn.w < 0.0 { -turn } else { turn };
        let spin = turn.to_scaled_axis() * RATE_HZ;
        Self {
            position: self.position + (self.position - before.position) * RATE_HZ * span,
            rotation: (DQuat::from_scaled_axis(spin * span) * self.rotation).normalize(),
        }
    }
}

/// The parts of the user at one time.
pub type User = [Part; PARTS];

/// What an observation is made of.
#[derive(Debug)]
pub struct Seen<'a> {
    /// The character.
    pub character: &'a Character,
    /// Where it is.
    pub pose: &'a CharacterPose,
    /// How it moves, in MuJoCo's order: pelvis linear in the world, angular in its own frame.
    pub velocity: &'a [f64; VELOCITIES],
    /// Forces on the left and the right foot in the world, N.
    pub feet: [DVec3; 2],
    /// Height of the ground under the character, metres: the user stands on a level one.
    pub floor: f64,
    /// The six frames to come.
    pub user: &'a [User; FUTURE],
    /// Whether the controllers are there; zeros stand for them otherwise.
    pub hands: bool,
}

/// Linear and angular velocity of a link's joint in the world.
type Twist = [DVec3; 2];

impl Seen<'_> {
    /// Writes the observation into `out`, which holds [`SIZE`] numbers.
    pub fn write(&self, out: &mut [f32]) {
        let frames = self.character.forward(self.pose);
        let twists = self.twists(&frames.positions, &frames.rotations, &frames.axes);
        let pelvis = DMat3::from_quat(frames.rotations[Link::Pelvis as usize]);
        let level = frames.positions[Link::Pelvis as usize] * DVec3::new(1.0, 0.0, 1.0);
        let origin = level + DVec3::Y * self.floor;
        let into = DMat3::from_rotation_y(-heading(&pelvis));
        let mut next = Writer { out, at: 0 };
        next.all(self.pose.angles);
        next.all(self.velocity[6..].iter().copied());
        for position in frames.positions {
            next.vector(into * (position - origin));
        }
        for rotation in frames.rotations {
            next.six(&(into * DMat3::from_quat(rotation)));
        }
        for force in self.feet {
            next.vector(into * force);
        }
        for part in [0, 1] {
            for twist in &twists {
                next.vector(into * twist[part]);
            }
        }
        for frame in self.user {
            for (index, part) in frame.iter().enumerate() {
                if index > 0 && !self.hands {
                    next.all([0.0; 9]);
                    continue;
                }
                next.vector(into * (part.position - level));
                next.six(&(into * DMat3::from_quat(part.rotation)));
            }
        }
        next.all([self.character.stature]);
    }

    fn twists(
        &self,
        positions: &[DVec3; LINKS],
        rotations: &[DQuat; LINKS],
        axes: &[DVec3; HINGES],
    ) -> [Twist; LINKS] {
        let mut twists = [[DVec3::ZERO; 2]; LINKS];
        twists[0] = [
            DVec3::from_slice(&self.velocity[..3]),
            rotations[0] * DVec3::from_slice(&self.velocity[3..6]),
        ];
        for link in Link::ALL {
            let Some(parent) = link.parent() else {
                continue;
            };
            let [linear, angular] = twists[parent as usize];
            let arm = positions[link as usize] - positions[parent as usize];
            let own = hinges_of(link).map(|hinge| axes[hinge] * self.velocity[6 + hinge]);
            twists[link as usize] = [
                linear + angular.cross(arm),
                own.fold(angular, |sum, spin| sum + spin),
            ];
        }
        twists
    }
}

/// Heading of a rotation: its twist about +Y, radians.
fn heading(rotation: &DMat3) -> f64 {
    let [x, z] = [rotation.x_axis, rotation.z_axis];
    (z.x - x.z).atan2(x.x + z.z)
}

struct Writer<'a> {
    out: &'a mut [f32],
    at: usize,
}

impl Writer<'_> {
    fn all(&mut self, numbers: impl IntoIterator<Item = f64>) {
        for number in numbers {
            if let Some(slot) = self.out.get_mut(self.at) {
                *slot = number as f32;
            }
            self.at += 1;
        }
    }

    fn vector(&mut self, v: DVec3) {
        self.all(v.to_array());
    }

    fn six(&mut self, rotation: &DMat3) {
        self.vector(rotation.x_axis);
        self.vector(rotation.y_axis);
    }
}
