//! Which base stations a device sees, and what is wrong with what it sees.

use super::{base_station::Source, room::Room};
use crate::trouble::Trouble;

/// A station counts as seen for so long after its last sweep, s: hands and heads are in the way for
/// less.
const SEEN: f64 = 1.0;
/// Nothing is wrong in the first seconds: devices and their radio wake up, s.
const WAKING: f64 = 2.0;
/// What was noticed now and then stays for so long, s: a person has to be able to read it.
const NOTICED: f64 = 5.0;
const MOVED: f64 = 30.0;

/// Never, s.
const NEVER: f64 = f64::NEG_INFINITY;

/// One base station, as a device sees it; times of the device, s.
#[derive(Debug, Clone, Copy)]
struct Seen {
    swept: f64,
    shared: f64,
    moved: f64,
    is_placed: bool,
    moves: u32,
}

/// What a device sees of the room.
#[derive(Debug, Clone)]
pub(super) struct Outlook {
    stations: [Seen; Source::COUNT],
    /// Time of the first and of the newest sample.
    span: Option<(f64, f64)>,
    given: bool,
    astray: bool,
}

impl Default for Outlook {
    fn default() -> Self {
        let unseen = Seen {
            swept: NEVER,
            shared: NEVER,
            moved: NEVER,
            is_placed: false,
            moves: 0,
        };
        Self {
            stations: [unseen; Source::COUNT],
            span: None,
            given: false,
            astray: false,
        }
    }
}

impl Outlook {
    /// The device's clock stands at `now`.
    pub(super) fn pass(&mut self, now: f64) {
        match &mut self.span {
            Some((_, newest)) if now >= *newest && now - *newest < WAKING => *newest = now,
            // The device was off, or its clock began anew.
            _ => {
                self.span = Some((now, now));
                for station in &mut self.stations {
                    (station.swept, station.shared, station.moved) = (NEVER, NEVER, NEVER);
                }
            }
        }
    }

    fn now(&self) -> f64 {
        self.span.map_or(0.0, |(_, newest)| newest)
    }

    /// A light plane of a station passed.
    pub(super) fn swept(&mut self, source: Source) {
        self.stations[source.index()].swept = self.now();
    }

    /// Two stations share a channel.
    pub(super) fn shared(&mut self, source: Source) {
        self.stations[source.index()].shared = self.now();
    }

    /// Whether the device is not found among the stations that it sees.
    pub(super) fn set_astray(&mut self, astray: bool) {
        self.astray = astray;
    }

    /// The room as it is now.
    pub(super) fn follow(&mut self, room: &Room, is_first: bool) {
        let (now, placed) = (self.now(), room.placed());
        self.given = room.is_given();
        for (index, station) in self.stations.iter_mut().enumerate() {
            station.is_placed = placed[index].is_some();
            let moves = room.moves(index);
            if moves != station.moves && !is_first {
                station.moved = now;
            }
            station.moves = moves;
        }
    }

    /// What is wrong.
    pub(super) fn troubles(&self, troubles: &mut Vec<Trouble>) {
        let Some((first, now)) = self.span else {
            return;
        };
        let within = |then: f64, seconds: f64| now - then < seconds;
        let is_waking = now - first < WAKING;
        let each = || {
            let sources = (0..Source::COUNT).filter_map(Source::from_index);
            sources.map(|source| (source, &self.stations[source.index()]))
        };
        let seen = || each().filter(|(_, station)| within(station.swept, SEEN));
        let count = seen().count();
        let any_placed = self.stations.iter().any(|station| station.is_placed);
        let shares = each().any(|(_, station)| within(station.shared, NOTICED));
        if count == 0 && !is_waking && !shares {
            troubles.push(Trouble::Dark);
        }
        if count > 0 && !any_placed && !is_waking {
            troubles.push(Trouble::Unmeasured);
        }
        if let (1, Some((source, _)), false) = (count, seen().next(), is_waking) {
            troubles.push(Trouble::Alone(source));
        }
        if self.given && self.astray {
            troubles.push(Trouble::Contradicted);
        }
        for (source, station) in each() {
            if within(station.shared, NOTICED) {
                troubles.push(Trouble::Shared(source));
            }
            let is_seen = within(station.swept, SEEN);
            if within(station.moved, MOVED) {
                troubles.push(match self.given {
                    true => Trouble::Misplaced(source),
                    false => Trouble::Moved(source),
                });
            } else if is_seen && !station.is_placed && any_placed && self.given {
                troubles.push(Trouble::Unlisted(source));
            } else if is_seen && !station.is_placed && any_placed && !is_waking {
                troubles.push(Trouble::New(source));
            }
        }
    }
}
