//! The things in a tracker's scene, as they leave and reach it.

use std::ops::Deref;

use glam::{Quat, Vec3};
use posed_body::scene::{EXTENT_MAX, OBJECTS_MAX};

/// Where a thing is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectPose {
    /// Its centre in the world, metres; of a chair the middle of the seat's footprint on the ground.
    pub position: Vec3,
    /// From its own frame to the world, unit.
    pub rotation: Quat,
    /// Whether the body touched it in the last step of the simulation.
    pub touched: bool,
}

impl ObjectPose {
    /// At the origin, untouched.
    pub const REST: Self = Self {
        position: Vec3::ZERO,
        rotation: Quat::IDENTITY,
        touched: false,
    };

    /// Between two, `share` (0 to 1) of the way.
    #[must_use]
    pub fn between(&self, after: &Self, share: f32) -> Self {
        Self {
            position: self.position.lerp(after.position, share),
            rotation: self.rotation.slerp(after.rotation, share).normalize(),
            touched: after.touched,
        }
    }
}

/// The things in a scene, in the scene's order; at most [`OBJECTS_MAX`]. It is `Copy`, so that it
/// passes from the tracker thread without allocation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objects {
    count: usize,
    poses: [ObjectPose; OBJECTS_MAX],
}

impl Objects {
    /// An empty scene.
    pub const NONE: Self = Self {
        count: 0,
        poses: [ObjectPose::REST; OBJECTS_MAX],
    };

    /// Adds one; a scene that is full stays as it is.
    pub fn push(&mut self, pose: ObjectPose) {
        if let Some(slot) = self.poses.get_mut(self.count) {
            *slot = pose;
            self.count += 1;
        }
    }

    /// Whether every number is finite, and every rotation unit.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let sound = |pose: &ObjectPose| {
            pose.position.is_finite() && (pose.rotation.length() - 1.0).abs() < 1e-3
        };
        self.iter().all(sound)
    }

    /// Between two moments of one scene, `share` (0 to 1) of the way.
    #[must_use]
    pub fn between(&self, after: &Self, share: f32) -> Self {
        let mut made = *after;
        for (pose, before) in made.poses[..made.count].iter_mut().zip(self.iter()) {
            *pose = before.between(pose, share);
        }
        made
    }
}

impl Default for Objects {
    fn default() -> Self {
        Self::NONE
    }
}

impl FromIterator<ObjectPose> for Objects {
    fn from_iter<T: IntoIterator<Item = ObjectPose>>(poses: T) -> Self {
        let mut objects = Self::NONE;
        poses.into_iter().for_each(|pose| objects.push(pose));
        objects
    }
}

impl Deref for Objects {
    type Target = [ObjectPose];

    fn deref(&self) -> &[ObjectPose] {
        &self.poses[..self.count]
    }
}

/// Puts a thing somewhere else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectMove {
    /// Which one, in the scene's order.
    pub index: usize,
    /// Where to: as [`ObjectPose::position`].
    pub position: Vec3,
    /// Unit, to the world.
    pub rotation: Quat,
    /// How it moves on from there, m/s. One without a mass stays.
    pub velocity: Vec3,
    /// How it turns, rad/s about the world's axes.
    pub angular_velocity: Vec3,
}

/// The fastest that a thing may be thrown, m/s.
pub const SPEED_MAX: f32 = 30.0;
/// The fastest that it may spin, rad/s.
pub const SPIN_MAX: f32 = 100.0;

impl ObjectMove {
    /// What is wrong with it in a scene of `count` things; `None` where nothing is.
    #[must_use]
    pub fn problem(&self, count: usize) -> Option<&'static str> {
        // Written so that what is no number is refused.
        let within = |v: Vec3, limit: f32| v.abs().to_array().into_iter().all(|x| x <= limit);
        let unit = (self.rotation.length() - 1.0).abs() <= 0.01;
        match () {
            () if self.index >= count => Some("is not in the scene"),
            () if !within(self.position, EXTENT_MAX as f32) => Some("goes more than 100 m away"),
            () if !unit => Some("has a rotation that is no unit quaternion"),
            () if !within(self.velocity, SPEED_MAX) => Some("is faster than 30 m/s along an axis"),
            () if !within(self.angular_velocity, SPIN_MAX) => {
                Some("turns faster than 100 rad/s about an axis")
            }
            () => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f32) -> ObjectPose {
        ObjectPose {
            position: Vec3::X * x,
            ..ObjectPose::REST
        }
    }

    #[test]
    fn no_more_than_a_scene_has_room_for() {
        let objects: Objects = (0..100u8).map(|x| pose(f32::from(x))).collect();
        assert_eq!(objects.len(), OBJECTS_MAX);
        assert_eq!(objects[3], pose(3.0));
        assert!(objects.is_sound());
        let after: Objects = [pose(5.0)].into_iter().collect();
        let between = objects.between(&after, 0.5);
        assert_eq!(*between, [pose(2.5)]);
        let broken: Objects = [pose(f32::NAN)].into_iter().collect();
        assert!(!broken.is_sound());
    }

    #[test]
    fn moves_that_make_no_sense_are_refused() {
        let good = ObjectMove {
            index: 1,
            position: Vec3::ONE,
            rotation: Quat::IDENTITY,
            velocity: Vec3::X * 30.0,
            angular_velocity: Vec3::ZERO,
        };
        assert_eq!(good.problem(2), None);
        assert_eq!(good.problem(1), Some("is not in the scene"));
        for x in [f32::NAN, f32::INFINITY, 1e9] {
            let long = Vec3::new(0.0, x, 0.0);
            let wrong = [
                ObjectMove {
                    position: long,
                    ..good
                },
                ObjectMove {
                    velocity: long,
                    ..good
                },
                ObjectMove {
                    angular_velocity: long,
                    ..good
                },
                ObjectMove {
                    rotation: Quat::from_xyzw(0.0, x, 0.0, 1.0),
                    ..good
                },
            ];
            for wrong in wrong {
                assert!(wrong.problem(2).is_some(), "{wrong:?}");
            }
        }
        let zero = ObjectMove {
            rotation: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
            ..good
        };
        assert!(zero.problem(2).is_some());
    }
}
