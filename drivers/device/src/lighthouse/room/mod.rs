//! The room: which base stations there are and where they stand, worked out from the light itself
//! and shared by all devices that see it.
//!
//! A device is a ruler: its sensors' places on it are known, so that its light tells where it is
//! relative to a single station ([`relative`]). The first device that is held still makes the
//! world: level by its accelerometer, facing -Z. Every station whose light it sees has its place
//! then, and every further one gets its own from a device that sees it together with a placed one.
//! All of it is refined together ([`adjust`]) as more snapshots come. Stations that are seen to
//! have moved, or that turn out to be others, lose their place and get a new one.

mod adjust;
mod floor;
mod place;
mod relative;
pub(super) mod snapshot;
mod stored;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, PoisonError};

use glam::{DQuat, DVec3};

use self::{adjust::Bundle, snapshot::Snapshot};
use super::{
    base_station::{BaseStation, Generation, Source},
    model::Frame,
    ootx::Broadcast,
    reproject::PlaneCalibration,
};
pub use floor::Floor;
pub use stored::{Stored, StoredError};

/// Snapshots kept.
const SNAPSHOTS_MAX: usize = 24;
/// A snapshot is a new one if its device was so far from all others, m and rad.
const APART: (f64, f64) = (0.12, 0.35);
/// Height over the floor at which a headset is taken to be until the floor is known, m.
const EYE_HEIGHT: f64 = 1.6;

/// Shape of the light planes of a station that has not been heard yet: the median of ten stations
/// of generation 2. Single ones deviate by some milliradians.
const TYPICAL: [PlaneCalibration; 2] = [
    PlaneCalibration {
        phase: 0.0,
        tilt: -0.049,
        curve: 0.06,
        gibphase: 2.0,
        gibmag: -0.0055,
        ogeephase: 0.0,
        ogeemag: 0.0,
    },
    PlaneCalibration {
        phase: -0.006,
        tilt: 0.0457,
        curve: 0.26,
        gibphase: 2.3,
        gibmag: -0.005,
        ogeephase: 0.0,
        ogeemag: 0.0,
    },
];

/// A base station, as far as it is known.
#[derive(Debug, Clone, Copy)]
struct Station {
    station: BaseStation,
    /// Whether position and rotation mean anything.
    placed: bool,
    /// Whether its calibration is its own.
    heard: bool,
    /// Up in its frame, by its own accelerometer.
    up: Option<DVec3>,
    /// Standard deviation of its pose relative to the first placed station, m and rad, where that
    /// was measured.
    sigma: Option<[f64; 2]>,
}

impl Station {
    fn unknown(source: Source) -> Self {
        let calibration = match source.generation() {
            Generation::One => Default::default(),
            Generation::Two => TYPICAL,
        };
        Self {
            station: BaseStation {
                source,
                id: 0,
                position: DVec3::ZERO,
                rotation: DQuat::IDENTITY,
                calibration,
            },
            placed: false,
            heard: false,
            up: None,
            sigma: None,
        }
    }
}

/// Base stations by [`Source::index`], as trackers use them.
pub(super) type Placed = [Option<BaseStation>; Source::COUNT];

/// The room. See the module.
#[derive(Debug, Clone)]
pub struct Room {
    stations: [Option<Station>; Source::COUNT],
    /// Placed stations came from a file, and stay.
    given: bool,
    snapshots: Vec<(Snapshot, Frame)>,
    floor: Floor,
    /// The wearer's, m.
    stature: Option<f64>,
    /// Goes up whenever a station's place or shape changes.
    revision: u64,
    /// Goes up whenever the world itself is another: poses from before mean nothing.
    world: u64,
    /// How the present world came of the one before, if it is that one moved.
    carried: Option<Frame>,
    /// How often each station was seen to have moved, or to be another.
    moves: [u32; Source::COUNT],
}

impl Default for Room {
    fn default() -> Self {
        Self {
            stations: [None; Source::COUNT],
            given: false,
            snapshots: Vec::new(),
            floor: Floor::Assumed,
            stature: None,
            revision: 0,
            world: 0,
            carried: None,
            moves: [0; Source::COUNT],
        }
    }
}

impl Room {
    /// Base stations whose places are known and stay as they are; saying so again changes nothing.
    pub fn give(&mut self, stations: &[BaseStation]) {
        if self.given || stations.is_empty() {
            return;
        }
        self.stations = [None; Source::COUNT];
        for station in stations {
            self.stations[station.source.index()] = Some(Station {
                station: *station,
                placed: true,
                heard: true,
                up: None,
                sigma: None,
            });
        }
        self.given = true;
        self.revision += 1;
        self.world += 1;
    }

    /// Stations that have a place.
    pub fn stations(&self) -> impl Iterator<Item = &BaseStation> {
        self.known()
            .filter(|station| station.placed)
            .map(|station| &station.station)
    }

