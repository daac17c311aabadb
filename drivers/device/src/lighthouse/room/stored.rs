//! The room as it is kept from one start to the next: JSON, in posed's world.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::{Room, Station};
use crate::lighthouse::{
    base_station::{BaseStation, Source},
    reproject::PlaneCalibration,
};

/// Version of the file; others are not read.
const VERSION: u32 = 1;
/// Stations stand within this of the origin, m.
const FAR: f64 = 100.0;

/// Why a kept room cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoredError {
    /// The text is not what posed writes.
    #[error("not a room that posed wrote: {0}")]
    Syntax(#[from] serde_json::Error),
    /// Another posed wrote it.
    #[error("the room is of version {0}, this posed reads version {VERSION}")]
    Version(u32),
    /// A number makes no sense.
    #[error("base station {id:08x}: {what}")]
    Station {
        /// Serial number of the station.
        id: u32,
        /// What is wrong with it.
        what: &'static str,
    },
}

/// A room to keep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stored {
    version: u32,
    /// How the floor's height and the heading are known.
    floor: super::Floor,
    stations: Vec<Entry>,
}

/// A base station with a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Entry {
    /// Channel of a generation-2 station.
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<u8>,
    /// Slot of a generation-1 station: 0 flashes first.
    #[serde(skip_serializing_if = "Option::is_none")]
    slot: Option<u8>,
    /// Serial number; 0 until it was heard.
    id: u32,
    /// Metres.
    position: [f64; 3],
    /// Its frame (looks along -Z, Y up) to the world; x, y, z, w.
    rotation: [f64; 4],
    /// Standard deviation of its pose relative to the first station, m and rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sigma: Option<[f64; 2]>,
    /// Whether the shape of its planes was heard from it, or is taken as typical.
    heard: bool,
    planes: [Plane; 2],
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Plane {
    phase: f64,
    tilt: f64,
    curve: f64,
    gibphase: f64,
    gibmag: f64,
    ogeephase: f64,
    ogeemag: f64,
}

impl Stored {
    /// Whether it holds no station.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.stations.is_empty()
    }

    /// As text.
    ///
    /// # Errors
    /// None that can come of finite numbers.
    pub fn to_json(&self) -> Result<String, StoredError> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    /// Reads the text of [`Stored::to_json`].
    ///
    /// # Errors
    /// It is something else, or a station makes no sense.
    pub fn from_json(text: &str) -> Result<Self, StoredError> {
        let stored: Self = serde_json::from_str(text)?;
        if stored.version != VERSION {
            return Err(StoredError::Version(stored.version));
        }
        for entry in &stored.stations {
            entry.check()?;
        }
        Ok(stored)
    }
}

impl Entry {
    fn new(station: &Station) -> Self {
        let (channel, slot) = match station.station.source {
            Source::Channel(channel) => (Some(channel), None),
            Source::Slot(slot) => (None, Some(slot)),
        };
        Self {
            channel,
            slot,
            id: station.station.id,
            position: station.station.position.to_array(),
            rotation: station.station.rotation.to_array(),
            sigma: station.sigma,
            heard: station.heard,
            planes: station.station.calibration.map(|plane| Plane {
                phase: plane.phase,
                tilt: plane.tilt,
                curve: plane.curve,
                gibphase: plane.gibphase,
                gibmag: plane.gibmag,
                ogeephase: plane.ogeephase,
                ogeemag: plane.ogeemag,
            }),
        }
    }

    fn source(&self) -> Option<Source> {
        match (self.channel, self.slot) {
            (Some(channel @ 0..16), None) => Some(Source::Channel(channel)),
            (None, Some(slot @ 0..2)) => Some(Source::Slot(slot)),
            _ => None,
        }
    }

    fn check(&self) -> Result<(), StoredError> {
        let fail = |what| Err(StoredError::Station { id: self.id, what });
        if self.source().is_none() {
            return fail("it has neither a channel from 0 to 15 nor a slot of 0 or 1");
        }
        if self
            .position
            .iter()
            .any(|metres| !(-FAR..=FAR).contains(metres))
        {
            return fail("its position lies far outside of any room");
        }
        if (DQuat::from_array(self.rotation).length() - 1.0).abs() > 0.01 {
            return fail("its rotation is not a unit quaternion");
        }
        // JSON knows no numbers but finite ones.
        Ok(())
    }

    fn station(&self, source: Source) -> Station {
        Station {
            station: BaseStation {
                source,
                id: self.id,
                position: DVec3::from_array(self.position),
                rotation: DQuat::from_array(self.rotation).normalize(),
                calibration: self.planes.map(|plane| PlaneCalibration {
                    phase: plane.phase,
                    tilt: plane.tilt,
                    curve: plane.curve,
                    gibphase: plane.gibphase,
                    gibmag: plane.gibmag,
                    ogeephase: plane.ogeephase,
                    ogeemag: plane.ogeemag,
                }),
            },
            placed: true,
            heard: self.heard,
            up: None,
            sigma: self.sigma,
        }
    }
}

impl Room {
    /// The room as it is worth keeping.
    #[must_use]
    pub fn to_store(&self) -> Stored {
        Stored {
            version: VERSION,
            floor: self.floor,
            stations: self
                .known()
                .filter(|station| station.placed)
                .map(Entry::new)
                .collect(),
        }
    }

    /// Takes a kept room over. Its stations count as long as the light agrees.
    pub fn adopt(&mut self, stored: &Stored) {
        if self.given {
            return;
        }
        self.stations = [None; Source::COUNT];
        for entry in &stored.stations {
            if let Some(source) = entry.source() {
                self.stations[source.index()] = Some(entry.station(source));
            }
        }
        self.snapshots.clear();
        self.floor = stored.floor;
        self.revision += 1;
        self.world += 1;
        self.carried = None;
    }
}
