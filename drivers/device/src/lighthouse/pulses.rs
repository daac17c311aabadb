//! From light pulses to sweeps, under base stations of generation 1.
//!
//! Every 8.3 ms each base station flashes for all sensors, the second 0.4 ms after the first; the
//! flash's length tells which rotor is up next, a bit of data, and whether the station skips its
//! turn. The one that does not skip then turns a light plane past the room; the time from its flash
//! to the middle of a sensor's short pulse is the plane's angle.

use std::f64::consts::{FRAC_PI_2, PI};

use super::{
    base_station::{Generation, Source},
    light::{Seen, Sweep},
    ootx::{BitStream, Broadcast},
    wire::Pulse,
};

/// Ticks from a base station's flash to its next one, half a turn of a rotor.
const CYCLE: f64 = 400_000.0;
/// Ticks from the first station's flash to the second's.
const SLOT: f64 = 20_000.0;
/// A rotor's flashes come this near to when they should, ticks.
const FLASH_TOLERANCE: f64 = 3_000.0;
/// Sensors see one flash within this time of each other, ticks: faint ones late.
const FLASH_SPREAD: f64 = 1_500.0;
/// Pulses from here on are flashes.
pub(super) const FLASH_LENGTH: u16 = 2_500;
/// The shortest flash, and what another flag adds to it, ticks (62.5 and 10.4 us).
const SHORTEST: i32 = 3_000;
const STEP: i32 = 500;
/// Longer pulses are no plane that passes.
const SWEEP_LENGTH: u16 = 1_500;
/// A plane is in the room between these times after the flash, ticks.
const ROOM: (f64, f64) = (30_000.0, 370_000.0);
/// Pulses whose length is this near to the longest of a flash mark its begin, ticks.
const NEAR_LONGEST: u16 = 40;
/// A station that has not been seen for so many cycles may be another one now.
const CYCLES_MAX: f64 = 240.0;

/// A flash, as the sensors that saw it have it.
#[derive(Debug, Clone, Copy)]
struct Flash {
    /// The earliest begin.
    first: f64,
    longest: u16,
    /// Sum and count of begins of the pulses near the longest, each as if it were that long.
    begins: (f64, f64),
}

impl Flash {
    fn new(ticks: f64, length: u16) -> Self {
        Self {
            first: ticks,
            longest: length,
            begins: (ticks, 1.0),
        }
    }

    fn add(&mut self, ticks: f64, length: u16) {
        self.first = self.first.min(ticks);
        let off = f64::from(length) - f64::from(self.longest);
        // A sensor that sees a little less light begins later and ends earlier.
        if length > self.longest.saturating_add(NEAR_LONGEST) {
            self.begins = (ticks, 1.0);
        } else if length.saturating_add(NEAR_LONGEST) >= self.longest {
            self.begins.0 += ticks + 0.5 * off;
            self.begins.1 += 1.0;
        }
        self.longest = self.longest.max(length);
    }

    fn begin(&self) -> f64 {
        self.begins.0 / self.begins.1
    }

