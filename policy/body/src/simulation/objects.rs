//! The scene's objects in a running world.

use glam::{DQuat, DVec3};

use super::{
    Slot, State,
    state::{ROOT_COORDINATES, ROOT_VELOCITIES},
};
use crate::{
    character::HINGES,
    scene::{EXTENT_MAX, Place},
};

/// The first coordinate and the first velocity of the `n`th loose object.
fn addresses(n: usize) -> (usize, usize) {
    (
        ROOT_COORDINATES + HINGES + 7 * n,
        ROOT_VELOCITIES + HINGES + 6 * n,
    )
}

fn place(position: &[f64], [w, x, y, z]: [f64; 4]) -> Place {
    Place {
        position: DVec3::from_slice(position),
        rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
    }
}

impl State {
    /// Number of objects in the scene.
    #[must_use]
    pub fn objects(&self) -> usize {
        self.shared.slots.len()
    }

    /// Where the `index`th object of the scene is.
    #[must_use]
    pub fn object(&self, index: usize) -> Option<Place> {
        Some(match *self.shared.slots.get(index)? {
            Slot::Loose(n) => {
                let at = addresses(n).0;
                let qpos = self.data.qpos().get(at..at + 7)?;
                place(qpos, [qpos[3], qpos[4], qpos[5], qpos[6]])
            }
            Slot::Fixed(n) => {
                let (position, turn) = self.fixed.get(n)?;
                place(position, *turn)
            }
        })
    }

    /// Puts an object somewhere. A loose one moves on from there with these velocities, linear
    /// (m/s) and angular (rad/s) in the world; one without a mass stays. Numbers that are not
    /// finite, or beyond the extent of scenes, and indices without an object are ignored.
    pub fn put_object(&mut self, index: usize, to: &Place, velocity: [DVec3; 2]) {
        let near = to.position.abs().max_element() <= EXTENT_MAX;
        let turn = to.rotation.normalize();
        if !near || !turn.is_finite() || velocity.iter().any(|v| !v.is_finite()) {
            return;
        }
        let quat = [turn.w, turn.x, turn.y, turn.z];
        match self.shared.slots.get(index).copied() {
            Some(Slot::Loose(n)) => {
                let (at, moves) = addresses(n);
                let qpos = self.data.qpos_mut();
                qpos[at..at + 3].copy_from_slice(&to.position.to_array());
                qpos[at + 3..at + 7].copy_from_slice(&quat);
                self.sound[at..at + 7].copy_from_slice(&qpos[at..at + 7]);
                let [linear, angular] = velocity;
                // MuJoCo has a free body's spin in the body's own frame.
                let spin = turn.inverse() * angular;
                let qvel = self.data.qvel_mut();
                qvel[moves..moves + 3].copy_from_slice(&linear.to_array());
                qvel[moves + 3..moves + 6].copy_from_slice(&spin.to_array());
            }
            Some(Slot::Fixed(n)) => {
                self.fixed[n] = (to.position.to_array(), quat);
                self.put_fixed();
            }
            None => return,
        }
        self.data.forward();
    }

    /// Puts every object where the scene has it, at rest.
    pub fn put_objects_back(&mut self) {
        for index in 0..self.objects() {
            let to = self.shared.scene.objects[index].place();
            self.put_object(index, &to, [DVec3::ZERO; 2]);
        }
    }

    /// Puts objects that have rolled or fallen out of the scene's extent where the scene has them.
    pub fn fetch_objects(&mut self) {
        for index in 0..self.objects() {
            let gone = |at: Place| at.position.abs().max_element() > EXTENT_MAX;
            if self.object(index).is_some_and(gone) {
                let to = self.shared.scene.objects[index].place();
                self.put_object(index, &to, [DVec3::ZERO; 2]);
            }
        }
    }

    /// Which objects the character touched during the last call of [`State::step`]: bit `n` is set
    /// for the `n`th.
    #[must_use]
    pub fn touched(&self) -> u32 {
        self.touched
    }

    /// Notes which objects the character touches.
    pub(super) fn note_touches(&mut self) {
        if self.shared.slots.is_empty() {
            return;
        }
        let (mut touched, shared) = (0, &self.shared);
        for contact in self.data.contact() {
            let geoms = contact.geom.map(|geom| geom as usize);
            let of_character = geoms.iter().any(|&geom| shared.of_character[geom]);
            if contact.efc_address < 0 || !of_character {
                continue;
            }
            let objects = geoms.iter().filter_map(|&geom| shared.object_of_geom[geom]);
            objects.for_each(|object| touched |= 1 << object);
        }
        self.touched |= touched;
    }

    pub(super) fn put_fixed(&mut self) {
        for (to, (position, _)) in self.data.mocap_pos_mut().iter_mut().zip(&self.fixed) {
            *to = *position;
        }
        for (to, (_, turn)) in self.data.mocap_quat_mut().iter_mut().zip(&self.fixed) {
            *to = *turn;
        }
    }
}
