//! One running world.

use std::sync::Arc;

use glam::{DQuat, DVec3};
use mujoco_rs::prelude::{MjData, MjModel};

use super::{Model, Shared};
use crate::character::{CharacterPose, HINGES};

/// Coordinates of the free pelvis: position and quaternion.
pub(super) const ROOT_COORDINATES: usize = 7;
/// Velocities of the free pelvis: linear in the world, angular in the pelvis's frame.
pub(super) const ROOT_VELOCITIES: usize = 6;
/// A coordinate beyond this is as good as not finite, metres or radians.
const POSITION_MAX: f64 = 1e4;
/// The same for velocities, per second: caught here, MuJoCo never gets to warn into a log file.
const VELOCITY_MAX: f64 = 1e3;

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Every number is sound.
    Sound,
    /// The state was not finite any more; it has been put back to the last sound one, at rest.
    Quarantined,
}

/// What the ground does to a foot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FootContact {
    /// Force on the foot in the world, N.
    pub force: DVec3,
    /// Where it acts (force-weighted mean of the contact points), metres; zero without contact.
    pub centre: DVec3,
    /// Number of contact points.
    pub points: usize,
}

/// A world; clone it to branch off.
#[derive(Clone)]
pub struct State {
    pub(super) data: MjData<Arc<MjModel>>,
    pub(super) shared: Arc<Shared>,
    /// The last sound positions of everything.
    pub(super) sound: Box<[f64]>,
    /// Where the objects that do not move by themselves were put.
    pub(super) fixed: Box<[([f64; 3], [f64; 4])]>,
    quarantines: u64,
    /// Objects that the character touched in the last call of [`State::step`], a bit each.
    pub(super) touched: u32,
}

impl std::fmt::Debug for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("State")
            .field("time", &self.data.time())
            .field("pose", &self.pose())
            .field("quarantines", &self.quarantines)
            .finish_non_exhaustive()
    }
}

impl State {
    pub(super) fn new(model: &Model) -> Self {
        let mut data = MjData::new(Arc::clone(&model.mujoco));
        data.forward();
        let sound = data.qpos().into();
        let fixed = data.mocap_pos().iter().zip(data.mocap_quat());
        let fixed = fixed.map(|(place, turn)| (*place, *turn)).collect();
        Self {
            data,
            shared: Arc::clone(&model.shared),
            sound,
            fixed,
            quarantines: 0,
            touched: 0,
        }
    }

    /// Puts the character in a pose at rest; everything else stays where it is.
    pub fn set_pose(&mut self, pose: &CharacterPose) {
        self.set_pose_and_velocity(pose, &[0.0; ROOT_VELOCITIES + HINGES]);
    }

    /// Puts the character in a pose, moving, without torques. Velocities: pelvis linear in the world (m/s),
    /// pelvis angular in its own frame, then the hinges (rad/s). A pose that is not finite is
    /// ignored.
    pub fn set_pose_and_velocity(
        &mut self,
        pose: &CharacterPose,
        velocity: &[f64; ROOT_VELOCITIES + HINGES],
    ) {
        let finite = pose.root.is_finite()
            && pose.rotation.is_finite()
            && pose.angles.iter().chain(velocity).all(|x| x.is_finite());
        if !finite {
            self.quarantines += 1;
            return;
        }
        let rotation = pose.rotation.normalize();
        let qpos = self.data.qpos_mut();
        qpos[..3].copy_from_slice(&pose.root.to_array());
        qpos[3..7].copy_from_slice(&[rotation.w, rotation.x, rotation.y, rotation.z]);
        qpos[ROOT_COORDINATES..ROOT_COORDINATES + HINGES].copy_from_slice(&pose.angles);
        self.sound.copy_from_slice(qpos);
        self.data.qvel_mut()[..ROOT_VELOCITIES + HINGES].copy_from_slice(velocity);
        // Torques of the last step would change what the ground does to the feet.
        self.data.ctrl_mut().fill(0.0);
        self.data.forward();
    }

