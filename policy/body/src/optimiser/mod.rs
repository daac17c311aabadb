//! The physics optimiser of PIP (Yi et al. 2022, section 3.2): takes the poses of any tracker as
//! the reference and gives a motion that obeys the equation of motion, with joint torques and
//! ground reaction forces.
//!
//! Each tick a dual controller (joint rotations and joint positions) asks for accelerations; a
//! quadratic program finds those that come closest under friction cones, feet that do not slide
//! and a ground that is not entered; integrating them gives the pose. As in the authors' code
//! and unlike the paper: the friction pyramid lies inside the cone; feet are always bound, the
//! tighter the likelier they stand; the ground is not entered at the end of the tick;
//! integration is semi-implicit. Unlike both: rotations live on the manifold, not in Euler
//! angles; torques are eliminated; masses are anthropometric; controllers have the reference's
//! velocity as feed-forward; contact points lie under heel and toes.

mod contact;
mod dynamics;
mod output;
mod plant;
mod problem;
mod smoother;
mod tree;

use glam::{DQuat, DVec3, Vec3};

pub use contact::{Feet, Point};
pub use dynamics::{Equation, Frames, Motion};
pub use output::{FootForce, Outcome, Solved};
pub use smoother::{Smoother, Target};
pub use tree::{Tree, VELOCITIES};

use crate::qp::{Problem, Solver, Status};
use crate::scene::Ground;
use crate::skeleton::{BodyPose, JOINTS, Skeleton};
use contact::{FEET, POINTS_MAX};
use plant::Plant;
use problem::{Pattern, ROWS_MAX, UNKNOWNS_MAX, Wish};
use smoother::difference;

/// Weights and gains.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Share of a position or rotation error that the controllers take back within one tick.
    /// PIP's gains are 2/3 for rotations and 1 for positions (k_p 2400 and 3600, k_d 60, at
    /// 60 Hz); with the reference's velocity fed forward a softer spring loses nothing on a clean
    /// stream and gives way to the ground more gently.
    pub stiffness: f64,
    /// Weight of squared angular accelerations, per (rad/s²)².
    pub rotation: f64,
    /// Weight of squared linear accelerations, per (m/s²)².
    pub position: f64,
    /// Share of `position` for each joint.
    pub position_shares: [f64; JOINTS],
    /// Weight of the squared residual force and moment at the pelvis, per N² and (N m)².
    pub residual: f64,
    /// Weight of squared joint torques, per (N m)².
    pub torque: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Accelerations that the reference may well have: pelvis m/s², joints rad/s². Where the
    /// stream is noisy, the less is expected the more is smoothed.
    pub manoeuvre: [f64; 2],
    /// Time in which a standing foot gives way to a reference that has moved on, seconds.
    pub creep: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            stiffness: 0.45,
            rotation: 1.0,
            position: 1.0,
            position_shares: [1.0; JOINTS],
            residual: 0.01,
            torque: 1e-4,
            friction: 0.6,
            manoeuvre: [14.0, 80.0],
            creep: 0.25,
        }
    }
}

/// What a tracker says of one tick.
#[derive(Debug, Clone, Copy)]
pub struct Reference<'a> {
    /// The kinematic pose.
    pub pose: &'a BodyPose,
    /// Joint velocities in the world, m/s, of a tracker that knows no positions in the world
    /// (PIP): the pose's root then does not count and the root comes from the velocities.
    pub velocities: Option<&'a [Vec3; JOINTS]>,
    /// Probability that the left and the right foot stand, of a tracker that estimates it.
    pub contacts: Option<[f32; 2]>,
}

/// A reference further than this from the body, metres, is a jump: the body goes there at once.
const JUMP: f64 = 0.5;
/// A first pose deeper in the ground than this, metres, comes from a tracker that is wrong about
/// the floor: all of its poses are lifted.
const SUNK: f64 = 0.1;
/// Joints other than the feet are kept out of the ground from this height on, metres.
const NEAR: f64 = 0.15;
/// Fastest way out of the ground, m/s.
const RISE_MAX: f64 = 1.5;
/// Least bound on the speed of a standing foot, m/s.
const SLIDE_MIN: f64 = 1e-3;
/// A foot whose bound is looser than this, m/s, is not bound at all.
const SLIDE_MAX: f64 = 3.0;

