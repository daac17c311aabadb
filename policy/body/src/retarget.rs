//! Twenty-two joints to thirty-three angles: the character pose that comes closest to a body
//! pose. The way back is [`Character::body_pose`].
//!
//! The character has no collar bones, no forearm twist above the wrist and two spine joints
//! where the skeleton has three, so positions are fitted in the least-squares sense
//! (Levenberg-Marquardt), with a little weight on orientations to settle what positions leave
//! open. Poses are fitted one after the other, each starting from the last.

use glam::{DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use crate::character::{Character, CharacterPose, HINGES, LINKS, Link, LinkFrames, hinges_of};
use crate::skeleton::{BodyPose, JOINTS, Joint, Joints};

/// Unknowns: pelvis translation and rotation, then the hinges.
const UNKNOWNS: usize = 6 + HINGES;
/// Most columns that move one link: the pelvis and every hinge from it to a hand.
const CHAIN_MAX: usize = 18;
/// Iterations from a pose nearby and from nowhere.
const ITERATIONS: usize = 4;
const ITERATIONS_COLD: usize = 60;
/// A step smaller than this (metres or radians) ends the iteration.
const CONVERGED: f64 = 1e-4;
/// A fit further off than this, root mean square over the joints in metres, starts afresh.
const LOST: f64 = 0.15;
/// Share of the trace added to the diagonal of the normal equations.
const DAMPING: f64 = 1e-5;

/// Weight of a link's orientation: metres for each radian.
fn orientation_weight(link: Link) -> f64 {
    match link {
        Link::Head => 0.20,
        Link::LeftFoot | Link::RightFoot => 0.10,
        Link::LeftHand | Link::RightHand => 0.06,
        Link::Pelvis | Link::Chest => 0.04,
        _ => 0.015,
    }
}

/// The joint of the skeleton whose orientation a link shall have.
fn orientation_of(link: Link) -> Joint {
    match link {
        Link::Spine => Joint::Spine2,
        Link::Head => Joint::Head,
        _ => link.anchor(),
    }
}

/// The unknowns that move a link, in ascending order.
#[derive(Debug, Clone, Copy)]
struct Chain {
    columns: [u8; CHAIN_MAX],
    len: usize,
}

impl Chain {
    fn to(link: Link) -> Self {
        let mut moved = [false; UNKNOWNS];
        moved[..6].fill(true);
        let mut next = Some(link);
        while let Some(link) = next {
            moved[6 + hinges_of(link).start..6 + hinges_of(link).end].fill(true);
            next = link.parent();
        }
        let mut chain = Self {
            columns: [0; CHAIN_MAX],
            len: 0,
        };
        for (column, _) in moved.iter().enumerate().filter(|(_, moved)| **moved) {
            chain.columns[chain.len] = column as u8;
            chain.len += 1;
        }
        chain
    }

    fn iter(&self) -> impl Iterator<Item = usize> {
        self.columns[..self.len]
            .iter()
            .map(|&column| usize::from(column))
    }
}

/// Fits a stream of body poses of the character's own skeleton.
#[derive(Debug, Clone)]
pub struct Retarget {
    character: Character,
    chains: [Chain; LINKS],
    last: Option<CharacterPose>,
    normal: Box<Normal>,
}

impl Retarget {
    /// A fitter for this character.
    #[must_use]
    pub fn new(character: Character) -> Self {
        let chains = Link::ALL.map(Chain::to);
        Self {
            character,
            chains,
            last: None,
            normal: Box::default(),
        }
    }

    /// The character.
    #[must_use]
    pub fn character(&self) -> &Character {
        &self.character
    }

    /// Forgets the last pose.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// The character pose nearest to `pose`, all angles within their ranges. Does not allocate.
    pub fn fit(&mut self, pose: &BodyPose) -> CharacterPose {
        let target = self.character.skeleton.forward(pose);
        let mut fitted = None;
        if let Some(last) = self.last {
            let (near, error) = self.refine(last, &target, ITERATIONS, Weights::FINE);
            fitted = (error < LOST).then_some(near);
        }
        let fitted = fitted.unwrap_or_else(|| {
            let mut start = CharacterPose::rest(pose.root.as_dvec3());
            start.rotation = pose.rotations[0].as_dquat().normalize();
            let (coarse, _) = self.refine(start, &target, ITERATIONS_COLD, Weights::COARSE);
            self.refine(coarse, &target, ITERATIONS_COLD, Weights::FINE)
                .0
        });
        self.last = Some(fitted);
        fitted
    }

    /// Iterates from `pose`; the second answer is the joints' root mean square distance.
    fn refine(
        &mut self,
        mut pose: CharacterPose,
        target: &Joints,
        iterations: usize,
        weights: Weights,
    ) -> (CharacterPose, f64) {
        let mut error = f64::INFINITY;
        for _ in 0..iterations {
            let frames = self.character.forward(&pose);
            error = self.build(&frames, target, weights);
            let Some(step) = self.normal.solve() else {
                break;
            };
            self.apply(&mut pose, &step);
            if step.iter().all(|x| x.abs() < CONVERGED) {
                break;
            }
        }
        (pose, error)
    }

    fn apply(&self, pose: &mut CharacterPose, step: &[f64; UNKNOWNS]) {
        pose.root += DVec3::from_slice(&step[..3]);
        // A large step is a poor one: the model is linear.
        let turn = DVec3::from_slice(&step[3..6]).clamp_length_max(0.5);
        pose.rotation = (DQuat::from_scaled_axis(turn) * pose.rotation).normalize();
        for (index, angle) in pose.angles.iter_mut().enumerate() {
            let [low, high] = self.character.hinges[index].range;
            *angle = (*angle + step[6 + index].clamp(-0.5, 0.5)).clamp(low, high);
        }
    }

    /// Fills the normal equations at `frames`.
    fn build(&mut self, frames: &LinkFrames, target: &Joints, weights: Weights) -> f64 {
        self.normal.clear();
        let mut sum = 0.0;
        for joint in Joint::ALL {
            let (link, offset) = self.character.joints[joint as usize];
            let place = frames.positions[link as usize] + frames.rotations[link as usize] * offset;
            let residual = target.position(joint).as_dvec3() - place;
            sum += residual.length_squared();
            let column = |unknown| position_column(frames, unknown, place);
            self.normal.add(
                &self.chains[link as usize],
                column,
                residual,
                weights.position,
            );
        }
        for link in Link::ALL {
            let turn = frames.rotations[link as usize];
            let wanted = target.rotation(orientation_of(link)).as_dquat().normalize();
            let residual = shortest(wanted * turn.inverse()).to_scaled_axis();
            let weight = weights
                .orientation
                .unwrap_or_else(|| orientation_weight(link).powi(2));
            let column = |unknown| rotation_column(frames, unknown);
            self.normal
                .add(&self.chains[link as usize], column, residual, weight);
        }
        (sum / JOINTS as f64).sqrt()
    }
}

/// The same rotation, by less than half a turn.
fn shortest(q: DQuat) -> DQuat {
    if q.w < 0.0 { -q } else { q }
}

/// How a point at `place` moves with an unknown.
fn position_column(frames: &LinkFrames, unknown: usize, place: DVec3) -> DVec3 {
    match unknown {
        0..3 => DVec3::AXES[unknown],
        3..6 => DVec3::AXES[unknown - 3].cross(place - frames.positions[0]),
        _ => {
            let link = crate::character::HINGE_TABLE[unknown - 6].link;
            frames.axes[unknown - 6].cross(place - frames.positions[link as usize])
        }
    }
}

/// How a link turns with an unknown.
fn rotation_column(frames: &LinkFrames, unknown: usize) -> DVec3 {
    match unknown {
        0..3 => DVec3::ZERO,
        3..6 => DVec3::AXES[unknown - 3],
        _ => frames.axes[unknown - 6],
    }
}

/// Weights of squared metres and, where one value serves all links, of squared radians.
#[derive(Debug, Clone, Copy)]
struct Weights {
    position: f64,
    orientation: Option<f64>,
}

impl Weights {
    /// Orientations lead: brings every link to the right side from anywhere.
    const COARSE: Self = Self {
        position: 0.01,
        orientation: Some(0.04),
    };
    const FINE: Self = Self {
        position: 1.0,
        orientation: None,
    };
}

/// Normal equations of the least-squares problem; the lower triangle counts.
#[derive(Debug, Clone)]
struct Normal {
    matrix: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    right: SVector<f64, UNKNOWNS>,
}

impl Default for Normal {
    fn default() -> Self {
        Self {
            matrix: SMatrix::zeros(),
            right: SVector::zeros(),
        }
    }
}

impl Normal {
    fn clear(&mut self) {
        self.matrix.fill(0.0);
        self.right.fill(0.0);
    }

    /// Adds three rows: a residual and its columns.
    fn add(
        &mut self,
        chain: &Chain,
        column: impl Fn(usize) -> DVec3,
        residual: DVec3,
        weight: f64,
    ) {
        let mut columns = [DVec3::ZERO; CHAIN_MAX];
        for (place, unknown) in chain.iter().enumerate() {
            columns[place] = column(unknown);
            self.right[unknown] += weight * columns[place].dot(residual);
            for (before, other) in chain.iter().take(place + 1).enumerate() {
                self.matrix[(unknown, other)] += weight * columns[place].dot(columns[before]);
            }
        }
    }

    /// The step; `None` where the numbers are not finite.
    fn solve(&self) -> Option<[f64; UNKNOWNS]> {
        let ridge = DAMPING * self.matrix.trace() / UNKNOWNS as f64;
        let damped = self.matrix + SMatrix::from_diagonal_element(ridge);
        let step = damped.cholesky()?.solve(&self.right);
        let step: [f64; UNKNOWNS] = step.into();
        step.iter().all(|x| x.is_finite()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent(seed: f64) -> CharacterPose {
        let mut pose = CharacterPose::rest(DVec3::new(0.3, 1.0, -2.0));
        pose.rotation = DQuat::from_rotation_y(3.0 * seed);
        for (index, hinge) in crate::character::HINGE_TABLE.iter().enumerate() {
            let [low, high] = hinge.range;
            let share = 0.5 + 0.3 * (seed + index as f64 * 1.7).sin();
            pose.angles[index] = low + share * (high - low);
        }
        pose
    }

    #[test]
    fn the_characters_own_poses_come_back() {
        let character = Character::of_height(1.7).expect("a stature in range");
        let mut retarget = Retarget::new(character.clone());
        for step in 0..200 {
            let pose = bent(f64::from(step) * 0.02);
            let fitted = retarget.fit(&character.body_pose(&pose));
            let place = |pose| character.joints(&character.forward(pose));
            let (wanted, got) = (place(&pose), place(&fitted));
            for joint in Joint::ALL {
                let apart = (wanted.position(joint) - got.position(joint)).length();
                assert!(apart < 2e-3, "step {step}, {}: {apart}", joint.name());
            }
            for (index, hinge) in character.hinges.iter().enumerate() {
                let apart = (pose.angles[index] - fitted.angles[index]).abs();
                assert!(apart < 0.02, "step {step}, {}: {apart}", hinge.name);
            }
        }
    }

    #[test]
    fn a_stream_and_a_fresh_start_agree() {
        let character = Character::of_height(1.7).expect("a stature in range");
        let mut pose = BodyPose::rest(glam::Vec3::new(0.0, 1.0, 0.0));
        let mut stream = Retarget::new(character.clone());
        for step in 0..100 {
            let angle = step as f32 * 0.01;
            pose.rotations[Joint::LeftShoulder as usize] = glam::Quat::from_rotation_z(angle);
            pose.rotations[Joint::LeftCollar as usize] = glam::Quat::from_rotation_z(0.2 * angle);
            pose.rotations[Joint::Spine2 as usize] = glam::Quat::from_rotation_x(-0.3 * angle);
            let followed = stream.fit(&pose);
            let fresh = Retarget::new(character.clone()).fit(&pose);
            for (a, b) in followed.angles.iter().zip(&fresh.angles) {
                assert!((a - b).abs() < 0.02, "step {step}: {a} {b}");
            }
        }
    }
}
