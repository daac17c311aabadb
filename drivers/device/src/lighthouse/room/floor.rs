//! Where the floor is and which way is ahead: light and accelerometer do not know. The set-up
//! command tells; without it, the wearer's first seconds upright do.

use glam::{DQuat, DVec3};
use posed_signal::Role;
use serde::{Deserialize, Serialize};

use super::Room;
use crate::lighthouse::model::{DeviceModel, Frame};

/// How the floor's height and the heading are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Floor {
    /// Not at all: the headset that was seen first is taken to be worn by someone who stands.
    #[default]
    Assumed,
    /// From the wearer's first seconds upright, and the wearer's height.
    Upright,
    /// From the set-up command.
    Setup,
}

/// Eyes are this far below the top of the head, as a share of the stature.
const EYES: f64 = 0.936;
/// A step of the wearer's feet that this makes is none, m.
const SMALL: f64 = 0.02;

impl Room {
    /// How the floor's height and the heading are known.
    #[must_use]
    pub fn floor(&self) -> Floor {
        self.floor
    }

    /// Whether the wearer's first seconds upright are of use.
    pub(in crate::lighthouse) fn wants_upright(&self) -> bool {
        !self.given && self.floor == Floor::Assumed && self.stature.is_some()
    }

    /// The wearer's height, m, for the first seconds upright.
    pub fn set_stature(&mut self, metres: f64) {
        self.stature = Some(metres);
    }

    /// The wearer stands upright with the eyes at this height of the present world, m.
    pub(in crate::lighthouse) fn upright(&mut self, eyes: f64) {
        let Some(stature) = self.stature.filter(|_| self.wants_upright()) else {
            return;
        };
        self.floor = Floor::Upright;
        self.revision += 1;
        let shift = EYES * stature - eyes;
        if shift.abs() > SMALL {
            self.carry(DQuat::IDENTITY, DVec3::Y * shift);
        }
    }

    /// Moves the whole world, with everything in it, by a turn and then a shift.
    fn carry(&mut self, turn: DQuat, shift: DVec3) {
        for station in self.stations.iter_mut().flatten() {
            let station = &mut station.station;
            station.position = turn * station.position + shift;
            station.rotation = (turn * station.rotation).normalize();
        }
        for (snapshot, frame) in &mut self.snapshots {
            snapshot.pose = None;
            frame.position = turn * frame.position + shift;
            frame.rotation = (turn * frame.rotation).normalize();
        }
        self.revision += 1;
        self.world += 1;
        self.carried = Some(Frame {
            position: shift,
            rotation: turn,
        });
    }

    /// Puts the floor at `height` (m) of the present world.
    pub fn set_floor(&mut self, height: f64) {
        self.floor = Floor::Setup;
        self.carry(DQuat::IDENTITY, DVec3::Y * -height);
    }

    /// Makes where someone stands the origin, and where they look ahead, -Z.
    pub fn set_heading(&mut self, position: DVec3, rotation: DQuat) {
        let ahead = rotation * DVec3::NEG_Z;
        let turn = DQuat::from_rotation_y(ahead.x.atan2(-ahead.z));
        let origin = turn * DVec3::new(position.x, 0.0, position.z);
        self.carry(turn, -origin);
    }

    /// How far below its head frame's origin a headset reaches that lies at `rotation`, m, as a
    /// negative number: its sensors, which sit under its skin, tell its shape. 0 where no headset
    /// has been seen.
    #[must_use]
    pub fn lowest(&self, rotation: DQuat) -> f64 {
        let is_headset = |model: &&DeviceModel| model.identity.natural_role == Role::Head;
        let mut models = self.snapshots.iter().map(|(snapshot, _)| &*snapshot.model);
        let Some(model) = models.rfind(is_headset) else {
            return 0.0;
        };
        let heights = model.sensors.iter().flatten().map(|sensor| {
            let arm = sensor.position - model.head.position;
            (rotation * (model.head.rotation.conjugate() * arm)).y
        });
        heights.fold(0.0, f64::min)
    }
}
