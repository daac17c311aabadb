//! What can be chosen about a simulation.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use posed_signal::HostTime;

use super::SimulateError;
use crate::lighthouse::{base_station::BaseStation, reproject::PlaneCalibration};

/// Errors of the inertial sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuNoise {
    /// Standard deviation of white noise of a sample, m/s^2.
    pub accel: f64,
    /// Standard deviation of white noise of a sample, rad/s.
    pub gyro: f64,
    /// Standard deviation of the constant part of the bias that the configuration does not know,
    /// m/s^2.
    pub accel_bias: f64,
    /// The same of the gyroscope, rad/s.
    pub gyro_bias: f64,
    /// Random walk of the gyroscope's bias, rad/s over the square root of a second.
    pub gyro_walk: f64,
}

/// Errors of the optical measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightNoise {
    /// Standard deviation of a sweep's time, seconds.
    pub sweep_s: f64,
    /// Standard deviation of a sync's time, seconds.
    pub sync_s: f64,
    /// Standard deviation of what the configuration has wrong about a sensor's place, metres and
    /// per axis.
    pub sensor_m: f64,
    /// Share of hits that are lost at random.
    pub drop: f64,
    /// Share of hits that are reflections: their time is wrong by up to a millisecond.
    pub reflection: f64,
}

/// How reports travel to the host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsbTiming {
    /// Mean of the exponentially distributed delay between the end of a transfer and its time
    /// stamp, seconds.
    pub jitter_s: f64,
    /// Standard deviation of the deviation of device clocks from 48 MHz, parts in a million.
    pub drift_ppm: f64,
    /// Share of packets that the radio loses.
    pub radio_loss: f64,
}

/// Something opaque in the world: a capsule between two moving points.
pub struct Occluder {
    /// The two ends of its axis at a time in seconds after the start.
    pub axis: Box<dyn Fn(f64) -> [DVec3; 2] + Send>,
    /// Metres.
    pub radius: f64,
}

/// Options of a simulation.
pub struct Options {
    /// Everything random follows from it.
    pub seed: u64,
    /// Host time of the simulation's start.
    pub start: HostTime,
    /// Seconds.
    pub duration_s: f64,
    /// Base stations, each on its own channel.
    pub stations: Vec<BaseStation>,
    /// The wearer's body and anything else that stands in the light.
    pub occluders: Vec<Occluder>,
    /// Errors of the inertial sensors.
    pub imu: ImuNoise,
    /// Errors of the optical measurements.
    pub light: LightNoise,
    /// How reports travel.
    pub usb: UsbTiming,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            start: HostTime::from_secs_f64(1_000.0),
            duration_s: 20.0,
            stations: default_stations(),
            occluders: Vec::new(),
            imu: ImuNoise {
                accel: 0.03,
                gyro: 0.002,
                accel_bias: 0.03,
                gyro_bias: 0.01,
                gyro_walk: 2e-4,
            },
            light: LightNoise {
                sweep_s: 40e-9,
                sync_s: 20e-9,
                sensor_m: 1e-4,
                drop: 0.02,
                reflection: 0.001,
            },
            usb: UsbTiming {
                jitter_s: 20e-6,
                drift_ppm: 20.0,
                radio_loss: 0.01,
            },
        }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), SimulateError> {
        let mut channels = 0u16;
        for station in &self.stations {
            let bit = 1u16 << (station.channel & 15);
            if channels & bit != 0 {
                return Err(SimulateError::SharedChannel(station.channel));
            }
            channels |= bit;
        }
        let range = |what, value: f64, low, high| {
            let fits = value >= low && value <= high;
            let error = SimulateError::Range {
                what,
                value,
                low,
                high,
            };
            if fits { Ok(()) } else { Err(error) }
        };
        range("the duration in seconds", self.duration_s, 0.0, 3600.0)
    }
}

/// Two base stations in opposite corners of a room of 5 by 5 m, 2.3 m up, looking at its middle.
#[must_use]
pub fn default_stations() -> Vec<BaseStation> {
    let station = |channel, id, x: f64, z: f64| {
        let yaw = x.atan2(z);
        BaseStation {
            channel,
            id,
            position: DVec3::new(x, 2.3, z),
            rotation: DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(-25.0 * PI / 180.0),
            calibration: [PlaneCalibration::default(); 2],
        }
    };
    vec![
        station(2, 0x51a0_0002, -2.4, -2.4),
        station(8, 0x51a0_0008, 2.4, 2.4),
    ]
}
