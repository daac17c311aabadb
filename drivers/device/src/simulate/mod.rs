//! The device simulator: from trajectories of a headset and controllers and a base-station
//! layout to the exact USB traffic of those devices, in the order in which it reaches the host.
//!
//! The traffic is that of a Valve Index headset on its cable and Index controllers behind
//! watchman dongles, under base stations of generation 2; under those of generation 1 the headset
//! reports pulses as a Vive does, and controllers speak the radio protocol of Vive wands. Sensor
//! geometries, serials and calibrations are made up; formats, rates, latencies and errors are those
//! of real devices, as captures show them.
//!
//! A [`Simulator`] is an iterator over [`Packet`]s; [`Simulator::truth`] says where its devices
//! really are, and [`write_libsurvive`] writes the base stations for those who read the packets.

mod blueprint;
mod clock;
mod configuration;
mod device;
mod imu;
mod light;
mod ootx;
mod options;
mod pulses;
mod queue;
mod random;
mod rotor;
pub mod slimevr;
mod startup;
mod stations;
mod unit;
mod wire;

use std::collections::BTreeMap;

use posed_signal::HostTime;
use posed_signal::time::MILLISECOND_NS;
use serde::Serialize;

pub use device::{Device, Model, Path, Placement};
pub use options::{Absence, ImuNoise, LightNoise, Move, Occluder, Options, UsbTiming};
pub use stations::{default_stations, four_stations, generation_one_stations, write_libsurvive};

use crate::lighthouse::base_station::{BaseStation, Source};
use crate::usb::{Packet, Port, Transfer};
use light::Capsule;
use random::{Purpose, Random};
use rotor::{Rotation, Rotor};
use unit::Unit;
use wire::Report;

/// Why a simulation cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulateError {
    /// An option is out of its range.
    #[error("simulation: {what} is {value}, it has to lie between 0 and {high}")]
    Range {
        /// Which one.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Greatest value allowed.
        high: f64,
    },
    /// A base station's channel does not exist.
    #[error("simulation: a base station is set to channel {0}; channels go from 0 to 15")]
    NoSuchChannel(u8),
    /// Two base stations of generation 1 flash at one time.
    #[error("simulation: two base stations flash in {0}; give each its own")]
    SharedSlot(Source),
}

/// The true pose of a device at a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// Host time, nanoseconds.
    pub t_ns: u64,
    /// Serial number of the device.
    pub device: String,
    /// Name of its role.
    pub role: &'static str,
    /// Position of the tracking frame in the world, metres.
    pub position: [f64; 3],
    /// Rotation of the tracking frame, frame to world, x, y, z, w.
    pub rotation: [f64; 4],
}

/// The simulated devices: an iterator over their packets in the order of arrival.
pub struct Simulator {
    options: Options,
    units: Vec<Unit>,
    rotors: Vec<Rotor>,
    random: Random,
    frame: u64,
    frames: u64,
    /// Packets under way, by arrival and by the order in which they were made.
    under_way: BTreeMap<(HostTime, u64), Packet>,
    made: u64,
    /// When the last packet of an endpoint arrived: they do not overtake each other.
    last: BTreeMap<(Port, u8), HostTime>,
}

impl Simulator {
    /// Duration of a USB frame, in which the host asks each endpoint once.
    const FRAME_NS: u64 = MILLISECOND_NS;
    /// Least time from a frame's begin to the time stamp of a transfer in it, seconds.
    const TRANSFER_S: f64 = 6e-5;

    /// Devices that move as their paths say, from [`Options::start`] on.
    ///
    /// # Errors
    /// An option is out of range, or base stations of generation 1 share a slot.
    pub fn new(options: Options, devices: Vec<Device>) -> Result<Self, SimulateError> {
        options.check()?;
        let rotor = |(index, station)| {
            let random = Random::new(options.seed, Purpose::Rotor, index);
            Rotor::new(station, options.stations.len(), options.light, random)
        };
        let mut simulator = Self {
            rotors: options
                .stations
                .iter()
                .copied()
                .enumerate()
                .map(rotor)
                .collect(),
            units: Vec::new(),
            random: Random::new(options.seed, Purpose::Usb, 0),
            frame: 0,
            frames: HostTime::from_secs_f64(options.duration_s).0 / Self::FRAME_NS,
            under_way: BTreeMap::new(),
            made: 0,
            last: BTreeMap::new(),
            options,
        };
        for (index, device) in devices.into_iter().enumerate() {
            let (unit, exchanges) = Unit::new(device, &simulator.options, index);
            for exchange in exchanges {
                let (endpoint, transfer) = exchange.transfer();
                simulator.send(
                    unit.port,
                    endpoint,
                    transfer,
                    exchange.seconds,
                    exchange.data,
                );
            }
            simulator.units.push(unit);
        }
        Ok(simulator)
    }

