//! Scenes: the ground and what stands on it, as read from a TOML file.
//!
//! ```toml
//! friction = 1.0
//!
//! [ground]
//! kind = "steps"
//! start = 0.8
//! rise = 0.15
//! run = 0.3
//! count = 4
//!
//! [[objects]]
//! kind = "ball"
//! radius = 0.11
//! mass = 0.43
//! position = [0.5, 0.5, -1.0]
//! ```

mod ground;
mod mjcf;
mod samples;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

pub use ground::{Ground, Surface};
pub use mjcf::{write_assets, write_world};
pub use samples::samples;

/// A scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Coefficient of friction of ground and objects.
    #[serde(default = "default_friction")]
    pub friction: f64,
    /// The ground.
    #[serde(default)]
    pub ground: Ground,
    /// What stands on it.
    #[serde(default)]
    pub objects: Vec<Object>,
}

/// QuestSim's floor (appendix).
fn default_friction() -> f64 {
    1.0
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            friction: default_friction(),
            ground: Ground::default(),
            objects: Vec::new(),
        }
    }
}

/// A thing in the scene. Positions are of its centre, of a chair the middle of the seat's
/// footprint on the ground; metres, in the world. `yaw` turns about +Y, degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Object {
    /// A box; it is fixed unless it has a mass in kilograms.
    Box {
        /// Edge lengths along x, y and z, metres.
        size: [f64; 3],
        /// Its centre.
        position: [f64; 3],
        /// Heading, degrees.
        #[serde(default)]
        yaw: f64,
        /// Kilograms; none: it does not move.
        #[serde(default)]
        mass: Option<f64>,
    },
    /// A ball.
    Ball {
        /// Radius, metres.
        radius: f64,
        /// Its centre.
        position: [f64; 3],
        /// Kilograms.
        mass: f64,
    },
    /// A fixed chair: seat, back and four legs; its front looks along -Z.
    Chair {
        /// The middle of the seat, on the ground.
        position: [f64; 3],
        /// Heading, degrees.
        #[serde(default)]
        yaw: f64,
        /// Height of the seat, metres.
        #[serde(default = "default_seat")]
        seat: f64,
    },
}

fn default_seat() -> f64 {
    0.45
}

/// What is wrong with a scene.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the scene's {part} {problem}")]
pub struct SceneError {
    part: String,
    problem: String,
}

/// Most objects that a scene may have.
pub const OBJECTS_MAX: usize = 16;
/// Greatest coordinate of anything in a scene, metres.
pub const EXTENT_MAX: f64 = 100.0;

fn check(part: &str, ok: bool, problem: &str) -> Result<(), SceneError> {
    if ok {
        Ok(())
    } else {
        Err(SceneError {
            part: part.into(),
            problem: problem.into(),
        })
    }
}

impl Scene {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the part and what is wrong with it.
    pub fn validate(&self) -> Result<(), SceneError> {
        check(
            "friction",
            (0.01..=5.0).contains(&self.friction),
            "must be a number from 0.01 to 5",
        )?;
        self.ground.validate()?;
        let count = self.objects.len();
        check(
            "list of objects",
            count <= OBJECTS_MAX,
            "is longer than 16 objects",
        )?;
        for (index, object) in self.objects.iter().enumerate() {
            object.validate(&format!("object {index}"))?;
        }
        Ok(())
    }
}

/// Where an object is: its centre, of a chair the middle of the seat's footprint on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Metres, in the world.
    pub position: DVec3,
    /// Unit, from the object's frame to the world.
    pub rotation: DQuat,
}

impl Object {
    /// Whether the body and other objects can push it: it has a mass.
    #[must_use]
    pub fn is_loose(&self) -> bool {
        match self {
            Self::Box { mass, .. } => mass.is_some(),
            Self::Ball { .. } => true,
            Self::Chair { .. } => false,
        }
    }

    /// Where the scene puts it.
    #[must_use]
    pub fn place(&self) -> Place {
        let (position, yaw) = match self {
            Self::Box { position, yaw, .. } | Self::Chair { position, yaw, .. } => (position, *yaw),
            Self::Ball { position, .. } => (position, 0.0),
        };
        Place {
            position: DVec3::from_array(*position),
            rotation: DQuat::from_rotation_y(yaw.to_radians()),
        }
    }

    fn validate(&self, part: &str) -> Result<(), SceneError> {
        let length = |value: f64| (0.01..=20.0).contains(&value);
        let mass = |value: f64| (0.01..=1000.0).contains(&value);
        let near = |position: &[f64; 3]| position.iter().all(|x| x.abs() <= EXTENT_MAX);
        let angle = |value: f64| value.abs() <= 360.0;
        match self {
            Self::Box {
                size,
                position,
                yaw,
                mass: kilograms,
            } => {
                check(
                    part,
                    size.iter().all(|&x| length(x)),
                    "has an edge outside 0.01 to 20 m",
                )?;
                check(part, near(position), "is further than 100 m away")?;
                check(part, angle(*yaw), "has a yaw outside ±360°")?;
                check(
                    part,
                    kilograms.is_none_or(mass),
                    "has a mass outside 0.01 to 1000 kg",
                )
            }
            Self::Ball {
                radius,
                position,
                mass: kilograms,
            } => {
                check(part, length(*radius), "has a radius outside 0.01 to 20 m")?;
                check(part, near(position), "is further than 100 m away")?;
                check(part, mass(*kilograms), "has a mass outside 0.01 to 1000 kg")
            }
            Self::Chair {
                position,
                yaw,
                seat,
            } => {
                check(part, near(position), "is further than 100 m away")?;
                check(part, angle(*yaw), "has a yaw outside ±360°")?;
                check(
                    part,
                    (0.1..=1.5).contains(seat),
                    "has a seat outside 0.1 to 1.5 m",
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_reads_from_toml() {
        let text = "[ground]\nkind = \"slope\"\ndegrees = 8.0\n\n[[objects]]\nkind = \"chair\"\n\
                    position = [0.0, 0.0, 1.0]\n\n[[objects]]\nkind = \"box\"\n\
                    size = [0.4, 0.3, 0.4]\nposition = [1.0, 0.15, 0.0]\nmass = 6.0\n";
        let scene: Scene = toml::from_str(text).expect("a sound scene");
        scene.validate().expect("sound numbers");
        assert_eq!(scene.friction, 1.0);
        assert_eq!(
            scene.ground,
            Ground::Slope {
                degrees: 8.0,
                heading: 0.0
            }
        );
        assert_eq!(scene.objects.len(), 2);
        let again: Scene =
            toml::from_str(&toml::to_string(&scene).expect("writes")).expect("reads back");
        assert_eq!(again, scene);
    }

    #[test]
    fn unsound_scenes_say_what_is_wrong() {
        let ball = |radius| Object::Ball {
            radius,
            position: [0.0; 3],
            mass: 1.0,
        };
        let mut scene = Scene {
            objects: vec![ball(0.1), ball(f64::NAN)],
            ..Scene::default()
        };
        let error = scene.validate().expect_err("a radius that is not a number");
        assert!(error.to_string().contains("object 1"), "{error}");
        scene.objects.clear();
        scene.friction = f64::INFINITY;
        assert!(scene.validate().is_err());
        assert!(toml::from_str::<Scene>("[ground]\nkind = \"lava\"\n").is_err());
    }
}
