//! What the traffic of one Lighthouse device holds, counted without tracking it.

use std::collections::BTreeMap;

use posed_signal::HostTime;

use super::{
    base_station::Source,
    input::{MainboardInput, WiredInput},
    light::{Light, Seen},
    model::{DeviceModel, GRAVITY, ImuRange},
    ootx::Broadcast,
    reader::{Event, Reader},
    rotor::Rotor,
    wire::TICKS_PER_SECOND,
};
use crate::usb::Packet;

/// What was seen of one base station of generation 2.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelReport {
    /// Rotor zeros.
    pub syncs: u64,
    /// Sensors swept.
    pub sweeps: u64,
    /// Speed of its rotor by the device's clock, revolutions a second.
    pub rotor_hz: Option<f64>,
}

/// What was seen of one base station of either generation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StationReport {
    /// Sensors swept whose angle is known.
    pub sweeps: u64,
    /// Complete frames of its data.
    pub broadcasts: u64,
    /// What it said last.
    pub broadcast: Option<Broadcast>,
    /// Whether two base stations were seen to be set to its channel.
    pub shared: bool,
}

/// What was counted.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Packets of any kind.
    pub packets: u64,
    /// Packets that could not be decoded.
    pub errors: u64,
    /// The first of those errors, in words.
    pub first_error: Option<String>,
    /// Inertial samples, each counted once.
    pub imu_samples: u64,
    /// Inertial samples that remain when a wired device's reports are read slot by slot and what
    /// is not newer than the slot before is left out. A report may hold its newest sample first,
    /// so this is less than [`Report::imu_samples`]; published counts are often made this way.
    pub imu_samples_in_slot_order: u64,
    /// Median length of the raw acceleration, LSB.
    pub median_accel_lsb: Option<f64>,
    /// The same in g, where the IMU's range is known.
    pub median_accel_g: Option<f64>,
    /// Device ticks in a second of the host, from the inertial samples.
    pub clock_hz: Option<f64>,
    /// Times at which that clock jumped.
    pub clock_jumps: u64,
    /// Rotor zeros of base stations of generation 2.
    pub syncs: u64,
    /// Sensors swept by base stations of generation 2.
    pub sweeps: u64,
    /// The same by channel.
    pub channels: BTreeMap<u8, ChannelReport>,
    /// What was made of the light, by base station.
    pub stations: BTreeMap<Source, StationReport>,
    /// Light pulses under base stations of generation 1.
    pub pulses: u64,
    /// Reports of beams that the device had not decoded yet.
    pub raw_beams: u64,
    /// Radio packets.
    pub radio_packets: u64,
    /// Changes of buttons, triggers and pads.
    pub inputs: u64,
    /// The device's configuration, JSON.
    pub configuration: Option<String>,
    /// Serial number in the configuration.
    pub serial: Option<String>,
    /// Product, by the configuration.
    pub model: Option<&'static str>,
    /// What a Vive's mainboard said last.
    pub mainboard: Option<MainboardInput>,
    /// Battery, per cent, and whether it is charging.
    pub battery: Option<(u8, bool)>,
}

impl Report {
    /// How many of the inertial samples of a wired device lay out of their report's slot order;
    /// zero for radio devices, whose packets hold one sample.
    #[must_use]
    pub fn imu_samples_out_of_slot_order(&self) -> u64 {
        match self.imu_samples_in_slot_order {
            0 => 0,
            in_order => self.imu_samples.saturating_sub(in_order),
        }
    }

    /// Light of any kind.
    #[must_use]
    pub fn light(&self) -> u64 {
        self.sweeps + self.pulses
    }
}

/// Counts the packets of one USB device.
#[derive(Debug, Clone)]
pub struct Inspector {
    reader: Reader,
    events: Vec<Event>,
    report: Report,
    range: Option<ImuRange>,
    /// How many samples had an acceleration of so many LSB.
    accel: Vec<u32>,
    clock: Clock,
    rotors: BTreeMap<u8, Rotor>,
    light: Light,
}

