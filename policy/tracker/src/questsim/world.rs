//! The wearer's character in its world, one policy step at a time.

use glam::{DMat3, DVec3, Vec3};
use posed_body::{
    BodyPose, JOINTS, Skeleton,
    character::{Character, CharacterPose, HINGES, Link, hinges_of},
    optimiser::FootForce,
    retarget::Retarget,
    scene::{Ground, Place, Scene},
    simulation::{Model, SimulationError, State, Step},
};

use super::{
    observation::{FUTURE, SUBSTEPS, Seen, User, VELOCITIES},
    policy::Policy,
};
use crate::{
    objects::{ObjectMove, ObjectPose, Objects},
    tracker::Forces,
};

/// A velocity estimated at a spawn is cut off here: m/s and rad/s.
const SPAWN_SPEED_MAX: f64 = 8.0;

/// A character, simulated.
pub(super) struct World {
    pub(super) skeleton: Skeleton,
    character: Character,
    state: State,
    retarget: Retarget,
    ground: Ground,
    /// The things in the scene at the last two policy steps.
    objects: [Objects; 2],
    /// The poses at the last two policy steps.
    pub(super) from: CharacterPose,
    pub(super) to: CharacterPose,
    /// Torques of the last policy step, N m.
    pub(super) torques: [f64; HINGES],
}

impl World {
    /// Builds the character of these bones. Allocates: MuJoCo compiles the model.
    pub(super) fn new(skeleton: &Skeleton, scene: &Scene) -> Result<Self, SimulationError> {
        let character = Character::new(skeleton, None)?;
        let state = Model::new(character.clone(), scene.clone())?.state();
        let rest = state.pose();
        let objects = objects(&state);
        Ok(Self {
            skeleton: *skeleton,
            ground: scene.ground,
            objects: [objects; 2],
            retarget: Retarget::new(character.clone()),
            character,
            state,
            from: rest,
            to: rest,
            torques: [0.0; HINGES],
        })
    }

    /// Puts the character into `pose`, moving as from `before`, which was `seconds` earlier. No
    /// sole starts below the floor.
    pub(super) fn spawn(&mut self, pose: &BodyPose, before: Option<(&BodyPose, f64)>) {
        self.retarget.reset();
        let earlier = before.map(|(pose, seconds)| (self.retarget.fit(pose), seconds));
        let mut here = self.retarget.fit(pose);
        let velocity = earlier.map_or([0.0; VELOCITIES], |(earlier, seconds)| {
            velocity(&earlier, &here, seconds)
        });
        here.root.y -= self.lowest_sole(&here).min(0.0);
        self.state.set_pose_and_velocity(&here, &velocity);
        (self.from, self.to, self.torques) = (here, here, [0.0; HINGES]);
    }

    /// Height of the ground where somebody stands whose pelvis is at `root`, metres.
    pub(super) fn floor(&self, root: DVec3) -> f64 {
        self.ground.around(root.x, root.z)
    }

    /// Height of the lowest corner of the soles above the ground, metres.
    fn lowest_sole(&self, pose: &CharacterPose) -> f64 {
        let frames = self.character.forward(pose);
        let feet = [Link::LeftFoot, Link::RightFoot];
        let mut lowest = f64::MAX;
        for (foot, sole) in feet.into_iter().zip(&self.character.soles) {
            let (place, turn) = (
                frames.positions[foot as usize],
                frames.rotations[foot as usize],
            );
            for z in [sole.heel, sole.ball] {
                for x in [-sole.half_width, sole.half_width] {
                    let corner = place + turn * DVec3::new(x, sole.y, z);
                    let ground = self.ground.at(corner.x, corner.z).height;
                    lowest = lowest.min(corner.y - ground);
                }
            }
        }
        lowest
    }

    /// One policy step: observes, asks, and runs the physics. `false` when the policy has no
    /// answer or the state had to be put back.
    pub(super) fn step(&mut self, policy: &mut Policy, user: &[User; FUTURE], hands: bool) -> bool {
        self.observe(user, hands, policy.observation());
        let Some(action) = policy.act() else {
            return false;
        };
        self.apply(&action)
    }

    /// Writes the observation of the present state.
    pub(super) fn observe(&self, user: &[User; FUTURE], hands: bool, out: &mut [f32]) {
        let pose = self.state.pose();
        let seen = Seen {
            character: &self.character,
            pose: &pose,
            floor: self.floor(pose.root),
            velocity: &self.state.velocity(),
            feet: self.state.feet().map(|foot| foot.force),
            user,
            hands,
        };
        seen.write(out);
    }

    /// Runs a policy step's physics under torques given over their limits.
    pub(super) fn apply(&mut self, action: &[f64; HINGES]) -> bool {
        self.torques = std::array::from_fn(|h| action[h] * self.character.hinges[h].torque);
        self.from = self.to;
        let step = self.state.step(&self.torques, SUBSTEPS);
        self.to = self.state.pose();
        self.state.fetch_objects();
        self.objects = [self.objects[1], objects(&self.state)];
        step == Step::Sound
    }