/// The optimiser of one person.
#[derive(Debug, Clone)]
pub struct Optimiser {
    settings: Settings,
    tick: f64,
    tree: Tree,
    pattern: Pattern,
    smoother: Smoother,
    feet: Feet,
    plant: Plant,
    motion: Option<Motion>,
    /// How far the reference is lifted, metres.
    lift: f64,
    equation: Equation,
    problem: Problem,
    solver: Solver,
    guess: Vec<usize>,
    /// Number of unknowns that `guess` belongs to.
    guess_unknowns: usize,
    points: [Point; POINTS_MAX],
}

impl Optimiser {
    /// An optimiser for a person with these bones and this mass (kilograms), called once every
    /// `tick` seconds.
    #[must_use]
    pub fn new(skeleton: &Skeleton, mass: f64, tick: f64, settings: Settings) -> Self {
        Self {
            tick,
            tree: Tree::new(skeleton, mass),
            pattern: Pattern::new(),
            smoother: Smoother::new(tick, settings.manoeuvre),
            feet: Feet::new(skeleton),
            plant: Plant::default(),
            motion: None,
            lift: 0.0,
            equation: Equation::default(),
            problem: Problem::with_capacity(UNKNOWNS_MAX, ROWS_MAX),
            solver: Solver::new(UNKNOWNS_MAX, ROWS_MAX),
            guess: Vec::with_capacity(UNKNOWNS_MAX),
            guess_unknowns: 0,
            points: [Point::default(); POINTS_MAX],
            settings,
        }
    }

    /// From now on another person, of whom nothing is known yet. Does not allocate.
    pub fn wear(&mut self, skeleton: &Skeleton, mass: f64) {
        self.tree = Tree::new(skeleton, mass);
        self.feet = Feet::new(skeleton);
        self.reset();
    }

    /// Forgets the past: the next reference is taken over as it is.
    pub fn reset(&mut self) {
        self.smoother.reset();
        self.feet.reset();
        self.plant.reset();
        self.motion = None;
        self.lift = 0.0;
        self.guess.clear();
    }

