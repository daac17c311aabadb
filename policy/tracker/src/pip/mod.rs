//! PIP (Yi et al. 2022): the whole body from six inertial sensors, with the torques that move it
//! and the forces that carry it.
//!
//! Each tick the sensors are heard ([`sensors`]), five recurrent networks make their steps of 1/60 s
//! ([`grid`], [`features`], [`network`]), and physics makes a motion of what they say
//! ([`dynamics`]). Without a headset the body begins over the origin and walks from there; a headset
//! with a position holds it where it is. `ik` stands in while too few sensors are heard.

mod dynamics;
mod features;
mod grid;
mod network;
mod sensors;

use posed_body::BodyPose;
use posed_signal::{HostTime, Role};

use crate::{
    fade::TakeOver,
    geometry::is_human,
    ik::Ik,
    inference::{InferenceError, Runtime},
    presence::Sensed,
    tracker::{Input, Quality, Tracked, Tracker, TrackerKind, Wearer},
    worn::Stance,
};
use dynamics::Dynamics;
use grid::{Grid, Tick};
use network::Step;
use sensors::{Ears, Heard};

pub use dynamics::Physics;

/// Sensors without which nothing is shown: with more missing the networks only guess.
const SENSORS_MIN: usize = 4;
/// A longer gap between ticks counts as this long, seconds.
const GAP_MAX: f32 = 0.5;

/// How the tracker works; the default is what ships.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    /// What makes the body's motion out of the networks' answer.
    pub physics: Physics,
}

/// The tracker.
pub struct Pip {
    network: Step,
    body: Dynamics,
    grid: Grid,
    ears: Ears,
    ik: Ik,
    /// The wearer's pose at the next tick, told beforehand.
    known: Option<BodyPose>,
    last: Option<HostTime>,
    shown: TakeOver,
}

impl Pip {
    /// Loads the model `bytes`; `name` is for errors.
    ///
    /// # Errors
    /// The bytes are no model, or one with other inputs and outputs than this program's.
    pub fn load(
        runtime: &Runtime,
        name: &str,
        bytes: &[u8],
        options: Options,
    ) -> Result<Self, InferenceError> {
        Ok(Self {
            network: Step::load(runtime, name, bytes)?,
            body: Dynamics::new(&Wearer::of_height(1.75), options.physics),
            grid: Grid::default(),
            ears: Ears::default(),
            ik: Ik::default(),
            known: None,
            last: None,
            shown: TakeOver::NONE,
        })
    }

    /// The body at the tick; `None` while too little is heard.
    fn predict(&mut self, input: &Input<'_>) -> (Option<BodyPose>, Heard) {
        let (seen, heard) = self.ears.listen(input);
        let usable = heard.count >= SENSORS_MIN && heard.pelvis;
        if !usable || !is_human(&input.wearer.skeleton) {
            self.grid.reset();
            return (None, heard);
        }
        if !self.body.fits(input.wearer) {
            self.body.wear(input.wearer);
            self.grid.reset();
        }
        let head = Sensed::from_lookup(&input.part(Role::Head)).filter(|head| head.solid);
        let tick = Tick {
            now: input.target,
            seen,
            wearer: input.wearer,
            head: head.map(|head| head.place.position),
            known: self.known.take(),
        };
        let pose = self
            .grid
            .advance(&tick, &mut self.network, &mut self.body)
            .filter(BodyPose::is_sound);
        (pose, heard)
    }
}

/// How far to trust a pose made from so many sensors.
fn quality(heard: Heard) -> Quality {
    match heard.count {
        sensors::SENSORS => Quality::Full,
        SENSORS_MIN.. => Quality::Partial,
        _ => Quality::Degraded,
    }
}

impl Tracker for Pip {
    fn kind(&self) -> TrackerKind {
        TrackerKind::Pip
    }

    fn reset(&mut self) {
        self.grid.reset();
        self.body.reset();
        self.ears = Ears::default();
        self.ik.reset();
        self.known = None;
        (self.last, self.shown) = (None, TakeOver::NONE);
    }

    fn calibrate(&mut self, _stance: Stance) {
        // The memory begins anew with somebody who stands, the arms as their sensors say.
        self.grid.reset();
        self.known = None;
    }

    fn contacts(&self) -> Option<[f32; 2]> {
        self.grid.contact()
    }

    fn begin(&mut self, pose: &BodyPose) {
        self.grid.reset();
        self.known = Some(*pose);
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let dt = self
            .last
            .map_or(0.0, |last| input.target.since_secs(last) as f32);
        self.last = Some(input.target);
        let dt = dt.clamp(0.0, GAP_MAX);
        let stand_in = self.ik.track(input);
        let skeleton = &input.wearer.skeleton;
        let (predicted, heard) = self.predict(input);
        let Some(source) = predicted else {
            let pose = self.shown.show(&stand_in.pose, stand_in.kind, skeleton, dt);
            return Tracked { pose, ..stand_in };
        };
        Tracked {
            pose: self.shown.show(&source, TrackerKind::Pip, skeleton, dt),
            quality: quality(heard),
            kind: TrackerKind::Pip,
            forces: self.grid.forces(),
        }
    }
}

#[cfg(test)]
mod tests;