    /// The character's pose.
    #[must_use]
    pub fn pose(&self) -> CharacterPose {
        let qpos = self.data.qpos();
        let mut angles = [0.0; HINGES];
        angles.copy_from_slice(&qpos[ROOT_COORDINATES..ROOT_COORDINATES + HINGES]);
        CharacterPose {
            root: DVec3::new(qpos[0], qpos[1], qpos[2]),
            rotation: DQuat::from_xyzw(qpos[4], qpos[5], qpos[6], qpos[3]),
            angles,
        }
    }

    /// The character's velocities, as in [`State::set_pose_and_velocity`].
    #[must_use]
    pub fn velocity(&self) -> [f64; ROOT_VELOCITIES + HINGES] {
        let mut velocity = [0.0; ROOT_VELOCITIES + HINGES];
        velocity.copy_from_slice(&self.data.qvel()[..ROOT_VELOCITIES + HINGES]);
        velocity
    }

    /// Runs `steps` steps of [`super::TIME_STEP`] under these torques (N m), each clamped to its
    /// hinge's limit; one that is not a number counts as zero.
    pub fn step(&mut self, torques: &[f64; HINGES], steps: usize) -> Step {
        for (control, &torque) in self.data.ctrl_mut().iter_mut().zip(torques) {
            *control = if torque.is_finite() { torque } else { 0.0 };
        }
        self.touched = 0;
        for _ in 0..steps {
            self.data.step();
            self.note_touches();
            if !self.is_sound() {
                self.restore();
                return Step::Quarantined;
            }
            self.sound.copy_from_slice(self.data.qpos());
        }
        Step::Sound
    }

    fn is_sound(&self) -> bool {
        let within = |values: &[f64], limit: f64| values.iter().all(|x| x.abs() < limit);
        within(self.data.qpos(), POSITION_MAX) && within(self.data.qvel(), VELOCITY_MAX)
    }

    fn restore(&mut self) {
        self.quarantines += 1;
        self.data.reset();
        self.data.qpos_mut().copy_from_slice(&self.sound);
        self.put_fixed();
        self.data.forward();
    }

    /// How often the state had to be put back or an unsound pose was refused.
    #[must_use]
    pub fn quarantines(&self) -> u64 {
        self.quarantines
    }

    /// Simulated time, seconds.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.data.time()
    }

    /// What the scene does to the left and the right foot, as of the last step.
    #[must_use]
    pub fn feet(&self) -> [FootContact; 2] {
        let mut feet = [FootContact::default(); 2];
        self.for_each_contact(|foot, point, force| {
            if let Some(foot) = foot {
                let foot = &mut feet[usize::from(foot)];
                foot.force += force;
                foot.centre += point * force.length();
                foot.points += 1;
            }
        });
        for foot in &mut feet {
            let weight = foot.force.length();
            foot.centre = if weight > 0.0 {
                foot.centre / weight
            } else {
                DVec3::ZERO
            };
        }
        feet
    }

    /// Sum of all contact forces on the character, N in the world.
    #[must_use]
    pub fn contact_force(&self) -> DVec3 {
        let mut sum = DVec3::ZERO;
        self.for_each_contact(|_, _, force| sum += force);
        sum
    }

    /// Calls with the foot, if it is one, the point and the force on the character.
    fn for_each_contact(&self, mut visit: impl FnMut(Option<u8>, DVec3, DVec3)) {
        for (index, contact) in self.data.contact().iter().enumerate() {
            if contact.efc_address < 0 {
                continue;
            }
            let geoms = contact.geom.map(|geom| geom as usize);
            // MuJoCo gives the force of the first geom on the second, in the contact's frame.
            let (geom, sign) = match geoms.map(|geom| self.shared.of_character[geom]) {
                [_, true] => (geoms[1], 1.0),
                [true, false] => (geoms[0], -1.0),
                [false, false] => continue,
            };
            let force = self.data.contact_force(index);
            let axis = |row: usize| DVec3::from_slice(&contact.frame[3 * row..3 * row + 3]);
            let force = axis(0) * force[0] + axis(1) * force[1] + axis(2) * force[2];
            visit(
                self.shared.foot_of_geom[geom],
                DVec3::from(contact.pos),
                force * sign,
            );
        }
    }

    /// Potential and kinetic energy of everything that moves, as of the start of the last step;
    /// joules.
    #[must_use]
    pub fn energy(&self) -> [f64; 2] {
        *self.data.energy()
    }
}