    /// Mass of the person, kilograms.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.tree.mass()
    }

    /// The quadratic program of the last tick, for comparison with other solvers.
    #[must_use]
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// Moves the body on by one tick. Neither allocates nor fails: a reference that is not sound
    /// is answered with the last pose, a problem without a solution by loosening the feet.
    pub fn step(&mut self, reference: &Reference<'_>, ground: &Ground) -> Solved {
        let velocities = reference.velocities;
        let finite = velocities.is_none_or(|all| all.iter().all(|v| v.is_finite()));
        if !reference.pose.is_sound() || !finite {
            return self.held();
        }
        let mut target = self.smoother.update(reference.pose);
        let Some(motion) = self.motion else {
            return self.start(target, ground);
        };
        target.root.y += self.lift;
        if let Some(velocities) = velocities {
            target.root_velocity = velocities[0].as_dvec3();
            target.root = motion.root + target.root_velocity * self.tick;
        }
        if target.root.distance(motion.root) > JUMP {
            self.reset();
            let target = self.smoother.update(reference.pose);
            return self.start(target, ground);
        }
        let mut wanted = Frames::new(&self.tree, &motion_of(&target));
        self.feet
            .update(reference.contacts, &wanted, ground, self.tick);
        if velocities.is_none() {
            let standing = self.feet.probabilities;
            self.plant.apply(&mut target, &wanted, standing, self.tick);
            wanted = Frames::new(&self.tree, &motion_of(&target));
        }
        let frames = Frames::new(&self.tree, &motion);
        self.equation.update(&self.tree, &frames);
        let wish = self.wish(&motion, &frames, &target, &wanted, velocities);
        let count = self
            .feet
            .points(&frames, &self.tree, ground, &mut self.points);
        problem::fill_objective(
            &mut self.problem,
            &self.settings,
            &self.pattern,
            &self.equation,
            &frames,
            &wish,
            &self.points[..count],
        );
        problem::add_friction(&mut self.problem, self.settings.friction, count);
        let outcome = self.solve(&frames, &wanted, ground);
        self.finish(motion, &frames, count, outcome, &target, ground)
    }

    /// The dual controller: accelerations after which, one tick later, the velocities are the
    /// reference's and part of the error in position is gone.
    fn wish(
        &self,
        motion: &Motion,
        frames: &Frames,
        target: &Target,
        wanted: &Frames,
        velocities: Option<&[Vec3; JOINTS]>,
    ) -> Wish {
        let (tick, share) = (self.tick, self.settings.stiffness);
        let angular = |joint: usize| {
            let apart = difference(motion.rotations[joint], target.rotations[joint]);
            let rate = DQuat::from_scaled_axis(apart) * target.angular[joint];
            let error = apart - rate * tick;
            (rate + error * (share / tick) - motion.angular(joint)) / tick
        };
        let linear = |joint: usize| {
            let (rate, error) = match velocities {
                Some(velocities) => (velocities[joint].as_dvec3(), DVec3::ZERO),
                None => {
                    let rate = wanted.velocities[joint];
                    (
                        rate,
                        wanted.positions[joint] - frames.positions[joint] - rate * tick,
                    )
                }
            };
            (rate + error * (share / tick) - frames.velocities[joint]) / tick
        };
        Wish {
            angular: std::array::from_fn(angular),
            linear: std::array::from_fn(linear),
        }
    }

    /// Adds the rows on velocities and solves, with fewer of them where all cannot hold.
    fn solve(&mut self, frames: &Frames, wanted: &Frames, ground: &Ground) -> Outcome {
        let friction_rows = self.problem.constraints();
        self.add_ground(frames, ground);
        let ground_rows = self.problem.constraints();
        self.add_standing(frames, wanted, ground);
        if self.guess_unknowns != self.problem.unknowns() {
            self.guess.clear();
        }
        self.guess_unknowns = self.problem.unknowns();
        let attempts = [
            (self.problem.constraints(), Outcome::Full),
            (ground_rows, Outcome::FeetLoose),
            (friction_rows, Outcome::GroundLoose),
        ];
        for (keep, outcome) in attempts {
            self.problem.truncate(keep);
            if self.solver.solve(&self.problem, &self.guess) == Status::Solved {
                self.guess.clear();
                self.guess.extend_from_slice(self.solver.active());
                return outcome;
            }
        }
        self.guess.clear();
        Outcome::Kinematic
    }

    /// No joint near the ground enters it.
    fn add_ground(&mut self, frames: &Frames, ground: &Ground) {
        for (ankle, toe) in FEET {
            for joint in [ankle, toe] {
                self.add_floor(frames, joint as usize, ground);
            }
        }
        for joint in 0..JOINTS {
            let place = frames.positions[joint];
            let near = place.y - ground.at(place.x, place.z).height < NEAR;
            if near
                && FEET
                    .iter()
                    .all(|&(a, b)| joint != a as usize && joint != b as usize)
            {
                self.add_floor(frames, joint, ground);
            }
        }
    }

    fn add_floor(&mut self, frames: &Frames, joint: usize, ground: &Ground) {
        let place = frames.positions[joint];
        let surface = ground.at(place.x, place.z);
        let depth = (surface.height - place.y) * surface.normal.y;
        let bound = (depth / self.tick).min(RISE_MAX);
        problem::add_velocity(
            &mut self.problem,
            frames,
            joint,
            surface.normal,
            bound,
            self.tick,
        );
    }

    /// The likelier a foot stands, the less its toe joint may move.
    fn add_standing(&mut self, frames: &Frames, wanted: &Frames, ground: &Ground) {
        for (foot, (_, toe)) in FEET.into_iter().enumerate() {
            let toe = toe as usize;
            let probability = self.feet.probabilities[foot];
            let slide = SLIDE_MIN - (probability.min(0.849_99) / 0.85).ln();
            if slide > SLIDE_MAX {
                continue;
            }
            let place = frames.positions[toe];
            let axes = contact::ground_axes(ground.at(place.x, place.z).normal);
            let creep = (wanted.positions[toe] - place) / self.settings.creep;
            for axis in [axes.x_axis, axes.z_axis] {
                for sign in [1.0, -1.0] {
                    let direction = axis * sign;
                    let bound = creep.dot(direction) - slide;
                    problem::add_velocity(
                        &mut self.problem,
                        frames,
                        toe,
                        direction,
                        bound,
                        self.tick,
                    );
                }
            }
        }
    }
}

/// A target as a motion.
fn motion_of(target: &Target) -> Motion {
    let mut velocity = [0.0; VELOCITIES];
    velocity[..3].copy_from_slice(&target.root_velocity.to_array());
    for joint in 0..JOINTS {
        let place = tree::rotation_of(joint);
        velocity[place..place + 3].copy_from_slice(&target.angular[joint].to_array());
    }
    Motion {
        root: target.root,
        rotations: target.rotations,
        velocity,
    }
}

#[cfg(test)]
mod tests;