impl Inspector {
    /// `range`: full scales that such devices are set to, where the product tells.
    #[must_use]
    pub fn new(range: Option<ImuRange>) -> Self {
        Self {
            reader: Reader::default(),
            events: Vec::new(),
            report: Report::default(),
            range,
            accel: Vec::new(),
            clock: Clock::default(),
            rotors: BTreeMap::new(),
            light: Light::default(),
        }
    }

    /// Takes a packet.
    pub fn packet(&mut self, packet: &Packet) {
        self.report.packets += 1;
        let mut events = std::mem::take(&mut self.events);
        if let Err(error) = self.reader.packet(packet, &mut events) {
            self.report.errors += 1;
            self.report
                .first_error
                .get_or_insert_with(|| error.to_string());
        }
        for event in events.drain(..) {
            self.event(event, packet.at);
        }
        self.events = events;
    }

    /// What was counted so far.
    #[must_use]
    pub fn report(&self) -> Report {
        let mut report = self.report.clone();
        report.imu_samples_in_slot_order = self.reader.imu_in_slot_order();
        report.median_accel_lsb = median(&self.accel);
        report.median_accel_g = report
            .median_accel_lsb
            .zip(self.range)
            .map(|(median, range)| median * range.accel / GRAVITY);
        report.clock_hz = self.clock.rate();
        report.clock_jumps = self.clock.jumps;
        for (channel, rotor) in &self.rotors {
            if let Some(entry) = report.channels.get_mut(channel) {
                entry.rotor_hz = rotor.speed_hz();
            }
        }
        report
    }

    fn event(&mut self, event: Event, at: HostTime) {
        let report = &mut self.report;
        self.light.event(&event, &mut |seen| match seen {
            Seen::Sweep(sweep) => report.stations.entry(sweep.source).or_default().sweeps += 1,
            Seen::Shared(source) => report.stations.entry(source).or_default().shared = true,
            Seen::Broadcast(source, broadcast) => {
                let entry = report.stations.entry(source).or_default();
                entry.broadcasts += 1;
                entry.broadcast = Some(broadcast);
            }
        });
        match event {
            Event::Imu { ticks, raw } => {
                report.imu_samples += 1;
                self.clock.observe(ticks, at);
                let [x, y, z] = raw.accel.map(f64::from);
                let length = (x * x + y * y + z * z).sqrt().round() as usize;
                // The longest vector of three 16-bit numbers.
                self.accel.resize(56_757, 0);
                self.accel[length.min(56_756)] += 1;
            }
            Event::Sync { channel, ticks, .. } => {
                report.syncs += 1;
                report.channels.entry(channel).or_default().syncs += 1;
                self.rotors
                    .entry(channel)
                    .or_insert_with(|| Rotor::new(channel))
                    .sync(ticks);
            }
            Event::Sweep { channel, .. } => {
                report.sweeps += 1;
                report.channels.entry(channel).or_default().sweeps += 1;
            }
            Event::Pulse { .. } => report.pulses += 1,
            Event::RawBeams => report.raw_beams += 1,
            Event::RadioPacket => report.radio_packets += 1,
            Event::Radio(_) => report.inputs += 1,
            Event::Wired(WiredInput::Battery(byte)) | Event::Battery(byte) => {
                report.battery = Some((byte & 0x7f, byte & 0x80 != 0));
            }
            Event::Wired(_) => report.inputs += 1,
            Event::Mainboard(input) => report.mainboard = Some(input),
            Event::Ranges(gyro, accel) => self.range = ImuRange::from_codes(gyro, accel),
            Event::Configuration(text) => self.configuration(text),
            Event::ConfigurationProgress | Event::Off => {}
        }
    }

