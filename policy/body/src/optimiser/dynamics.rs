//! Kinematics and dynamics of the tree: frames, velocities, velocity-product accelerations, the
//! inertia matrix and the non-linear effects.
//!
//! After R. Featherstone, "Rigid Body Dynamics Algorithms" (composite-rigid-body and recursive
//! Newton-Euler), written with three-vectors in the world's axes.

use glam::{DMat3, DQuat, DVec3};

use super::tree::{Tree, VELOCITIES, rotation_of};
use crate::simulation::GRAVITY;
use crate::skeleton::{JOINTS, PARENTS};

/// Where the body is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Position of the pelvis, metres.
    pub root: DVec3,
    /// Local rotations, child to parent; that of the pelvis to the world.
    pub rotations: [DQuat; JOINTS],
    /// Generalised velocities.
    pub velocity: [f64; VELOCITIES],
}

impl Motion {
    /// Angular velocity of a joint against its parent, in its own frame.
    pub(super) fn angular(&self, joint: usize) -> DVec3 {
        DVec3::from_slice(&self.velocity[rotation_of(joint)..rotation_of(joint) + 3])
    }

    /// Moves on by `dt` seconds under a generalised acceleration: velocities first, then, with
    /// the new velocities, positions (semi-implicit Euler).
    pub(super) fn advance(&mut self, acceleration: &[f64], dt: f64) {
        for (velocity, acceleration) in self.velocity.iter_mut().zip(acceleration) {
            *velocity += acceleration * dt;
        }
        self.root += DVec3::from_slice(&self.velocity[..3]) * dt;
        for joint in 0..JOINTS {
            let turn = DQuat::from_scaled_axis(self.angular(joint) * dt);
            self.rotations[joint] = (self.rotations[joint] * turn).normalize();
        }
    }
}

/// The links of a moving body in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames {
    /// Joint positions, metres.
    pub positions: [DVec3; JOINTS],
    /// Link rotations, to the world; the columns are the axes of the joint's three velocities.
    pub turns: [DMat3; JOINTS],
    /// Linear velocities of the joints, m/s.
    pub velocities: [DVec3; JOINTS],
    /// Angular velocities of the links, rad/s.
    pub spins: [DVec3; JOINTS],
    /// Linear accelerations of the joints while no generalised velocity changes, m/s²: what PIP
    /// writes as `J̇ q̇`.
    pub drifts: [DVec3; JOINTS],
    /// The same for angular accelerations.
    pub spin_drifts: [DVec3; JOINTS],
}

impl Frames {
    /// Places every link.
    #[must_use]
    pub fn new(tree: &Tree, motion: &Motion) -> Self {
        let mut frames = Self {
            positions: [motion.root; JOINTS],
            turns: [DMat3::from_quat(motion.rotations[0]); JOINTS],
            velocities: [DVec3::from_slice(&motion.velocity[..3]); JOINTS],
            spins: [DVec3::ZERO; JOINTS],
            drifts: [DVec3::ZERO; JOINTS],
            spin_drifts: [DVec3::ZERO; JOINTS],
        };
        frames.spins[0] = frames.turns[0] * motion.angular(0);
        for (joint, parent) in PARENTS.into_iter().enumerate() {
            let Some(parent) = parent else { continue };
            let (turn, spin) = (frames.turns[parent], frames.spins[parent]);
            let arm = turn * tree.offsets[joint];
            frames.turns[joint] = turn * DMat3::from_quat(motion.rotations[joint]);
            let relative = frames.turns[joint] * motion.angular(joint);
            frames.spins[joint] = spin + relative;
            frames.spin_drifts[joint] = frames.spin_drifts[parent] + spin.cross(relative);
            frames.positions[joint] = frames.positions[parent] + arm;
            frames.velocities[joint] = frames.velocities[parent] + spin.cross(arm);
            frames.drifts[joint] = frames.drifts[parent]
                + frames.spin_drifts[parent].cross(arm)
                + spin.cross(spin.cross(arm));
        }
        frames
    }

    /// Where a point fixed to a link is.
    #[must_use]
    pub fn place(&self, joint: usize, offset: DVec3) -> DVec3 {
        self.positions[joint] + self.turns[joint] * offset
    }

    /// Calls with each generalised velocity that moves a point on a link, and how.
    pub(super) fn for_each_column(
        &self,
        joint: usize,
        point: DVec3,
        mut visit: impl FnMut(usize, DVec3),
    ) {
        for axis in 0..3 {
            visit(axis, DVec3::AXES[axis]);
        }
        let mut next = Some(joint);
        while let Some(joint) = next {
            let arm = point - self.positions[joint];
            for axis in 0..3 {
                visit(
                    rotation_of(joint) + axis,
                    self.turns[joint].col(axis).cross(arm),
                );
            }
            next = PARENTS[joint];
        }
    }
}

/// The equation of motion `τ + Jᵀ λ = M q̈ + h` of a moving body.
#[derive(Debug, Clone)]
pub struct Equation {
    /// `M`, symmetric, row by row.
    pub inertia: Box<[[f64; VELOCITIES]; VELOCITIES]>,
    /// `h`: gravity, Coriolis and centrifugal effects.
    pub bias: [f64; VELOCITIES],
}