    /// Puts a thing in the scene somewhere else.
    pub(super) fn move_object(&mut self, to: &ObjectMove) {
        let place = Place {
            position: to.position.as_dvec3(),
            rotation: to.rotation.as_dquat(),
        };
        let velocity = [to.velocity.as_dvec3(), to.angular_velocity.as_dvec3()];
        self.state.put_object(to.index, &place, velocity);
        self.objects = [objects(&self.state); 2];
    }

    /// Puts everything in the scene where it was at first.
    pub(super) fn put_objects_back(&mut self) {
        self.state.put_objects_back();
        self.objects = [objects(&self.state); 2];
    }

    /// The things in the scene between the last two policy steps, `share` (0 to 1) of the way.
    pub(super) fn objects_between(&self, share: f64) -> Objects {
        self.objects[0].between(&self.objects[1], share as f32)
    }

    /// Torques of the last policy step and what the ground does to the feet.
    pub(super) fn forces(&self) -> Forces {
        let frames = self.character.forward(&self.to);
        let mut torques = [Vec3::ZERO; JOINTS];
        for link in Link::ALL {
            let mut hinges = hinges_of(link);
            let Some(first) = hinges.next() else { continue };
            let rest: [Option<usize>; 2] = [hinges.next(), hinges.next()];
            let moment = moment(
                [Some(first), rest[0], rest[1]]
                    .map(|hinge| hinge.map(|hinge| (frames.axes[hinge], self.torques[hinge]))),
            );
            let back = frames.rotations[link as usize].inverse();
            torques[link.anchor() as usize] = (back * moment).as_vec3();
        }
        let feet = self.state.feet().map(|foot| FootForce {
            force: foot.force.as_vec3(),
            centre: foot.centre.as_vec3(),
            contact: f32::from(u8::from(foot.points > 0)),
        });
        Forces {
            torques,
            feet,
            ground: self.state.contact_force().as_vec3(),
        }
    }

    pub(super) fn character(&self) -> &Character {
        &self.character
    }

    /// The body pose between the last two policy steps, `share` (0 to 1) of the way.
    pub(super) fn between(&self, share: f64) -> BodyPose {
        let (from, to) = (&self.from, &self.to);
        let pose = CharacterPose {
            root: from.root.lerp(to.root, share),
            rotation: from.rotation.slerp(to.rotation, share),
            angles: std::array::from_fn(|hinge| {
                from.angles[hinge] + (to.angles[hinge] - from.angles[hinge]) * share
            }),
        };
        self.character.body_pose(&pose)
    }

    #[cfg(test)]
    pub(super) fn place(&mut self, pose: &CharacterPose, velocity: &[f64; VELOCITIES]) {
        self.state.set_pose_and_velocity(pose, velocity);
        (self.from, self.to) = (*pose, *pose);
    }

    #[cfg(test)]
    pub(super) fn moving(&self) -> (CharacterPose, [f64; VELOCITIES]) {
        (self.state.pose(), self.state.velocity())
    }
}

fn objects(state: &State) -> Objects {
    let touched = state.touched();
    let pose = |index| {
        let place = state.object(index)?;
        Some(ObjectPose {
            position: place.position.as_vec3(),
            rotation: place.rotation.as_quat().normalize(),
            touched: touched & 1 << index != 0,
        })
    };
    (0..state.objects()).filter_map(pose).collect()
}

/// The moment that has each hinge's torque about its axis, and none across them all.
fn moment(hinges: [Option<(DVec3, f64)>; 3]) -> DVec3 {
    let (Some((a, about_a)), second, third) = (hinges[0], hinges[1], hinges[2]) else {
        return DVec3::ZERO;
    };
    let Some((b, about_b)) = second else {
        return a * about_a;
    };
    let (c, about_c) = third.unwrap_or((a.cross(b).normalize_or_zero(), 0.0));
    let axes = DMat3::from_cols(a, b, c).transpose();
    // Three axes in one plane (a shoulder at its limit) leave a direction open.
    if axes.determinant().abs() < 1e-3 {
        return a * about_a + b * about_b + c * about_c;
    }
    axes.inverse() * DVec3::new(about_a, about_b, about_c)
}

fn velocity(before: &CharacterPose, here: &CharacterPose, seconds: f64) -> [f64; VELOCITIES] {
    let rate = 1.0 / seconds.max(1e-3);
    let turn = before.rotation.inverse() * here.rotation;
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let linear = (here.root - before.root) * rate;
    let angular = turn.to_scaled_axis() * rate;
    let mut velocity = [0.0; VELOCITIES];
    velocity[..3].copy_from_slice(&linear.to_array());
    velocity[3..6].copy_from_slice(&angular.to_array());
    for hinge in 0..HINGES {
        velocity[6 + hinge] = (here.angles[hinge] - before.angles[hinge]) * rate;
    }
    velocity.map(|x| x.clamp(-SPAWN_SPEED_MAX, SPAWN_SPEED_MAX))
}
