//! What a tick gives.

use glam::{DVec3, Vec3};

use super::dynamics::{Frames, Motion};
use super::problem::FORCE_UNIT;
use super::smoother::Target;
use super::tree::{VELOCITIES, rotation_of};
use super::{Optimiser, SUNK, motion_of};
use crate::scene::Ground;
use crate::skeleton::{BodyPose, JOINTS};

/// How a tick was solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Under all constraints.
    Full,
    /// The feet could not be held.
    FeetLoose,
    /// Neither feet nor ground could be kept to; friction was.
    GroundLoose,
    /// There was no solution, or no past: the reference itself.
    Kinematic,
    /// The reference was not sound: the last pose.
    Held,
}

/// What the ground does to a foot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FootForce {
    /// Force on the foot, N.
    pub force: Vec3,
    /// Its centre of pressure, metres; zero without force.
    pub centre: Vec3,
    /// Probability that the foot stands.
    pub contact: f32,
}

/// A solved tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solved {
    /// The pose.
    pub pose: BodyPose,
    /// Joint torques, N m, each in its joint's frame, on the child; that of the pelvis is the
    /// residual moment.
    pub torques: [Vec3; JOINTS],
    /// Residual force at the pelvis, N: what the body would need a hand from above for.
    pub residual: Vec3,
    /// Left and right foot.
    pub feet: [FootForce; 2],
    /// Force of the ground on the whole body, N.
    pub ground_force: Vec3,
    /// Zero-moment point on the plane through the lower foot's toe joint (Vukobratovic and
    /// Borovac 2004): where the ground would have to push. `None` while the body falls freely.
    pub zero_moment_point: Option<Vec3>,
    /// How it was solved.
    pub outcome: Outcome,
}

/// With less than this share of its weight carried a body is in free fall.
const FALLING: f64 = 0.1;

/// A joint may end a tick this far below the ground, metres.
const ARC_MAX: f64 = 0.002;

/// Deeper than this it is not the arc, metres: the ground rose, and the body follows in its time.
const ARC_ERROR: f64 = 0.04;

/// How far the deepest joint lies below the ground, metres; zero where none does.
fn deepest(frames: &Frames, ground: &Ground) -> f64 {
    let depth = |place: DVec3| ground.at(place.x, place.z).height - place.y;
    frames.positions.into_iter().map(depth).fold(0.0, f64::max)
}

fn body_pose(motion: &Motion) -> BodyPose {
    BodyPose {
        root: motion.root.as_vec3(),
        rotations: motion.rotations.map(|q| q.as_quat().normalize()),
    }
}

impl Solved {
    /// A pose without forces.
    fn bare(pose: BodyPose, outcome: Outcome) -> Self {
        Self {
            pose,
            torques: [Vec3::ZERO; JOINTS],
            residual: Vec3::ZERO,
            feet: [FootForce::default(); 2],
            ground_force: Vec3::ZERO,
            zero_moment_point: None,
            outcome,
        }
    }
}

impl Optimiser {
    /// The first pose after a reset: the reference, at rest, and out of the ground.
    pub(super) fn start(&mut self, mut target: Target, ground: &Ground) -> Solved {
        let frames = Frames::new(&self.tree, &motion_of(&target));
        let deepest = deepest(&frames, ground);
        if deepest > SUNK {
            self.lift = deepest;
        }
        target.root.y += deepest;
        let mut motion = motion_of(&target);
        motion.velocity = [0.0; VELOCITIES];
        self.feet.begin(&Frames::new(&self.tree, &motion), ground);
        self.motion = Some(motion);
        Solved::bare(body_pose(&motion), Outcome::Kinematic)
    }

    /// The last pose, or the rest pose where there is none.
    pub(super) fn held(&self) -> Solved {
        let pose = self
            .motion
            .as_ref()
            .map_or(BodyPose::rest(Vec3::Y), body_pose);
        Solved::bare(pose, Outcome::Held)
    }