    fn configuration(&mut self, text: String) {
        match DeviceModel::from_json(&text) {
            Ok(model) => {
                self.report.serial = Some(model.identity.serial.as_str().to_owned());
                self.report.model = Some(model.identity.model);
                self.range = Some(model.range);
            }
            Err(error) => {
                self.report.errors += 1;
                self.report
                    .first_error
                    .get_or_insert_with(|| error.to_string());
            }
        }
        self.report.configuration = Some(text);
    }
}

/// The median of a histogram whose bins are one apart.
fn median(bins: &[u32]) -> Option<f64> {
    let total: u64 = bins.iter().map(|&count| u64::from(count)).sum();
    let mut below = 0;
    for (value, &count) in bins.iter().enumerate() {
        if count > 0 && 2 * (below + u64::from(count)) >= total {
            // Within the bin the values are taken to be spread evenly.
            let share = (total as f64 / 2.0 - below as f64) / f64::from(count);
            return Some(value as f64 - 0.5 + share);
        }
        below += u64::from(count);
    }
    None
}

/// Ticks against host time. Reports come late, never early, so that in each second the least
/// difference counts; the drift is the median of the slopes between such minima (Theil and Sen).
#[derive(Debug, Clone, Default)]
struct Clock {
    /// Device time and least host minus device time of each second since the last jump, s.
    minima: Vec<(f64, f64)>,
    /// Rate and seconds of the longest stretch before a jump.
    before: Option<(f64, usize)>,
    last: Option<(f64, f64)>,
    jumps: u64,
}

/// More seconds do not make the rate any better.
const CLOCK_SECONDS_MAX: usize = 600;

impl Clock {
    fn observe(&mut self, ticks: u64, at: HostTime) {
        let device = ticks as f64 / TICKS_PER_SECOND;
        let offset = at.as_secs_f64() - device;
        if self
            .last
            .is_some_and(|(_, last)| (offset - last).abs() > 0.25)
        {
            self.jumps += 1;
            if let Some(rate) = self.stretch_rate()
                && self
                    .before
                    .is_none_or(|(_, seconds)| seconds < self.minima.len())
            {
                self.before = Some((rate, self.minima.len()));
            }
            self.minima.clear();
        }
        self.last = Some((device, offset));
        let full = self.minima.len() >= CLOCK_SECONDS_MAX;
        match self.minima.last_mut() {
            Some(newest) if device.floor() <= newest.0.floor() => {
                if offset < newest.1 {
                    *newest = (device, offset);
                }
            }
            _ if full => {}
            _ => self.minima.push((device, offset)),
        }
    }

    fn rate(&self) -> Option<f64> {
        match (self.stretch_rate(), self.before) {
            (Some(_), Some((rate, seconds))) if seconds > self.minima.len() => Some(rate),
            (Some(rate), _) | (None, Some((rate, _))) => Some(rate),
            (None, None) => None,
        }
    }

    fn stretch_rate(&self) -> Option<f64> {
        let apart = self.minima.len().div_ceil(2);
        let mut slopes: Vec<f64> = self
            .minima
            .iter()
            .zip(self.minima.iter().skip(apart))
            .map(|(early, late)| (late.1 - early.1) / (late.0 - early.0))
            .collect();
        slopes.sort_by(f64::total_cmp);
        let slope = slopes.get(slopes.len() / 2)?;
        Some(TICKS_PER_SECOND / (1.0 + slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_a_histogram() {
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[0, 0, 4]), Some(2.0));
        assert!((median(&[0, 1, 8, 1]).unwrap() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_jump_of_the_clock_does_not_spoil_its_rate() {
        let mut clock = Clock::default();
        for n in 0..20_000u64 {
            let reset = if n < 5_000 { 1 << 40 } else { 0 };
            let late = if n % 7 == 0 {
                90_000_000
            } else {
                n % 3 * 1_000_000
            };
            clock.observe(reset + n * 48_010, HostTime(n * 1_000_000 + late));
        }
        assert_eq!(clock.jumps, 1);
        assert!((clock.rate().unwrap() - 48_010_000.0).abs() < 5_000.0);
    }
}
