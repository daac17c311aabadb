//! What a capture holds of a Joy-Con or Pro Controller.

use posed_signal::HostTime;

use super::{
    calibration::{Flash, Origin},
    decoder::{ModeWatch, device_info},
    wire::{self, ImuMode, Input, RawImu},
};
use crate::usb::{Packet, Transfer};

/// Counts of the accelerometer that make 1 g before calibration.
const COUNTS_PER_G: f64 = 4_096.0;
/// Accelerations looked at: enough for hours.
const SAMPLES_MAX: usize = 1 << 22;

/// What was found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Which device it is, if it said so.
    pub model: Option<&'static str>,
    /// Its Bluetooth address.
    pub serial: Option<String>,
    /// Input reports.
    pub reports: u64,
    /// Reports that could not be read.
    pub errors: u64,
    /// The first of those errors.
    pub first_error: Option<String>,
    /// Reports with inertial samples.
    pub full_reports: u64,
    /// Such reports a second.
    pub rate_hz: Option<f64>,
    /// Reports by the mode that the sensors were in: unknown, off, raw, packed.
    pub by_mode: [u64; 4],
    /// Samples with a gyroscope in them, empty ones not counted.
    pub imu_samples: u64,
    /// Median length of all accelerations in raw mode before calibration, in g; where there are
    /// none, of the first sample of each report.
    pub median_accel_g: Option<f64>,
    /// Median length of the angular velocities in raw mode, degrees a second.
    pub median_gyro_dps: Option<f64>,
    /// Which calibration the device has.
    pub calibration: Origin,
    /// Battery, 0 to 1.
    pub charge: Option<f32>,
}

/// Takes packets and counts.
#[derive(Debug, Default)]
pub struct Inspector {
    report: Report,
    mode: ModeWatch,
    flash: Flash,
    span: Option<(HostTime, HostTime)>,
    raw: Vec<RawImu>,
    first: Vec<[i16; 3]>,
}

impl Inspector {
    /// Takes one transfer of the device.
    pub fn packet(&mut self, packet: &Packet) {
        if packet.transfer != Transfer::Interrupt {
            return;
        }
        if !packet.is_input() {
            self.mode.output(&packet.data);
            return;
        }
        self.report.reports += 1;
        match wire::input(&packet.data) {
            Err(error) => {
                self.report.errors += 1;
                let first = &mut self.report.first_error;
                first.get_or_insert_with(|| error.to_string());
            }
            Ok(Input::Full(common, samples)) => {
                self.report.charge = Some(f32::from(common.battery >> 5).min(4.0) / 4.0);
                self.full(packet.at, &samples);
            }
            Ok(Input::Reply(_, reply)) => {
                self.mode.reply(&reply);
                match (reply.accepted, reply.subcommand) {
                    (true, wire::DEVICE_INFO) => {
                        if let Some((kind, serial)) = device_info(reply.data) {
                            self.report.model = Some(kind.name());
                            self.report.serial = Some(serial.to_string());
                        }
                    }
                    (true, wire::FLASH_READ) => self.flash.take(reply.data),
                    _ => {}
                }
            }
            Ok(Input::Other) => {}
        }
    }

    fn full(&mut self, at: HostTime, samples: &[RawImu; 3]) {
        self.report.full_reports += 1;
        let (first, _) = self.span.unwrap_or((at, at));
        self.span = Some((first, at));
        let mode = self.mode.mode();
        let column = match mode {
            ImuMode::Unknown => 0,
            ImuMode::Off => 1,
            ImuMode::Raw => 2,
            ImuMode::Packed => 3,
        };
        self.report.by_mode[column] += 1;
        if self.first.len() < SAMPLES_MAX {
            self.first.push(samples[0].accel);
        }
        if mode == ImuMode::Raw && self.raw.len() < SAMPLES_MAX {
            self.raw.extend(samples);
        }
    }

    /// What was found so far.
    #[must_use]
    pub fn report(&self) -> Report {
        let seconds = self.span.map(|(first, last)| last.since_secs(first));
        let intervals = self.report.full_reports.saturating_sub(1) as f64;
        let (calibration, origin) = self.flash.calibration();
        let gyros = self.raw.iter().filter(|raw| !raw.is_empty());
        let turning: Vec<f64> = gyros
            .map(|raw| f64::from(calibration.angular_velocity(raw).length()).to_degrees())
            .collect();
        let accels: Vec<f64> = if self.raw.is_empty() {
            self.first.iter().map(length).collect()
        } else {
            self.raw.iter().map(|raw| length(&raw.accel)).collect()
        };
        Report {
            rate_hz: seconds.filter(|&s| s > 0.0).map(|s| intervals / s),
            imu_samples: turning.len() as u64,
            median_accel_g: median(accels).map(|counts| counts / COUNTS_PER_G),
            median_gyro_dps: median(turning),
            calibration: origin,
            ..self.report.clone()
        }
    }
}

fn length(counts: &[i16; 3]) -> f64 {
    let square = |count: i16| f64::from(count) * f64::from(count);
    counts
        .iter()
        .map(|&count| square(count))
        .sum::<f64>()
        .sqrt()
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    let upper = *values.get(middle)?;
    let even = values.len().is_multiple_of(2);
    Some(if even {
        (values[middle - 1] + upper) / 2.0
    } else {
        upper
    })
}