    /// Integrates the solution and reads forces and torques off it.
    pub(super) fn finish(
        &mut self,
        mut motion: Motion,
        frames: &Frames,
        points: usize,
        outcome: Outcome,
        target: &Target,
        ground: &Ground,
    ) -> Solved {
        let x = self.solver.x();
        if outcome == Outcome::Kinematic || x.iter().any(|x| !x.is_finite()) {
            let motion = motion_of(target);
            self.motion = Some(motion);
            return Solved::bare(body_pose(&motion), Outcome::Kinematic);
        }
        let mut solved = Solved::bare(body_pose(&motion), outcome);
        let mut forces = [0.0; VELOCITIES];
        let mut weights = [0.0; 2];
        for (number, point) in self.points[..points].iter().enumerate() {
            let place = VELOCITIES + 3 * number;
            let force = point.ground * DVec3::from_slice(&x[place..place + 3]) * FORCE_UNIT;
            frames.for_each_column(point.joint, point.place, |index, column| {
                forces[index] += column.dot(force);
            });
            solved.ground_force += force.as_vec3();
            if let Some(foot) = point.foot {
                let foot = usize::from(foot);
                let weight = force.length();
                solved.feet[foot].force += force.as_vec3();
                solved.feet[foot].centre += (point.place * weight).as_vec3();
                weights[foot] += weight;
            }
        }
        for (foot, weight) in weights.into_iter().enumerate() {
            solved.feet[foot].contact = self.feet.probabilities[foot] as f32;
            if weight > 0.0 {
                solved.feet[foot].centre /= weight as f32;
            }
        }
        let needed: [f64; VELOCITIES] = std::array::from_fn(|row| {
            let inertia = &self.equation.inertia[row];
            let product: f64 = inertia.iter().zip(x).map(|(m, a)| m * a).sum();
            product + self.equation.bias[row]
        });
        let torque = |index: usize| needed[index] - forces[index];
        solved.residual = DVec3::from_array([0, 1, 2].map(torque)).as_vec3();
        for joint in 0..JOINTS {
            let place = rotation_of(joint);
            let axes = [place, place + 1, place + 2];
            solved.torques[joint] = DVec3::from_array(axes.map(torque)).as_vec3();
        }
        solved.zero_moment_point = self.zero_moment_point(frames, &needed);
        motion.advance(&x[..VELOCITIES], self.tick);
        self.lift_out(&mut motion, ground);
        self.motion = Some(motion);
        solved.pose = body_pose(&motion);
        solved
    }

    /// The program keeps joints out of the ground along straight lines; one that swings fast
    /// moves on an arc and may end a little below. The whole body is raised by that little.
    fn lift_out(&self, motion: &mut Motion, ground: &Ground) {
        let deepest = deepest(&Frames::new(&self.tree, motion), ground);
        if (ARC_MAX..ARC_ERROR).contains(&deepest) {
            motion.root.y += deepest - ARC_MAX;
        }
    }

    /// Where the wrench that the motion needs at the pelvis has no horizontal moment.
    fn zero_moment_point(&self, frames: &Frames, needed: &[f64; VELOCITIES]) -> Option<Vec3> {
        let force = DVec3::from_slice(&needed[..3]);
        if force.y < FALLING * self.mass() * crate::simulation::GRAVITY {
            return None;
        }
        let moment = frames.turns[0] * DVec3::from_slice(&needed[3..6]);
        let [left, right] = super::FEET.map(|(_, toe)| frames.positions[toe as usize].y);
        let floor = left.min(right) - self.feet.clearance();
        let pelvis = frames.positions[0];
        let height = pelvis.y - floor;
        let x = pelvis.x - (height * force.x - moment.z) / force.y;
        let z = pelvis.z - (moment.x + height * force.z) / force.y;
        Some(DVec3::new(x, floor, z).as_vec3())
    }
}
