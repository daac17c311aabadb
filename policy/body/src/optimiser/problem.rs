//! The quadratic program of one tick.
//!
//! Unknowns are the generalised accelerations and the forces at the contact points, these in
//! units of [`FORCE_UNIT`]. The joint torques `τ = M q̈ + h - Jᵀ λ` are linear in both and so
//! eliminated; the residual force at the pelvis is their first six entries.

use glam::DVec3;

use super::Settings;
use super::contact::{POINTS_MAX, Point};
use super::dynamics::{Equation, Frames};
use super::tree::{VELOCITIES, rotation_of};
use crate::qp::Problem;
use crate::skeleton::{JOINTS, PARENTS};

/// Forces are solved for in this many newtons.
pub(super) const FORCE_UNIT: f64 = 100.0;
/// Most unknowns.
pub(super) const UNKNOWNS_MAX: usize = VELOCITIES + 3 * POINTS_MAX;
/// Most constraint rows: friction pyramids, joints kept out of the ground, toe joints
/// that stand.
pub(super) const ROWS_MAX: usize = 4 * POINTS_MAX + JOINTS + 2 * 4;

/// What the dual controller asks for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wish {
    /// Angular accelerations of the joints, each in its own frame.
    pub angular: [DVec3; JOINTS],
    /// Linear accelerations of the joints.
    pub linear: [DVec3; JOINTS],
}

/// The generalised velocities that share a branch with one, in ascending order.
#[derive(Debug, Clone)]
pub(super) struct Pattern {
    /// For each joint: its ancestors, itself and its descendants.
    related: [[bool; JOINTS]; JOINTS],
}

impl Pattern {
    pub(super) fn new() -> Self {
        let mut related = [[false; JOINTS]; JOINTS];
        for joint in 0..JOINTS {
            let mut next = Some(joint);
            while let Some(above) = next {
                related[joint][above] = true;
                related[above][joint] = true;
                next = PARENTS[above];
            }
        }
        Self { related }
    }
}

/// A sparse row: places in ascending order and values.
struct Row {
    places: [u16; UNKNOWNS_MAX],
    values: [f64; UNKNOWNS_MAX],
    len: usize,
}

impl Row {
    const EMPTY: Self = Self {
        places: [0; UNKNOWNS_MAX],
        values: [0.0; UNKNOWNS_MAX],
        len: 0,
    };

    fn push(&mut self, place: usize, value: f64) {
        self.places[self.len] = place as u16;
        self.values[self.len] = value;
        self.len += 1;
    }
}

/// Adds `weight * (row x + constant)²`, halved, to the objective.
fn add_square(problem: &mut Problem, row: &Row, constant: f64, weight: f64) {
    let n = problem.unknowns();
    for first in 0..row.len {
        let place = usize::from(row.places[first]);
        let scaled = weight * row.values[first];
        let column = &mut problem.hessian_mut()[place * n..(place + 1) * n];
        for second in first..row.len {
            column[usize::from(row.places[second])] += scaled * row.values[second];
        }
        problem.gradient_mut()[place] += scaled * constant;
    }
}

/// The objective: both controllers, torques, residual and ground forces.
pub(super) fn fill_objective(
    problem: &mut Problem,
    settings: &Settings,
    pattern: &Pattern,
    equation: &Equation,
    frames: &Frames,
    wish: &Wish,
    points: &[Point],
) {
    problem.reset(VELOCITIES + 3 * points.len());
    add_rotations(problem, settings, wish);
    add_positions(problem, settings, frames, wish);
    add_torques(problem, settings, pattern, equation, frames, points);
    let n = problem.unknowns();
    for (index, point) in points.iter().enumerate() {
        let weight = settings.residual * point.reluctance * FORCE_UNIT * FORCE_UNIT;
        for axis in 0..3 {
            let place = VELOCITIES + 3 * index + axis;
            problem.hessian_mut()[place * n + place] += weight;
        }
    }
}