impl Default for Equation {
    fn default() -> Self {
        Self {
            inertia: Box::new([[0.0; VELOCITIES]; VELOCITIES]),
            bias: [0.0; VELOCITIES],
        }
    }
}

/// Everything beyond a joint as one rigid body: mass, mass times the offset of its centre from
/// the joint, inertia about the joint.
#[derive(Debug, Clone, Copy)]
struct Composite {
    mass: f64,
    moment: DVec3,
    inertia: DMat3,
}

impl Composite {
    const NOTHING: Self = Self {
        mass: 0.0,
        moment: DVec3::ZERO,
        inertia: DMat3::ZERO,
    };
}

/// `2 d·e 1 - d eᵀ - e dᵀ`: twice the inertia that the offsets of a unit mass make.
fn spread(d: DVec3, e: DVec3) -> DMat3 {
    let outer = DMat3::from_cols(d * e.x, d * e.y, d * e.z);
    let both = outer + outer.transpose();
    DMat3::from_diagonal(DVec3::splat(2.0 * d.dot(e))) - both
}

impl Equation {
    /// Fills both parts.
    pub fn update(&mut self, tree: &Tree, frames: &Frames) {
        self.update_bias(tree, frames);
        self.update_inertia(tree, frames);
    }

    /// Recursive Newton-Euler with the velocity-product accelerations.
    fn update_bias(&mut self, tree: &Tree, frames: &Frames) {
        let mut forces = [DVec3::ZERO; JOINTS];
        let mut moments = [DVec3::ZERO; JOINTS];
        for joint in (0..JOINTS).rev() {
            let (turn, spin) = (frames.turns[joint], frames.spins[joint]);
            let alpha = frames.spin_drifts[joint];
            let arm = turn * tree.coms[joint];
            let linear = frames.drifts[joint] + alpha.cross(arm) + spin.cross(spin.cross(arm));
            let force = tree.masses[joint] * (linear + DVec3::Y * GRAVITY);
            let inertia = tree.inertia(joint, turn);
            forces[joint] += force;
            moments[joint] += arm.cross(force) + inertia * alpha + spin.cross(inertia * spin);
            let moment = turn.transpose() * moments[joint];
            self.bias[rotation_of(joint)..rotation_of(joint) + 3]
                .copy_from_slice(&moment.to_array());
            if let Some(parent) = PARENTS[joint] {
                let lever = frames.positions[joint] - frames.positions[parent];
                let (force, moment) = (forces[joint], moments[joint]);
                forces[parent] += force;
                moments[parent] += moment + lever.cross(force);
            }
        }
        self.bias[..3].copy_from_slice(&forces[0].to_array());
    }

    /// Composite rigid bodies.
    fn update_inertia(&mut self, tree: &Tree, frames: &Frames) {
        self.inertia.fill([0.0; VELOCITIES]);
        let mut composites = [Composite::NOTHING; JOINTS];
        for joint in (0..JOINTS).rev() {
            let turn = frames.turns[joint];
            let (mass, arm) = (tree.masses[joint], turn * tree.coms[joint]);
            let whole = &mut composites[joint];
            whole.mass += mass;
            whole.moment += mass * arm;
            whole.inertia += tree.inertia(joint, turn) + 0.5 * mass * spread(arm, arm);
            let whole = *whole;
            self.fill_columns(tree, frames, joint, &whole);
            if let Some(parent) = PARENTS[joint] {
                let lever = frames.positions[joint] - frames.positions[parent];
                let above = &mut composites[parent];
                above.mass += whole.mass;
                above.moment += whole.moment + whole.mass * lever;
                above.inertia += whole.inertia
                    + spread(whole.moment, lever)
                    + 0.5 * whole.mass * spread(lever, lever);
            }
        }
        for axis in 0..3 {
            self.inertia[axis][axis] = composites[0].mass;
        }
    }

    /// The columns of a joint's three velocities: the force and moment that turning everything
    /// beyond it takes, seen by every joint on the way to the pelvis.
    fn fill_columns(&mut self, tree: &Tree, frames: &Frames, joint: usize, whole: &Composite) {
        for axis in 0..3 {
            let column = rotation_of(joint) + axis;
            let direction = frames.turns[joint].col(axis);
            let force = direction.cross(whole.moment);
            let moment = whole.inertia * direction;
            let mut next = Some(joint);
            while let Some(above) = next {
                let lever = frames.positions[joint] - frames.positions[above];
                let there = frames.turns[above].transpose() * (moment + lever.cross(force));
                for other in 0..3 {
                    let row = rotation_of(above) + other;
                    self.inertia[row][column] = there[other];
                    self.inertia[column][row] = there[other];
                }
                next = PARENTS[above];
            }
            for other in 0..3 {
                self.inertia[other][column] = force[other];
                self.inertia[column][other] = force[other];
            }
            self.inertia[column][column] += if joint == 0 { 0.0 } else { tree.armature };
        }
    }
}
