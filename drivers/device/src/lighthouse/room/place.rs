//! How stations get their places.

use glam::{DQuat, DVec3};

use super::{
    APART, Bundle, EYE_HEIGHT, Room, SNAPSHOTS_MAX, Station,
    relative::{Relative, Unplaced, relative},
    snapshot::{Residual, Snapshot},
};
use crate::lighthouse::{
    base_station::{BaseStation, Source},
    model::Frame,
};

/// After adjusting, the light has to fit like this: rms (rad), share; with calibrations that were
/// heard, and with typical ones.
const HEARD: (f64, f64) = (1.5e-3, 0.7);
const TYPICAL: (f64, f64) = (3e-3, 0.4);
/// A snapshot fits the room with this rms, rad.
const FITS: f64 = 4e-3;
/// Stations lean by no more than this against what their accelerometer or the kept place says, rad.
const LEAN: f64 = 0.05;

/// `inner` seen from where `outer` is.
fn then(outer: &Frame, inner: &Frame) -> Frame {
    Frame {
        position: outer.position + outer.rotation * inner.position,
        rotation: (outer.rotation * inner.rotation).normalize(),
    }
}

fn inverse(frame: &Frame) -> Frame {
    let rotation = frame.rotation.conjugate();
    Frame {
        position: rotation * -frame.position,
        rotation,
    }
}

fn frame_of(station: &BaseStation) -> Frame {
    Frame {
        position: station.position,
        rotation: station.rotation,
    }
}

impl Room {
    /// A device was still for a moment, or moved calmly.
    pub(in crate::lighthouse) fn offer(&mut self, snapshot: Snapshot) {
        if self.given {
            return;
        }
        let sources = snapshot.sources();
        for source in &sources {
            let slot = &mut self.stations[source.index()];
            slot.get_or_insert_with(|| Station::unknown(*source));
        }
        let is_placed = |source: &&Source| self.stations[source.index()].is_some_and(|s| s.placed);
        let (placed, unplaced): (Vec<Source>, Vec<Source>) =
            sources.iter().partition(|source| is_placed(source));
        if self.stations().next().is_none() {
            self.begin(snapshot, &sources);
            return;
        }
        let is_fresh = !self.is_like_another(&snapshot);
        if placed.is_empty() || (unplaced.is_empty() && !is_fresh) {
            return;
        }
        let Some(pose) = self.pose_of(&snapshot, &placed) else {
            return;
        };
        let mut added = false;
        for source in unplaced {
            if let Some(found) = self.relative(&snapshot, source) {
                self.put(source, &then(&pose, &inverse(&found.frame)));
                added = true;
            }
        }
        if !added && !is_fresh {
            return;
        }
        if self.snapshots.len() >= SNAPSHOTS_MAX {
            // Those that join few stations say least; of equals the oldest goes.
            let joins = |index: &usize| self.snapshots[*index].0.sources().len();
            let Some(least) = (0..self.snapshots.len()).min_by_key(joins) else {
                return;
            };
            if !added && joins(&least) >= sources.len() {
                return;
            }
            self.snapshots.remove(least);
        }
        self.snapshots.push((snapshot, pose));
        self.adjust();
    }

    /// The world begins with a device: level, facing -Z, at the height of a standing wearer's eyes.
    fn begin(&mut self, snapshot: Snapshot, sources: &[Source]) {
        let found: Vec<_> = sources
            .iter()
            .filter_map(|source| Some((*source, self.relative(&snapshot, *source)?)))
            .collect();
        if found.is_empty() {
            return;
        }
        let level = DQuat::from_rotation_arc(snapshot.up, DVec3::Y);
        let head = &snapshot.model.head;
        let ahead = level * head.rotation * DVec3::NEG_Z;
        let turn = DQuat::from_rotation_y(ahead.x.atan2(-ahead.z));
        let rotation = (turn * level).normalize();
        let pose = Frame {
            position: DVec3::Y * EYE_HEIGHT - rotation * head.position,
            rotation,
        };
        for (source, relative) in found {
            self.put(source, &then(&pose, &inverse(&relative.frame)));
        }
        self.world += 1;
        self.carried = None;
        self.snapshots = vec![(snapshot, pose)];
        self.adjust();
    }

    fn put(&mut self, source: Source, frame: &Frame) {
        if let Some(station) = &mut self.stations[source.index()] {
            station.placed = true;
            station.station.position = frame.position;
            station.station.rotation = frame.rotation;
        }
        self.revision += 1;
    }

    fn relative(&self, snapshot: &Snapshot, source: Source) -> Option<Relative> {
        let known = self.stations[source.index()]?;
        let station = BaseStation {
            position: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            ..known.station
        };
        let unplaced = Unplaced {
            station,
            heard: known.heard,
            up: known.up,
        };
        relative(snapshot, source, &unplaced)
    }