    /// The base stations, where they stand at first.
    #[must_use]
    pub fn stations(&self) -> &[BaseStation] {
        &self.options.stations
    }

    /// Where the devices truly are, one sample of each every `step_ns`, in the order of time.
    pub fn truth(&self, step_ns: u64) -> impl Iterator<Item = Truth> + '_ {
        let step = step_ns.max(1);
        let duration = self.frames * Self::FRAME_NS;
        let start = self.options.start;
        (0..=duration / step).flat_map(move |index| {
            let truth = move |unit: &Unit| truth(&unit.device, start, index * step);
            self.units.iter().map(truth)
        })
    }

    /// One USB frame of everything.
    fn step(&mut self) {
        let now = HostTime(self.frame * Self::FRAME_NS).as_secs_f64();
        for rotor in &mut self.rotors {
            while let Some(rotation) = rotor.next(now) {
                rotor.stand(&self.options.moves, rotation.sync_s);
                let source = rotor.station.source;
                let absences = self.options.absences.iter();
                let off = absences.filter(|one| one.source == source);
                let mut dark = off
                    .map(|one| one.span)
                    .chain(self.options.dark.iter().copied());
                if dark.any(|span| is_dark(span, &rotation)) {
                    continue;
                }
                let obstacles = obstacles(&self.options.occluders, &rotation);
                for unit in &mut self.units {
                    unit.watch(rotor, &rotation, &obstacles);
                }
            }
        }
        let mut reports: Vec<Report> = Vec::new();
        for index in 0..self.units.len() {
            let unit = &mut self.units[index];
            let port = unit.port;
            unit.frame(self.frame, now, &mut reports);
            for (endpoint, data) in reports.drain(..) {
                self.send(port, endpoint, Transfer::Interrupt, now, data);
            }
        }
        self.frame += 1;
    }

    /// Sends a transfer on its way at `seconds` after the start.
    fn send(&mut self, port: Port, endpoint: u8, transfer: Transfer, seconds: f64, data: Vec<u8>) {
        let delay = Self::TRANSFER_S + self.random.exponential(self.options.usb.jitter_s);
        let arrival = self.options.start.plus_secs(seconds + delay);
        let after_last = self
            .last
            .get(&(port, endpoint))
            .map_or(HostTime(0), |last| last.plus_ns(1_000));
        // usbmon's captures count microseconds.
        let at = HostTime(arrival.max(after_last).0 / 1_000 * 1_000);
        self.last.insert((port, endpoint), at);
        let packet = Packet {
            at,
            port,
            endpoint,
            transfer,
            data,
        };
        self.under_way.insert((at, self.made), packet);
        self.made += 1;
    }
}

impl Iterator for Simulator {
    type Item = Packet;

    fn next(&mut self) -> Option<Packet> {
        loop {
            let frame_begin = self.options.start.0 + self.frame * Self::FRAME_NS;
            let over = self.frame >= self.frames;
            let (&(at, _), _) = match self.under_way.first_key_value() {
                Some(first) => first,
                None if over => return None,
                None => {
                    self.step();
                    continue;
                }
            };
            // Nothing that is still to be made arrives before the frame that it is made in.
            if over || at.0 < frame_begin {
                return self.under_way.pop_first().map(|(_, packet)| packet);
            }
            self.step();
        }
    }
}

/// What stands in the light in the middle of a rotation: the light needs a hundredth of a second
/// across the room, in which a body hardly moves.
fn obstacles(occluders: &[Occluder], rotation: &Rotation) -> Vec<Capsule> {
    let middle = rotation.sync_s + rotation.period_s / 2.0;
    let capsule = |occluder: &Occluder| Capsule {
        axis: (occluder.axis)(middle),
        radius: occluder.radius,
    };
    occluders.iter().map(capsule).collect()
}

/// Whether the middle of a rotation lies in a dark span.
fn is_dark([begin, end]: [f64; 2], rotation: &Rotation) -> bool {
    (begin..end).contains(&(rotation.sync_s + rotation.period_s / 2.0))
}

fn truth(device: &Device, start: HostTime, since_start: u64) -> Truth {
    let placement = device.path.at(HostTime(since_start).as_secs_f64());
    Truth {
        t_ns: start.0 + since_start,
        device: device.serial.clone(),
        role: device.model.role().name(),
        position: placement.position.to_array(),
        rotation: placement.rotation.to_array(),
    }
}

#[cfg(test)]
mod tests;
