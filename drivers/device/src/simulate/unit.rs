//! One simulated device with everything in it, stepped a USB frame at a time.

use super::blueprint::Blueprint;
use super::clock::DeviceClock;
use super::device::{Device, Model};
use super::imu::ImuSource;
use super::light::{Capsule, Optics};
use super::options::Options;
use super::pulses::PulseQueue;
use super::queue::LightQueue;
use super::random::{Purpose, Random};
use super::rotor::{Rotation, Rotor};
use super::startup::{self, Exchange};
use super::wire::{Cable, Radio, Report};
use crate::lighthouse::base_station::{BaseStation, Generation};
use crate::usb::Port;

/// Ticks between two samples of a headset. A controller's IMU goes by a clock of its own, which
/// differs from the tick counter's by this share (standard deviation): captures show intervals of
/// 191,690 to 193,220 ticks.
const HEADSET_INTERVAL: f64 = 47_990.0;
const CONTROLLER_INTERVAL: f64 = 192_000.0;
const CONTROLLER_SPREAD: f64 = 4e-3;
/// A controller's samples show only every 256th tick.
const CONTROLLER_TICK_MASK: u32 = !0xff;
/// A sample is there for the host this long after it was measured, seconds.
const SAMPLE_LATENCY_S: f64 = 1e-4;
/// Light begins this long after the start: a controller's only some time after it was switched
/// to the second raw mode.
const CABLE_FROM_S: f64 = 0.01;
const RADIO_FROM_S: f64 = 0.3;

/// Light is reported this long after it was seen, seconds; and more words than the second number
/// do not wait for it.
const CABLE_LIGHT: (f64, usize) = (3e-3, 256);
const RADIO_LIGHT: (f64, usize) = (1e-3, 40);

/// Sensors of which a flash of generation 1 is sent by radio.
const RADIO_FLASHES: usize = 2;

enum Link {
    Cable(Cable),
    Radio(Radio),
}

/// A simulated device.
pub(super) struct Unit {
    pub(super) device: Device,
    pub(super) port: Port,
    pub(super) clock: DeviceClock,
    imu: ImuSource,
    optics: Optics,
    light: LightQueue,
    pulses: PulseQueue,
    link: Link,
}

impl Unit {
    /// The `index`-th device, and what its host exchanges with it first.
    pub(super) fn new(device: Device, options: &Options, index: usize) -> (Self, Vec<Exchange>) {
        let seed = options.seed;
        let stream = |purpose| Random::new(seed, purpose, index);
        let blueprint = Blueprint::new(device.model, options, index);
        let old = |station: &BaseStation| station.source.generation() == Generation::One;
        let old = options.stations.iter().any(old);
        let exchanges = startup::exchanges(&device, &blueprint, old);
        let clock = DeviceClock::new(&mut stream(Purpose::Clock), options.usb.drift_ppm);
        let (interval, link, light) = match device.model {
            Model::Headset => (HEADSET_INTERVAL, Link::Cable(Cable::new()), CABLE_LIGHT),
            Model::LeftController | Model::RightController => {
                let radio = Radio::new(old, options.usb.radio_loss, stream(Purpose::Radio));
                let spread = stream(Purpose::Interval).normal(CONTROLLER_SPREAD);
                (
                    CONTROLLER_INTERVAL * (1.0 + spread),
                    Link::Radio(radio),
                    RADIO_LIGHT,
                )
            }
        };
        let random = stream(Purpose::Imu);
        let unit = Self {
            port: Port {
                bus: 1,
                address: 10 + index as u16,
            },
            imu: ImuSource::new(&blueprint, options.imu, random, &clock, interval),
            optics: Optics::new(&blueprint, options.light, stream(Purpose::Light)),
            light: LightQueue::new(light.0, light.1),
            pulses: PulseQueue::default(),
            device,
            clock,
            link,
        };
        (unit, exchanges)
    }

    /// A rotation that has just begun.
    pub(super) fn watch(&mut self, rotor: &Rotor, rotation: &Rotation, obstacles: &[Capsule]) {
        let from_s = match self.link {
            Link::Cable(_) => CABLE_FROM_S,
            Link::Radio(_) => RADIO_FROM_S,
        };
        if rotation.sync_s < from_s {
            return;
        }
        let (path, station) = (&*self.device.path, &rotor.station);
        if station.source.generation() == Generation::One {
            let flashes_max = match self.link {
                Link::Cable(_) => usize::MAX,
                Link::Radio(_) => RADIO_FLASHES,
            };
            let pulses = self.optics.watch_pulses(
                path,
                &self.clock,
                station,
                rotation,
                obstacles,
                flashes_max,
            );
            self.pulses.extend(pulses);
            return;
        }
        let words = self
            .optics
            .watch(path, &self.clock, station, rotation, obstacles);
        self.light.extend(words);
    }

    /// What the host gets when it asks all endpoints in the frame that begins at `now` (seconds).
    pub(super) fn frame(&mut self, index: u64, now: f64, reports: &mut Vec<Report>) {
        // The devices process light, and the radio has its slots, in every second frame.
        let second = index.is_multiple_of(2);
        if second {
            self.light.process(now);
            self.pulses.process(now);
        }
        let (path, measured_by) = (&*self.device.path, now - SAMPLE_LATENCY_S);
        while let Some(mut sample) = self.imu.next(path, &self.clock, measured_by) {
            match &mut self.link {
                Link::Cable(cable) => cable.measured(sample),
                Link::Radio(radio) => {
                    sample.ticks &= CONTROLLER_TICK_MASK;
                    radio.measured(sample);
                }
            }
        }
        match &mut self.link {
            Link::Cable(cable) => cable.poll(&mut self.light, &mut self.pulses, reports),
            Link::Radio(radio) if second => {
                let ticks = self.clock.ticks(now) as u64 as u32;
                radio.poll(ticks, &mut self.light, &mut self.pulses, reports);
            }
            Link::Radio(_) => {}
        }
    }
}