    /// Where the snapshot's device is in the world; `None` where its light does not fit.
    fn pose_of(&self, snapshot: &Snapshot, placed: &[Source]) -> Option<Frame> {
        let guess = || {
            placed.iter().find_map(|source| {
                let station = self.stations[source.index()]?.station;
                Some(then(
                    &frame_of(&station),
                    &self.relative(snapshot, *source)?.frame,
                ))
            })
        };
        let pose = snapshot.pose.or_else(guess)?;
        let (mut square, mut count) = (0.0, 0.0);
        for seen in snapshot
            .glimpses
            .iter()
            .filter(|seen| placed.contains(&seen.source))
        {
            let Some(station) = self.stations[seen.source.index()] else {
                continue;
            };
            let value = Residual::new(seen, &station.station, &pose, DVec3::ZERO).value;
            // Reflections do not tell against a pose.
            square += value.powi(2).min(9.0 * FITS * FITS);
            count += 1.0;
        }
        (square < FITS * FITS * count).then_some(pose)
    }

    /// Whether a device was near here before and saw the same stations, as far as the snapshot's
    /// pose is known.
    fn is_like_another(&self, snapshot: &Snapshot) -> bool {
        let Some(pose) = snapshot.pose else {
            return false;
        };
        let sources = snapshot.sources();
        self.snapshots.iter().any(|(other, frame)| {
            let theirs = other.sources();
            other.model.identity == snapshot.model.identity
                && sources.iter().all(|source| theirs.contains(source))
                && (frame.position - pose.position).length() < APART.0
                && frame.rotation.angle_between(pose.rotation) < APART.1
        })
    }

    /// Refines all places. The newest snapshot keeps its position and heading, so that nobody sees
    /// the world jump.
    pub(super) fn adjust(&mut self) {
        if self.snapshots.is_empty() {
            return;
        }
        let mut bundle = Bundle {
            stations: self
                .stations()
                .map(|station| (station.source, *station))
                .collect(),
            off: vec![DVec3::ZERO; self.snapshots.len()],
            snapshots: self.snapshots.clone(),
        };
        let (rms, share) = bundle.adjust();
        let heard = self
            .known()
            .filter(|station| station.placed)
            .all(|station| station.heard);
        let (rms_max, share_min) = if heard { HEARD } else { TYPICAL };
        if rms > rms_max || share < share_min || !bundle.is_sound() {
            self.forget();
            return;
        }
        let sigmas = bundle.sigmas().unwrap_or_default();
        let newest = self.snapshots.len() - 1;
        let (before, after) = (self.snapshots[newest].1, bundle.snapshots[newest].1);
        let back = level_turn(&after, &before);
        let shift = before.position - back * after.position;
        let brought = |frame: &Frame| Frame {
            position: back * frame.position + shift,
            rotation: (back * frame.rotation).normalize(),
        };
        for (source, station) in &bundle.stations {
            self.put(*source, &brought(&frame_of(station)));
        }
        for ((source, _), sigma) in bundle.stations.iter().skip(1).zip(sigmas) {
            if let Some(station) = &mut self.stations[source.index()] {
                station.sigma = Some(sigma);
            }
        }
        for ((_, frame), (_, adjusted)) in self.snapshots.iter_mut().zip(&bundle.snapshots) {
            *frame = brought(adjusted);
        }
    }

    /// All places are lost, and the newest snapshot begins anew.
    fn forget(&mut self) {
        for station in self.stations.iter_mut().flatten() {
            station.placed = false;
        }
        self.snapshots.clear();
        self.revision += 1;
        self.world += 1;
        self.carried = None;
    }

    /// Of the stations that a snapshot sees, the one that leans as it did when it was placed.
    pub(super) fn most_level(&self, snapshot: &Snapshot) -> Option<Source> {
        let lean = |source: &Source| {
            let found = self.relative(snapshot, *source)?;
            let station = self.stations[source.index()].filter(|station| station.placed)?;
            let up = found.frame.rotation * snapshot.up;
            let kept = station.station.rotation.conjugate() * DVec3::Y;
            Some(up.angle_between(kept))
        };
        let sources = snapshot.sources();
        let leans = sources
            .iter()
            .filter_map(|source| Some((*source, lean(source)?)));
        leans
            .filter(|(_, lean)| *lean < LEAN)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(source, _)| source)
    }
}

/// The turn about the vertical that brings a rotation nearest to another.
fn level_turn(from: &Frame, to: &Frame) -> DQuat {
    let turn = to.rotation * from.rotation.conjugate();
    DQuat::from_rotation_y(2.0 * turn.y.atan2(turn.w))
}

impl Bundle {
    fn is_sound(&self) -> bool {
        let inside = |position: DVec3, rotation: DQuat| {
            position.is_finite() && position.length() < 100.0 && rotation.is_finite()
        };
        self.stations
            .iter()
            .all(|(_, station)| inside(station.position, station.rotation))
            && self
                .snapshots
                .iter()
                .all(|(_, frame)| inside(frame.position, frame.rotation))
    }
}