    /// Stations that have a place, but for the first of them, with how well their poses relative to
    /// that one are known where they were measured: standard deviations over all axes, m and rad.
    pub fn certainties(&self) -> impl Iterator<Item = (&BaseStation, Option<[f64; 2]>)> {
        let placed = self.known().filter(|station| station.placed);
        placed
            .skip(1)
            .map(|station| (&station.station, station.sigma))
    }

    fn known(&self) -> impl Iterator<Item = &Station> {
        self.stations.iter().flatten()
    }

    pub(super) fn placed(&self) -> Placed {
        self.stations.map(|station| {
            station
                .filter(|station| station.placed)
                .map(|station| station.station)
        })
    }

    /// Goes up whenever a station's place or shape changes.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Goes up whenever the world itself is another one.
    pub(super) fn world(&self) -> u64 {
        self.world
    }

    /// How the present world came of the one before, if it is that one moved.
    #[must_use]
    pub fn carried(&self) -> Option<Frame> {
        self.carried
    }

    /// How often stations were seen to have moved, or to be others than those kept.
    #[must_use]
    pub fn moved(&self) -> u64 {
        self.moves.iter().map(|moves| u64::from(*moves)).sum()
    }

    /// The same of the station of a number, see [`Source::index`].
    pub(super) fn moves(&self, index: usize) -> u32 {
        self.moves[index]
    }

    /// Whether the places of stations are given.
    pub(super) fn is_given(&self) -> bool {
        self.given
    }

    /// A base station said what it is.
    pub(super) fn heard(&mut self, source: Source, said: &Broadcast) {
        if self.given {
            self.find_given(source, said.id);
            return;
        }
        let slot = &mut self.stations[source.index()];
        let station = slot.get_or_insert_with(|| Station::unknown(source));
        let another = station.station.id != 0 && station.station.id != said.id;
        if station.heard && !another && station.station.calibration == said.calibration {
            station.up = Some(said.up);
            return;
        }
        let was_placed = station.placed;
        station.heard = true;
        station.up = Some(said.up);
        station.station.id = said.id;
        station.station.calibration = said.calibration;
        if another {
            self.displace(source);
        } else if was_placed {
            self.adjust();
        }
    }

    /// A given station may have been set to another channel since.
    fn find_given(&mut self, source: Source, id: u32) {
        let named = |station: &Option<Station>| station.is_some_and(|s| s.station.id == id);
        let Some(at) = self.stations.iter().position(named) else {
            return;
        };
        if at != source.index() {
            self.stations.swap(at, source.index());
            for index in [at, source.index()] {
                if let (Some(station), Some(source)) =
                    (&mut self.stations[index], Source::from_index(index))
                {
                    station.station.source = source;
                }
            }
            // What was found with stations in each other's places means nothing.
            self.revision += 1;
            self.world += 1;
            self.carried = None;
        }
    }

    /// A station lost its place: what was seen of it before tells nothing about the new one.
    fn displace(&mut self, source: Source) {
        if let Some(station) = &mut self.stations[source.index()] {
            station.placed = false;
            station.sigma = None;
        }
        for (snapshot, _) in &mut self.snapshots {
            snapshot.glimpses.retain(|seen| seen.source != source);
        }
        self.snapshots
            .retain(|(snapshot, _)| !snapshot.glimpses.is_empty());
        self.moves[source.index()] += 1;
        self.revision += 1;
    }

    /// The light of a station keeps disagreeing with that of the others.
    pub(super) fn disagrees(&mut self, source: Source) {
        let others = self
            .stations()
            .filter(|station| station.source != source)
            .count();
        if self.given {
            // It stays where it is given to stand; its light is gated.
            self.moves[source.index()] += 1;
        } else if others > 0 {
            self.displace(source);
        }
    }

    /// A device that sees placed stations is not found among them: some of them moved.
    pub(super) fn contradicts(&mut self, snapshot: &Snapshot) {
        if self.given {
            return;
        }
        let keep = self.most_level(snapshot);
        for source in snapshot.sources() {
            if Some(source) != keep && self.stations[source.index()].is_some_and(|s| s.placed) {
                self.displace(source);
            }
        }
        if keep.is_none() {
            self.snapshots.clear();
        }
    }
}

/// The room as all decoders of a rig share it. They run on one thread; others look in now and then.
#[derive(Debug, Clone, Default)]
pub struct Handle(Arc<Mutex<Room>>);

impl Handle {
    /// Shares a room.
    #[must_use]
    pub fn new(room: Room) -> Self {
        Self(Arc::new(Mutex::new(room)))
    }

    /// Does something with the room.
    pub fn with<T>(&self, work: impl FnOnce(&mut Room) -> T) -> T {
        // Nothing in a room can be left half-done by a panic but places, which are checked anew.
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
