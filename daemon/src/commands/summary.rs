//! What a run amounted to, for people and as JSON.

use std::fmt::Write as _;

use posed_device::rig::DeviceInfo;
use posed_signal::{HostTime, Lookup, Pose, PoseHow, Role, time::SECOND_NS};
use posed_tracker::{Recoveries, worn};
use serde::Serialize;

use crate::published::PublishedPose;

/// Time that devices are given to wake up, send their configuration and be found, before it counts
/// whether they are tracked.
const WARM_UP_NS: i64 = 3 * SECOND_NS as i64;

/// Share of ticks at which a role's device was tracked.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    seen: u64,
    tracked: u64,
}

/// Collects over the ticks of a run.
#[derive(Debug, Default)]
pub struct Tally {
    first: Option<HostTime>,
    ticks: u64,
    counted: u64,
    shares: [Share; Role::COUNT],
    residual_squares: [f64; Role::COUNT],
    qualities: [u64; 4],
    worn: worn::Report,
    recoveries: Option<Recoveries>,
}

impl Tally {
    /// Counts one tick.
    pub fn pose(&mut self, pose: &PublishedPose) {
        let first = *self.first.get_or_insert(pose.target_at);
        self.ticks += 1;
        self.worn = pose.worn;
        self.recoveries = pose.recoveries;
        self.qualities[pose.quality as usize] += 1;
        if pose.target_at.since_ns(first) < WARM_UP_NS {
            return;
        }
        self.counted += 1;
        for (role, part) in pose.parts.iter().enumerate() {
            let share = &mut self.shares[role];
            share.seen += u64::from(!matches!(part, Lookup::Empty));
            if let Some(pose) = optical(part) {
                share.tracked += 1;
                self.residual_squares[role] += f64::from(pose.residual_rad).powi(2);
            }
        }
    }

    /// The report.
    #[must_use]
    pub fn report(&self, devices: &[DeviceInfo], capture_s: f64, wall_s: f64) -> Report {
        let counted = self.counted.max(1) as f64;
        let device = |device: &DeviceInfo| {
            let role = device.role as usize;
            let tracked = self.shares[role].tracked;
            DeviceReport {
                serial: device.identity.serial.to_string(),
                model: device.identity.model,
                role: device.role.name(),
                tracked_share: tracked as f64 / counted,
                residual_rms_rad: (self.residual_squares[role] / tracked.max(1) as f64).sqrt(),
                packets: device.counters.packets,
                imu_samples: device.counters.imu,
                poses: device.counters.poses,
                orientations: device.counters.orientations,
                battery: device.battery.map(|battery| battery.charge),
                rssi_dbm: device.radio.and_then(|radio| radio.rssi_dbm),
                radio_received: device.radio.map(|radio| radio.received),
                radio_lost: device.radio.map(|radio| radio.lost),
                drift_degrees_per_minute: self.worn.drift[role],
                decode_errors: device.counters.decode_errors,
                dropped: device.counters.dropped,
                last_error: device.counters.last_error.as_ref().map(ToString::to_string),
            }
        };
        Report {
            capture_s,
            wall_s,
            times_real_time: capture_s / wall_s.max(1e-9),
            ticks: self.ticks,
            quality: QualityReport {
                held: self.qualities[0],
                degraded: self.qualities[1],
                partial: self.qualities[2],
                full: self.qualities[3],
            },
            devices: devices.iter().map(device).collect(),
            calibrated: self.worn.calibrated,
            recoveries: self.recoveries.map(RecoveriesReport::from),
        }
    }
}

/// A pose that the light stands behind, now.
fn optical(part: &Lookup<Pose>) -> Option<Pose> {
    part.fresh().filter(|pose| pose.how == PoseHow::Optical)
}

/// A run's figures.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Length of the capture, s.
    pub capture_s: f64,
    /// Time that it took, s.
    pub wall_s: f64,
    /// The one over the other.
    pub times_real_time: f64,
    /// Body poses made.
    pub ticks: u64,
    /// Body poses by quality.
    pub quality: QualityReport,
    /// The devices.
    pub devices: Vec<DeviceReport>,
    /// Inertial trackers that are calibrated.
    pub calibrated: u8,
    /// How often a simulated body had to be put back on its feet.
    pub recoveries: Option<RecoveriesReport>,
}

/// How often a simulated body had to be put back on its feet, see [`posed_tracker::Recoveries`].
#[derive(Debug, Clone, Copy, Serialize)]
pub struct RecoveriesReport {
    pub falls: u64,
    pub drifts: u64,
    pub faults: u64,
}