    /// The three bits of its length: rotor, data, skip.
    fn flags(&self) -> Flags {
        let over = i32::from(self.longest) - SHORTEST + STEP / 2;
        let bits = over.div_euclid(STEP).clamp(0, 7);
        Flags {
            rotor: (bits & 1) as u8,
            data: bits & 2 != 0,
            skip: bits & 4 != 0,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Flags {
    rotor: u8,
    data: bool,
    skip: bool,
}

/// One base station.
#[derive(Debug, Clone, Default)]
struct Station {
    /// Its newest flash: begin and flags.
    flash: Option<(f64, Flags)>,
    bits: BitStream,
}

/// The pulses of one device.
#[derive(Debug, Clone, Default)]
pub(super) struct Pulses {
    flash: Option<Flash>,
    stations: [Station; 2],
    /// A flash that nothing followed, and its flags: what it is, is told by the next one.
    pending: Option<(f64, Flags)>,
}

impl Pulses {
    /// Takes a pulse that began at `ticks`, device time, about in the order of time.
    pub(super) fn pulse(&mut self, pulse: &Pulse, ticks: f64, seen: &mut dyn FnMut(Seen)) {
        let apart = self.flash.map_or(0.0, |flash| (ticks - flash.first).abs());
        if apart > FLASH_SPREAD
            && let Some(flash) = self.flash.take()
        {
            self.flashed(flash.begin(), flash.flags(), seen);
        }
        if pulse.length >= FLASH_LENGTH {
            match &mut self.flash {
                Some(flash) => flash.add(ticks, pulse.length),
                None => self.flash = Some(Flash::new(ticks, pulse.length)),
            }
        } else if pulse.length <= SWEEP_LENGTH {
            self.settle_before(ticks, seen);
            self.swept(pulse.sensor, ticks + f64::from(pulse.length) / 2.0, seen);
        }
    }

    /// A flash is over.
    fn flashed(&mut self, begin: f64, flags: Flags, seen: &mut dyn FnMut(Seen)) {
        let Some((before, held)) = self.pending else {
            self.pending = Some((begin, flags));
            return;
        };
        let after = begin - before;
        if (after - SLOT).abs() < FLASH_TOLERANCE {
            self.pending = None;
            self.assign(0, before, held, seen);
            self.assign(1, begin, flags, seen);
        } else {
            self.settle(before, held, seen);
            self.pending = Some((begin, flags));
        }
    }

    /// No second flash comes any more.
    fn settle_before(&mut self, ticks: f64, seen: &mut dyn FnMut(Seen)) {
        if let Some((begin, flags)) = self.pending
            && ticks - begin > SLOT + FLASH_TOLERANCE
        {
            self.pending = None;
            self.settle(begin, flags, seen);
        }
    }

    /// A flash came alone: it is of the station whose rhythm it keeps.
    fn settle(&mut self, begin: f64, flags: Flags, seen: &mut dyn FnMut(Seen)) {
        let off = |slot: usize| {
            let (last, _) = self.stations[slot].flash?;
            let cycles = ((begin - last) / CYCLE).round();
            let off = (begin - last - cycles * CYCLE).abs();
            (off < FLASH_TOLERANCE && cycles.abs() < CYCLES_MAX).then_some(off)
        };
        let slot = match (off(0), off(1)) {
            (Some(_), _) | (None, None) => 0,
            (None, Some(_)) => 1,
        };
        self.assign(slot, begin, flags, seen);
    }

    fn assign(&mut self, slot: usize, begin: f64, flags: Flags, seen: &mut dyn FnMut(Seen)) {
        let station = &mut self.stations[slot];
        let cycles = match station.flash {
            Some((last, _)) => ((begin - last) / CYCLE).round(),
            None => 1.0,
        };
        let rhythm = station.flash.is_none_or(|(last, _)| {
            cycles.abs() < CYCLES_MAX && (begin - last - cycles * CYCLE).abs() < FLASH_TOLERANCE
        });
        if rhythm && cycles == 0.0 {
            return;
        }
        let follows = rhythm && cycles > 0.0;
        if !follows {
            station.bits = BitStream::default();
        }
        station.flash = Some((begin, flags));
        let missed = if follows { cycles as u64 - 1 } else { 0 };
        let payload = station.bits.push(missed, flags.data);
        let broadcast = payload.and_then(|bytes| Broadcast::parse(Generation::One, &bytes));
        if let Some(broadcast) = broadcast {
            seen(Seen::Broadcast(Source::Slot(slot as u8), broadcast));
        }
    }

    /// A plane passed a sensor at `middle`: it is of the station whose turn it is.
    fn swept(&mut self, sensor: u8, middle: f64, seen: &mut dyn FnMut(Seen)) {
        let turn = |slot: usize| {
            let (begin, flags) = self.stations[slot].flash?;
            let after = middle - begin;
            let inside = after > ROOM.0 && after < ROOM.1 && !flags.skip;
            inside.then_some((slot, after, flags.rotor))
        };
        let (slot, after, plane) = match (turn(0), turn(1)) {
            (Some(found), None) | (None, Some(found)) => found,
            // Nobody's turn, or a flash was misread.
            _ => return,
        };
        seen(Seen::Sweep(Sweep {
            source: Source::Slot(slot as u8),
            plane,
            sensor,
            ticks: middle,
            angle: after / CYCLE * PI - FRAC_PI_2,
        }));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn taken(pulses: &mut Pulses, all: &[(f64, u16, u8)]) -> Vec<Seen> {
        let mut found = Vec::new();
        for &(ticks, length, sensor) in all {
            let pulse = Pulse {
                sensor,
                length,
                ticks: ticks as u32,
            };
            pulses.pulse(&pulse, ticks, &mut |seen| found.push(seen));
        }
        found
    }

    fn source(seen: &Seen) -> (Source, u8) {
        match seen {
            Seen::Sweep(sweep) => (sweep.source, sweep.plane),
            Seen::Broadcast(source, _) | Seen::Shared(source) => (*source, 9),
        }
    }

    /// Pulses of a Vive headset (libsurvive-extras-data, vive_cal): two stations, whose second
    /// sweeps, then both again.
    #[test]
    fn the_station_whose_turn_it_is_sweeps() {
        let mut pulses = Pulses::default();
        let first = [
            (1_802_476_432.0, 4_945, 2),
            (1_802_476_421.0, 4_965, 7),
            (1_802_496_138.0, 2_748, 27),
            (1_802_495_953.0, 2_975, 16),
            (1_802_721_376.0, 126, 30),
            (1_802_723_263.0, 239, 18),
            (1_802_876_338.0, 5_474, 7),
        ];
        let seen = taken(&mut pulses, &first);
        let found: Vec<_> = seen.iter().map(source).collect();
        assert_eq!(found, [(Source::Slot(1), 0); 2]);
        let Seen::Sweep(sweep) = seen[0] else {
            panic!()
        };
        let expected = (1_802_721_439.0 - 1_802_495_953.0) / 4e5 * PI - FRAC_PI_2;
        assert_eq!((sweep.sensor, sweep.angle), (30, expected));
    }

    #[test]
    fn a_single_station_never_skips() {
        let mut pulses = Pulses::default();
        let stream: Vec<_> = (0..20)
            .flat_map(|n| {
                let begin = f64::from(n) * CYCLE;
                let length = 2_990 + 500 * (n % 2) as u16;
                [(begin, length, 0), (begin + 2e5, 200, 5)]
            })
            .collect();
        let found: Vec<_> = taken(&mut pulses, &stream).iter().map(source).collect();
        assert_eq!(found.len(), 20);
        assert_eq!(found[6], (Source::Slot(0), 0));
        assert_eq!(found[7], (Source::Slot(0), 1));
    }

    proptest! {
        #[test]
        fn any_pulses_are_survived(
            all in prop::collection::vec((0u32..3_000_000, 0u16..8_000, any::<u8>()), 0..200),
        ) {
            let all: Vec<_> = all.into_iter().map(|(t, l, s)| (f64::from(t), l, s)).collect();
            for seen in taken(&mut Pulses::default(), &all) {
                if let Seen::Sweep(sweep) = seen {
                    prop_assert!(sweep.angle.abs() < FRAC_PI_2 && sweep.plane < 2);
                }
            }
        }
    }
}
