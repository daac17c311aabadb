//! What a capture holds of a SlimeVR receiver.

use std::collections::BTreeMap;

use posed_signal::HostTime;

use super::wire::{self, Content, Firmware, Power};
use crate::usb::{Packet, Transfer};

/// One tracker.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackerReport {
    /// Its address in hexadecimal digits, if the receiver named it.
    pub address: Option<String>,
    /// Packets with an orientation.
    pub motions: u64,
    /// Packets with an orientation a second, over the time from the first to the last.
    pub rate_hz: Option<f64>,
    /// Mean length of the accelerations, m/s^2, gravity taken out.
    pub mean_accel: Option<f64>,
    /// Battery, 0 to 1.
    pub charge: Option<f32>,
    /// Signal strength, dBm.
    pub rssi_dbm: Option<f32>,
    /// Packets that the receiver says arrived by radio.
    pub received: u64,
    /// Packets that it says did not.
    pub lost: u64,
    /// Firmware version.
    pub firmware: Option<[u8; 3]>,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Reports.
    pub reports: u64,
    /// Reports and packets in them that could not be read.
    pub errors: u64,
    /// The first of those errors.
    pub first_error: Option<String>,
    /// Trackers that were heard, by their number at the receiver.
    pub trackers: BTreeMap<u8, TrackerReport>,
}

#[derive(Debug, Default)]
struct Heard {
    motions: u64,
    span: Option<(HostTime, HostTime)>,
    accel_sum: f64,
    accels: u64,
    charge: Option<f32>,
    rssi_dbm: Option<f32>,
    received: u64,
    lost: u64,
    firmware: Option<Firmware>,
}

/// Takes packets and counts.
#[derive(Debug, Default)]
pub struct Inspector {
    reports: u64,
    errors: u64,
    first_error: Option<String>,
    addresses: BTreeMap<u8, u64>,
    heard: BTreeMap<u8, Heard>,
}

impl Inspector {
    /// Takes one transfer of the device.
    pub fn packet(&mut self, packet: &Packet) {
        if packet.transfer != Transfer::Interrupt || !packet.is_input() {
            return;
        }
        self.reports += 1;
        match wire::packets(&packet.data) {
            Err(error) => self.error(&error),
            Ok(contents) => {
                for content in contents {
                    match content {
                        Ok(content) => self.take(packet.at, content),
                        Err(error) => self.error(&error),
                    }
                }
            }
        }
    }

    /// What was found so far.
    #[must_use]
    pub fn report(&self) -> Report {
        let tracker = |(&number, heard): (&u8, &Heard)| {
            let address = self.addresses.get(&number);
            (number, heard.report(address.copied()))
        };
        Report {
            reports: self.reports,
            errors: self.errors,
            first_error: self.first_error.clone(),
            trackers: self.heard.iter().map(tracker).collect(),
        }
    }

    fn error(&mut self, error: &crate::decode::DecodeError) {
        self.errors += 1;
        self.first_error.get_or_insert_with(|| error.to_string());
    }

    fn take(&mut self, at: HostTime, packet: wire::Packet) {
        if let Content::Register { address } = packet.content {
            self.addresses.insert(packet.tracker, address);
            return;
        }
        self.heard
            .entry(packet.tracker)
            .or_default()
            .take(at, packet.content);
    }
}

impl Heard {
    fn take(&mut self, at: HostTime, content: Content) {
        let signal = match content {
            Content::Info { signal, .. }
            | Content::MotionAndPower { signal, .. }
            | Content::Status { signal, .. }
            | Content::Runtime { signal, .. }
            | Content::Button { signal, .. }
            | Content::MotionAndButton { signal, .. } => signal.dbm(),
            _ => None,
        };
        self.rssi_dbm = signal.or(self.rssi_dbm);
        match content {
            Content::Info {
                power, firmware, ..
            } => {
                self.power(power);
                self.firmware = Some(firmware);
            }
            Content::MotionAndPower { motion, power, .. } => {
                self.power(power);
                self.motion(at, Some(motion.accel));
            }
            Content::Motion(motion) | Content::MotionAndButton { motion, .. } => {
                self.motion(at, Some(motion.accel));
            }
            Content::Field { .. } => self.motion(at, None),
            Content::Status { link, .. } => {
                self.received += u64::from(link.received);
                self.lost += u64::from(link.lost);
            }
            _ => {}
        }
    }

    fn power(&mut self, power: Power) {
        self.charge = power.charge().or(self.charge);
    }

    fn motion(&mut self, at: HostTime, accel: Option<glam::Vec3>) {
        self.motions += 1;
        let (first, _) = self.span.unwrap_or((at, at));
        self.span = Some((first, at));
        if let Some(accel) = accel {
            self.accel_sum += f64::from(accel.length());
            self.accels += 1;
        }
    }

    fn report(&self, address: Option<u64>) -> TrackerReport {
        let seconds = self.span.map(|(first, last)| last.since_secs(first));
        let intervals = self.motions.saturating_sub(1) as f64;
        TrackerReport {
            address: address.map(|address| format!("{address:012X}")),
            motions: self.motions,
            rate_hz: seconds.filter(|&s| s > 0.0).map(|s| intervals / s),
            mean_accel: (self.accels > 0).then(|| self.accel_sum / self.accels as f64),
            charge: self.charge,
            rssi_dbm: self.rssi_dbm,
            received: self.received,
            lost: self.lost,
            firmware: self.firmware.map(|firmware| firmware.version),
        }
    }
}