impl From<Recoveries> for RecoveriesReport {
    fn from(counts: Recoveries) -> Self {
        Self {
            falls: counts.falls,
            drifts: counts.drifts,
            faults: counts.faults,
        }
    }
}

/// Body poses by quality, see [`posed_tracker::Quality`].
#[derive(Debug, Clone, Copy, Serialize)]
pub struct QualityReport {
    pub held: u64,
    pub degraded: u64,
    pub partial: u64,
    pub full: u64,
}

/// One device's figures.
#[derive(Debug, Clone, Serialize)]
pub struct DeviceReport {
    /// Serial number.
    pub serial: String,
    /// Product.
    pub model: &'static str,
    /// What it stood for.
    pub role: &'static str,
    /// Share of ticks from the fourth second on at which light stood behind its pose.
    pub tracked_share: f64,
    /// Root mean square of the residuals at those ticks, rad.
    pub residual_rms_rad: f64,
    /// USB packets.
    pub packets: u64,
    /// Inertial samples.
    pub imu_samples: u64,
    /// Poses solved.
    pub poses: u64,
    /// Orientations of an inertial tracker.
    pub orientations: u64,
    /// Battery, 0 to 1.
    pub battery: Option<f32>,
    /// Signal strength, dBm.
    pub rssi_dbm: Option<f32>,
    /// Packets that arrived by radio, where a receiver counts them.
    pub radio_received: Option<u64>,
    /// Packets that did not.
    pub radio_lost: Option<u64>,
    /// How fast its heading wanders, degrees a minute, where that could be told.
    pub drift_degrees_per_minute: Option<f32>,
    /// Packets that could not be decoded.
    pub decode_errors: u64,
    /// Samples lost to a full ring.
    pub dropped: u64,
    /// The last decoding error.
    pub last_error: Option<String>,
}

impl Report {
    /// A table for people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        let _ = writeln!(
            text,
            "{:.1} s in {:.2} s ({:.1} times real time), {} body poses: {} full, {} partial, \
             {} degraded, {} held",
            self.capture_s,
            self.wall_s,
            self.times_real_time,
            self.ticks,
            self.quality.full,
            self.quality.partial,
            self.quality.degraded,
            self.quality.held,
        );
        let _ = writeln!(
            text,
            "{:<14} {:<24} {:<11} {:>8} {:>10} {:>8} {:>8} {:>7}",
            "serial", "model", "role", "tracked", "residual", "imu", "poses", "errors"
        );
        for device in &self.devices {
            let _ = writeln!(
                text,
                "{:<14} {:<24} {:<11} {:>7.2}% {:>6.0} urad {:>8} {:>8} {:>7}",
                device.serial,
                device.model,
                device.role,
                100.0 * device.tracked_share,
                1e6 * device.residual_rms_rad,
                device.imu_samples,
                device.poses,
                device.decode_errors,
            );
        }
        self.trackers(&mut text);
        if let Some(counts) = self.recoveries {
            let RecoveriesReport {
                falls,
                drifts,
                faults,
            } = counts;
            let _ = writeln!(
                text,
                "the simulated body was put back after {falls} falls, {drifts} drifts, {faults} faults"
            );
        }
        text
    }

    /// A table of the inertial trackers, if there are any.
    fn trackers(&self, text: &mut String) {
        let trackers = || self.devices.iter().filter(|device| device.orientations > 0);
        if trackers().next().is_none() {
            return;
        }
        let _ = writeln!(
            text,
            "{} inertial trackers calibrated\n{:<14} {:<11} {:>12} {:>8} {:>8} {:>8} {:>14}",
            self.calibrated, "serial", "role", "orientations", "battery", "signal", "lost", "drift"
        );
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".into());
        for device in trackers() {
            let lost = device.radio_lost.zip(device.radio_received);
            let share = |(lost, received): (u64, u64)| {
                format!(
                    "{:.1}%",
                    100.0 * lost as f64 / (lost + received).max(1) as f64
                )
            };
            let drift = device.drift_degrees_per_minute;
            let _ = writeln!(
                text,
                "{:<14} {:<11} {:>12} {:>8} {:>8} {:>8} {:>14}",
                device.serial,
                device.role,
                device.orientations,
                or_dash(
                    device
                        .battery
                        .map(|charge| format!("{:.0}%", 100.0 * charge))
                ),
                or_dash(device.rssi_dbm.map(|dbm| format!("{dbm:.0} dBm"))),
                or_dash(lost.map(share)),
                or_dash(drift.map(|drift| format!("{drift:+.2} deg/min"))),
            );
        }
    }
}
