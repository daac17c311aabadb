//! What can be chosen about a simulation.

use glam::{DQuat, DVec3};
use posed_signal::HostTime;

use super::SimulateError;
use super::stations::default_stations;
use crate::lighthouse::base_station::{BaseStation, Source};

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

impl ImuNoise {
    /// As real headsets and controllers behave: white noise measured on captures at rest, bias
    /// from what calibration leaves there.
    pub const TYPICAL: Self = Self {
        accel: 0.012,
        gyro: 8e-4,
        accel_bias: 0.02,
        gyro_bias: 0.008,
        gyro_walk: 1e-4,
    };
    /// As a body tracker's: an ICM-45686 or BMI270 at 200 Hz, after the calibration at rest that
    /// its firmware does.
    pub const TRACKER: Self = Self {
        accel: 0.02,
        gyro: 1.5e-3,
        accel_bias: 0.05,
        gyro_bias: 2e-3,
        gyro_walk: 5e-5,
    };
    /// No errors but quantisation.
    pub const NONE: Self = Self {
        accel: 0.0,
        gyro: 0.0,
        accel_bias: 0.0,
        gyro_bias: 0.0,
        gyro_walk: 0.0,
    };
}

/// Errors of the optical measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightNoise {
    /// Standard deviation of a sweep's time, seconds.
    pub sweep_s: f64,
    /// Standard deviation of a sync's time, seconds.
    pub sync_s: f64,
    /// Standard deviation of the duration of a single turn of a rotor, seconds.
    pub rotor_s: f64,
    /// Standard deviation of what the configuration has wrong about a sensor's place, metres and
    /// per axis.
    pub sensor_m: f64,
    /// Share of hits that are lost at random.
    pub drop: f64,
    /// Share of hits that are reflections: their time is wrong by up to a millisecond.
    pub reflection: f64,
}

impl LightNoise {
    /// Times scatter as on captures at rest, where a sweep repeats within about 3e-5 rad. The
    /// larger part of residuals there repeats from rotation to rotation: here it comes from where
    /// the configuration says the sensors are, which makes residuals of 4e-5 to 7e-5 rad. Captures
    /// show up to 1e-4: the rest is taken to be the base stations', which are exact here.
    pub const TYPICAL: Self = Self {
        sweep_s: 35e-9,
        sync_s: 30e-9,
        rotor_s: 80e-9,
        sensor_m: 1.5e-4,
        drop: 0.02,
        reflection: 0.001,
    };
    /// No errors but quantisation, and no loss.
    pub const NONE: Self = Self {
        sweep_s: 0.0,
        sync_s: 0.0,
        rotor_s: 0.0,
        sensor_m: 0.0,
        drop: 0.0,
        reflection: 0.0,
    };
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

impl UsbTiming {
    /// As on captures of a PC under little load.
    pub const TYPICAL: Self = Self {
        jitter_s: 15e-6,
        drift_ppm: 20.0,
        radio_loss: 0.015,
    };
    /// At once and without loss.
    pub const NONE: Self = Self {
        jitter_s: 0.0,
        drift_ppm: 0.0,
        radio_loss: 0.0,
    };
}

/// Something opaque in the world: a capsule between two moving points.
pub struct Occluder {
    /// The two ends of its axis at a time in seconds after the start.
    pub axis: Box<dyn Fn(f64) -> [DVec3; 2] + Send>,
    /// Metres.
    pub radius: f64,
}

/// Somebody moves a base station.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    /// Seconds after the start.
    pub at_s: f64,
    /// Which one.
    pub source: Source,
    /// Where it stands from then on, metres.
    pub position: DVec3,
    /// Its frame to the world.
    pub rotation: DQuat,
}

/// A base station is switched off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Absence {
    /// Which one.
    pub source: Source,
    /// From when until when, seconds after the start.
    pub span: [f64; 2],
}

/// Options of a simulation.
pub struct Options {
    /// Everything random follows from it.
    pub seed: u64,
    /// Host time of the simulation's start.
    pub start: HostTime,
    /// Seconds.
    pub duration_s: f64,
    /// Base stations. Those of generation 2 may share a channel, as users set them by mistake.
    pub stations: Vec<BaseStation>,
    /// The wearer's body and anything else that stands in the light.
    pub occluders: Vec<Occluder>,
    /// Spans in which no device sees any light: begin and end, seconds after the start.
    pub dark: Vec<[f64; 2]>,
    /// Base stations that are moved, in the order of time.
    pub moves: Vec<Move>,
    /// Base stations that are off for a while.
    pub absences: Vec<Absence>,
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
            dark: Vec::new(),
            moves: Vec::new(),
            absences: Vec::new(),
            imu: ImuNoise::TYPICAL,
            light: LightNoise::TYPICAL,
            usb: UsbTiming::TYPICAL,
        }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), SimulateError> {
        let mut sources = 0u32;
        for station in &self.stations {
            if let Source::Channel(channel @ 16..) = station.source {
                return Err(SimulateError::NoSuchChannel(channel));
            }
            let bit = 1u32 << station.source.index();
            if matches!(station.source, Source::Slot(_)) && sources & bit != 0 {
                return Err(SimulateError::SharedSlot(station.source));
            }
            sources |= bit;
        }
        let (light, imu, usb) = (&self.light, &self.imu, &self.usb);
        for (what, value, high) in [
            ("duration, seconds", self.duration_s, 3600.0),
            ("accelerometer noise, m/s^2", imu.accel, 10.0),
            ("gyroscope noise, rad/s", imu.gyro, 10.0),
            ("accelerometer bias, m/s^2", imu.accel_bias, 10.0),
            ("gyroscope bias, rad/s", imu.gyro_bias, 1.0),
            ("gyroscope random walk", imu.gyro_walk, 1.0),
            ("sweep noise, seconds", light.sweep_s, 1e-4),
            ("sync noise, seconds", light.sync_s, 1e-4),
            ("rotor noise, seconds", light.rotor_s, 1e-5),
            ("sensor position error, metres", light.sensor_m, 0.01),
            ("share of lost hits", light.drop, 1.0),
            ("share of reflections", light.reflection, 1.0),
            ("arrival jitter, seconds", usb.jitter_s, 0.1),
            ("clock drift, parts in a million", usb.drift_ppm, 500.0),
            ("share of radio packets lost", usb.radio_loss, 1.0),
        ] {
            // NaN is in no range.
            if !(0.0..=high).contains(&value) {
                return Err(SimulateError::Range { what, value, high });
            }
        }
        Ok(())
    }
}
