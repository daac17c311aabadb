//! The wearer's character in its world, one policy step at a time.

use glam::{DMat3, DQuat, DVec3, Vec3};
use posed_body::{
    BodyPose, JOINTS, Joint, Joints, Skeleton,
    character::{Character, CharacterPose, HINGES, Link, hinges_of},
    optimiser::FootForce,
    retarget::Retarget,
    scene::{Ground, Place, Scene},
    simulation::{Model, SimulationError, State, Step},
};

use super::{
    level::Level,
    observation::{FUTURE, SUBSTEPS, Seen, User, VELOCITIES},
    policy::Policy,
};
use crate::{
    objects::{ObjectMove, ObjectPose, Objects},
    tracker::Forces,
};

/// A velocity estimated at a spawn is cut off here: m/s and rad/s.
const SPAWN_SPEED_MAX: f64 = 8.0;

/// A character, simulated. It stands on the scene's ground; the wearer's devices, and the poses shown, are
/// as much higher as the wearer's floor is ([`Level`]): the head stays in the headset.
pub(super) struct World {
    pub(super) skeleton: Skeleton,
    character: Character,
    state: State,
    retarget: Retarget,
    ground: Ground,
    level: Level,
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
            level: Level::default(),
            objects: [objects; 2],
            retarget: Retarget::new(character.clone()),
            character,
            state,
            from: rest,
            to: rest,
            torques: [0.0; HINGES],
        })
    }

    /// The stand-in's joints, `seconds` after the last ones, say where the floor is.
    pub(super) fn stand_on(&mut self, joints: &Joints, seconds: f64) {
        let feet = [Joint::LeftAnkle, Joint::RightAnkle].map(|ankle| {
            let turn = joints.rotation(ankle).as_dquat();
            (joints.position(ankle).as_dvec3(), turn)
        });
        self.level.follow(self.lowest_sole(feet, |_| 0.0), seconds);
    }

    /// Where the floor is counts no longer.
    pub(super) fn leave_floor(&mut self) {
        self.level = Level::default();
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
        here.root.y -= self.level.height();
        let ground = |corner: DVec3| self.ground.at(corner.x, corner.z).height;
        here.root.y -= self.lowest_sole(self.feet(&here), ground).min(0.0);
        self.state.set_pose_and_velocity(&here, &velocity);
        (self.from, self.to, self.torques) = (here, here, [0.0; HINGES]);
    }

    /// Height of the character's pelvis above the ground, and where its head is, metres.
    pub(super) fn pelvis_and_head(&self) -> (f64, DVec3) {
        let floor = self.floor(self.to.root);
        let joints = self.character.joints(&self.character.forward(&self.to));
        let head = joints.position(Joint::Head).as_dvec3();
        let above = DVec3::Y * (self.level.height() - floor);
        (self.to.root.y - floor, head + above)
    }

    /// Height of the ground where somebody stands whose pelvis is at `root`, metres.
    pub(super) fn floor(&self, root: DVec3) -> f64 {
        self.ground.around(root.x, root.z)
    }

    /// Place and rotation of the feet.
    fn feet(&self, pose: &CharacterPose) -> [(DVec3, DQuat); 2] {
        let frames = self.character.forward(pose);
        [Link::LeftFoot, Link::RightFoot].map(|foot| {
            (
                frames.positions[foot as usize],
                frames.rotations[foot as usize],
            )
        })
    }

    /// Height of the lowest corner of the soles above the ground, metres.
    fn lowest_sole(&self, feet: [(DVec3, DQuat); 2], ground: impl Fn(DVec3) -> f64) -> f64 {
        let mut lowest = f64::MAX;
        for ((place, turn), sole) in feet.into_iter().zip(&self.character.soles) {
            for z in [sole.heel, sole.ball] {
                for x in [-sole.half_width, sole.half_width] {
                    let corner = place + turn * DVec3::new(x, sole.y, z);
                    lowest = lowest.min(corner.y - ground(corner));
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
        let mut user = *user;
        for part in user.iter_mut().flatten() {
            part.position.y -= self.level.height();
        }
        let seen = Seen {
            character: &self.character,
            pose: &pose,
            floor: self.floor(pose.root),
            velocity: &self.state.velocity(),
            feet: self.state.feet().map(|foot| foot.force),
            user: &user,
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

    /// The body pose between the last two policy steps, `share` (0 to 1) of the way.
    pub(super) fn between(&self, share: f64) -> BodyPose {
        let (from, to) = (&self.from, &self.to);
        let pose = CharacterPose {
            root: from.root.lerp(to.root, share) + DVec3::Y * self.level.height(),
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
