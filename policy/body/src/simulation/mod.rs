//! The character in a scene, simulated by MuJoCo 3.17.
//!
//! A [`Model`] is immutable and shared; a [`State`] is one world that runs on it and can be
//! cloned. Stepping allocates nothing. A state that stops being finite is put back to the last
//! sound one and says so.

mod objects;
mod state;

use std::sync::Arc;

use mujoco_rs::prelude::{MjModel, MjtObjBase};

pub use state::{FootContact, State, Step};

use crate::character::{Character, CharacterError, Link, put, write_actuators, write_body};
use crate::scene::{Scene, SceneError, write_assets, write_world};

/// Time of one physics step, seconds: four to a policy step at 36 Hz.
pub const TIME_STEP: f64 = 1.0 / 144.0;
/// Acceleration of gravity, m/s².
pub const GRAVITY: f64 = 9.81;

/// Why a model cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The scene holds unsound numbers.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The character cannot be built.
    #[error(transparent)]
    Character(#[from] CharacterError),
    /// MuJoCo refused the model.
    #[error("MuJoCo refuses the model: {0}")]
    Mujoco(String),
}

/// What all states of one simulation share.
#[derive(Debug)]
struct Shared {
    character: Character,
    scene: Scene,
    /// For each geom: the foot it belongs to, 0 left, 1 right.
    foot_of_geom: Box<[Option<u8>]>,
    /// For each geom: whether it belongs to the character.
    of_character: Box<[bool]>,
    /// For each geom: the object of the scene that it belongs to.
    object_of_geom: Box<[Option<u8>]>,
    /// For each object of the scene: where MuJoCo keeps its place.
    slots: Box<[Slot]>,
}

/// Where MuJoCo keeps an object's place.
#[derive(Debug, Clone, Copy)]
enum Slot {
    /// The `n`th loose object: coordinates after the character's.
    Loose(usize),
    /// The `n`th of those that stay where they are put.
    Fixed(usize),
}

/// An immutable simulation model.
#[derive(Debug, Clone)]
pub struct Model {
    mujoco: Arc<MjModel>,
    shared: Arc<Shared>,
}

/// The whole MJCF document of a character in a scene.
#[must_use]
pub fn document(character: &Character, scene: &Scene) -> String {
    let mut xml = String::with_capacity(1 << 15);
    put(
        &mut xml,
        format_args!(
            "<mujoco model=\"posed\">\n<compiler angle=\"radian\" autolimits=\"true\"/>\n\
             <option timestep=\"{TIME_STEP:.12}\" gravity=\"0 -{GRAVITY} 0\" \
             integrator=\"implicitfast\" iterations=\"20\" ls_iterations=\"10\">\
             <flag energy=\"enable\" autoreset=\"disable\"/></option>\n\
             <default>\n<joint frictionloss=\"0.1\"/>\n\
             <geom friction=\"{} 0.005 0.0001\" condim=\"3\"/>\n",
            scene.friction
        ),
    );
    // Bit 0: what the character touches; bit 1: what loose objects touch.
    xml.push_str(
        "<default class=\"body\"><geom contype=\"1\" conaffinity=\"0\"/></default>\n\
         <default class=\"scene\"><geom contype=\"0\" conaffinity=\"3\"/></default>\n\
         <default class=\"movable\"><geom contype=\"2\" conaffinity=\"3\"/></default>\n\
         </default>\n",
    );
    write_assets(scene, &mut xml);
    xml.push_str("<worldbody>\n");
    // The character comes first, so that its coordinates do.
    write_body(character, &mut xml);
    write_world(scene, &mut xml);
    xml.push_str("</worldbody>\n");
    write_actuators(character, &mut xml);
    write_sensors(&mut xml);
    xml.push_str("</mujoco>\n");
    xml
}

/// What a batch of worlds is read by: the sum of the forces on each foot, in the world. One
/// world's are [`State::feet`].
fn write_sensors(xml: &mut String) {
    xml.push_str("<sensor>\n");
    for foot in [Link::LeftFoot, Link::RightFoot] {
        put(
            xml,
            format_args!(
                "<contact name=\"{0}\" body1=\"{0}\" num=\"1\" reduce=\"netforce\" \
                 data=\"force\"/>\n",
                foot.name()
            ),
        );
    }
    xml.push_str("</sensor>\n");
}

impl Model {
    /// Builds the model of a character in a scene.
    ///
    /// # Errors
    /// When the scene is unsound or MuJoCo refuses the document.
    pub fn new(character: Character, scene: Scene) -> Result<Self, SimulationError> {
        scene.validate()?;
        let mujoco = MjModel::from_xml_string(&document(&character, &scene))
            .map_err(|error| SimulationError::Mujoco(error.to_string()))?;
        let names = mujoco.ffi().ngeom as usize;
        let name = |geom| {
            mujoco
                .id_to_name(MjtObjBase::mjOBJ_GEOM, geom)
                .unwrap_or("")
        };
        let foot = |geom| match name(geom) {
            name if name.starts_with(Link::LeftFoot.name()) => Some(0),
            name if name.starts_with(Link::RightFoot.name()) => Some(1),
            _ => None,
        };
        let of_character = |geom| {
            Link::ALL
                .into_iter()
                .any(|link| name(geom).starts_with(link.name()))
        };
        let object = |geom| {
            let number = name(geom).strip_prefix("object_")?;
            number.split('_').next()?.parse().ok()
        };
        let (mut loose, mut fixed) = (0.., 0..);
        let slots = scene.objects.iter().filter_map(|object| {
            Some(if object.is_loose() {
                Slot::Loose(loose.next()?)
            } else {
                Slot::Fixed(fixed.next()?)
            })
        });
        let slots = slots.collect();
        let object_of_geom = (0..names).map(object).collect();
        let foot_of_geom = (0..names).map(foot).collect();
        let of_character = (0..names).map(of_character).collect();
        let shared = Arc::new(Shared {
            character,
            scene,
            foot_of_geom,
            of_character,
            object_of_geom,
            slots,
        });
        Ok(Self {
            mujoco: Arc::new(mujoco),
            shared,
        })
    }

    /// The character.
    #[must_use]
    pub fn character(&self) -> &Character {
        &self.shared.character
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.shared.scene
    }

    /// A world in which the character stands in the rest pose and everything is at rest.
    #[must_use]
    pub fn state(&self) -> State {
        State::new(self)
    }
}

#[cfg(test)]
mod tests;
