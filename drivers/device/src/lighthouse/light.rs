//! From the light that a device reports to sweeps and broadcasts, the same for both generations:
//! what lies above knows angles, planes and base stations, and no timing.

use super::{
    base_station::{Generation, Source},
    ootx::{BitStream, Broadcast},
    pulses::Pulses,
    reader::Event,
    reproject::ROTOR_HZ,
    rotor::Rotor,
    wire::{Pulse, TICKS_PER_SECOND},
};

/// A light plane passed a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// Where the light came from.
    pub source: Source,
    /// Which of its planes, 0 or 1.
    pub plane: u8,
    /// The sensor's hardware channel.
    pub sensor: u8,
    /// Device time, ticks.
    pub ticks: f64,
    /// Angle of the plane from its centre, rad; comparable to
    /// [`BaseStation::reading`](super::base_station::BaseStation::reading).
    pub angle: f64,
}

/// What light said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    /// A light plane passed a sensor.
    Sweep(Sweep),
    /// A base station has finished saying what it is. Comes again with every frame of its data.
    Broadcast(Source, Broadcast),
    /// Two base stations are set to this channel: their light tells nothing.
    Shared(Source),
}

/// One base station of generation 2.
#[derive(Debug, Clone)]
struct Beacon {
    rotor: Rotor,
    bits: BitStream,
    /// The newest sync that counts, ticks.
    synced: Option<f64>,
}

/// The light of one device.
#[derive(Debug, Clone)]
pub struct Light {
    /// By channel.
    beacons: [Option<Box<Beacon>>; ROTOR_HZ.len()],
    pulses: Pulses,
}

impl Default for Light {
    fn default() -> Self {
        Self {
            beacons: std::array::from_fn(|_| None),
            pulses: Pulses::default(),
        }
    }
}

impl Light {
    /// Takes an event of the device's stream, and calls `seen` for what it said about light.
    pub fn event(&mut self, event: &Event, seen: &mut dyn FnMut(Seen)) {
        match *event {
            Event::Sync {
                channel,
                ticks,
                data,
            } => self.sync(channel, ticks, data, seen),
            Event::Sweep {
                channel,
                sensor,
                ticks,
            } => self.sweep(channel, sensor, ticks, seen),
            Event::Pulse {
                sensor,
                length,
                ticks,
            } => {
                let pulse = Pulse {
                    sensor,
                    length,
                    ticks: ticks as u32,
                };
                self.pulses.pulse(&pulse, ticks as f64, seen);
            }
            _ => {}
        }
    }

    fn sync(&mut self, channel: u8, ticks: f64, data: bool, seen: &mut dyn FnMut(Seen)) {
        let Some(beacon) = self.beacons.get_mut(usize::from(channel)) else {
            return;
        };
        let beacon = beacon.get_or_insert_with(|| {
            Box::new(Beacon {
                rotor: Rotor::new(channel),
                bits: BitStream::default(),
                synced: None,
            })
        });
        let agrees = beacon.rotor.sync(ticks);
        if beacon.rotor.is_shared() {
            beacon.bits = BitStream::default();
            seen(Seen::Shared(Source::Channel(channel)));
            return;
        }
        if !agrees {
            return;
        }
        let turn = TICKS_PER_SECOND / ROTOR_HZ[usize::from(channel)];
        let turns = beacon
            .synced
            .map_or(1.0, |synced| ((ticks - synced) / turn).round());
        if turns == 0.0 {
            return;
        }
        if turns < 0.0 {
            // The device's clock was set back, or its first time was stale.
            beacon.bits = BitStream::default();
        }
        beacon.synced = Some(ticks);
        let source = Source::Channel(channel);
        let payload = beacon.bits.push((turns - 1.0).max(0.0) as u64, data);
        let broadcast = payload.and_then(|bytes| Broadcast::parse(Generation::Two, &bytes));
        if let Some(broadcast) = broadcast {
            seen(Seen::Broadcast(source, broadcast));
        }
    }

    fn sweep(&mut self, channel: u8, sensor: u8, ticks: f64, seen: &mut dyn FnMut(Seen)) {
        let beacon = self.beacons.get(usize::from(channel));
        let Some(beacon) = beacon.and_then(Option::as_ref) else {
            return;
        };
        if let Some(reading) = beacon.rotor.reading(ticks) {
            seen(Seen::Sweep(Sweep {
                source: Source::Channel(channel),
                plane: reading.plane,
                sensor,
                ticks,
                angle: reading.angle,
            }));
        }
    }
}