fn add_rotations(problem: &mut Problem, settings: &Settings, wish: &Wish) {
    let n = problem.unknowns();
    for joint in 0..JOINTS {
        let weight = settings.rotation;
        for axis in 0..3 {
            let place = rotation_of(joint) + axis;
            problem.hessian_mut()[place * n + place] += weight;
            problem.gradient_mut()[place] -= weight * wish.angular[joint][axis];
        }
    }
}

fn add_positions(problem: &mut Problem, settings: &Settings, frames: &Frames, wish: &Wish) {
    let n = problem.unknowns();
    for joint in 0..JOINTS {
        let weight = settings.position * settings.position_shares[joint];
        if weight == 0.0 {
            continue;
        }
        let constant = frames.drifts[joint] - wish.linear[joint];
        let mut columns = [(0, DVec3::ZERO); 3 * 12];
        let mut len = 0;
        frames.for_each_column(joint, frames.positions[joint], |place, column| {
            // The joint's own rotation does not move it.
            if column != DVec3::ZERO {
                columns[len] = (place, column);
                len += 1;
            }
        });
        for first in 0..len {
            let (place, column) = columns[first];
            let scaled = weight * column;
            problem.gradient_mut()[place] += scaled.dot(constant);
            for &(other, value) in &columns[first..len] {
                let (low, high) = (place.min(other), place.max(other));
                problem.hessian_mut()[low * n + high] += scaled.dot(value);
            }
        }
    }
}

/// Residual force and joint torques, row by row of the equation of motion.
fn add_torques(
    problem: &mut Problem,
    settings: &Settings,
    pattern: &Pattern,
    equation: &Equation,
    frames: &Frames,
    points: &[Point],
) {
    for index in 0..VELOCITIES {
        let joint = index.checked_sub(3).map(|index| index / 3);
        let mut row = Row::EMPTY;
        let inertia = &equation.inertia[index];
        for axis in 0..3 {
            row.push(axis, inertia[axis]);
        }
        for other in 0..JOINTS {
            if joint.is_none_or(|joint| pattern.related[joint][other]) {
                for axis in 0..3 {
                    let place = rotation_of(other) + axis;
                    row.push(place, inertia[place]);
                }
            }
        }
        for (number, point) in points.iter().enumerate() {
            // The velocity of the point that this generalised velocity makes.
            let column = match joint {
                None => DVec3::AXES[index],
                Some(joint) if is_above(joint, point.joint) => {
                    let axis = frames.turns[joint].col(index - rotation_of(joint));
                    axis.cross(point.place - frames.positions[joint])
                }
                Some(_) => continue,
            };
            let along = point.ground.transpose() * column;
            for axis in 0..3 {
                row.push(VELOCITIES + 3 * number + axis, -FORCE_UNIT * along[axis]);
            }
        }
        let weight = if index < 6 {
            settings.residual
        } else {
            settings.torque
        };
        add_square(problem, &row, equation.bias[index], weight);
    }
}

/// Whether `joint` carries `other`.
fn is_above(joint: usize, other: usize) -> bool {
    let mut next = Some(other);
    while let Some(at) = next {
        if at == joint {
            return true;
        }
        next = PARENTS[at];
    }
    false
}

/// Friction pyramids inside Coulomb's cone: `√2 |λ tangential| <= μ λ normal`.
pub(super) fn add_friction(problem: &mut Problem, friction: f64, points: usize) {
    let slope = friction / std::f64::consts::SQRT_2;
    for point in 0..points {
        let place = VELOCITIES + 3 * point;
        for (axis, sign) in [(0, 1.0), (0, -1.0), (2, 1.0), (2, -1.0)] {
            let row = problem.constrain(0.0);
            row[place + axis] = -sign;
            row[place + 1] = slope;
        }
    }
}

/// `direction · velocity >= bound` for the velocity of a joint at the end of the tick.
pub(super) fn add_velocity(
    problem: &mut Problem,
    frames: &Frames,
    joint: usize,
    direction: DVec3,
    bound: f64,
    tick: f64,
) {
    let now = frames.velocities[joint].dot(direction);
    let row = problem.constrain(bound - now);
    frames.for_each_column(joint, frames.positions[joint], |place, column| {
        row[place] = tick * column.dot(direction);
    });
}
