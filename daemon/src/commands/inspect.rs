//! `posed inspect`.

use std::{collections::BTreeMap, fmt::Write as _, fs::File, io::BufReader, path::Path};

use posed_device::{
    capture::{self, Item, identity},
    catalog::{self, Entry, Family},
    joycon,
    lighthouse::inspect::{Inspector, Report},
    slimevr,
    trouble::Trouble,
    usb::{Packet, Port, UsbId},
};
use posed_signal::HostTime;
use serde_json::{Value, json};

mod trackers;

use super::{CommandError, replay::identities_beside};
use crate::cli::InspectArgs;

/// Warnings kept; a capture full of rubbish has millions.
const WARNINGS_MAX: usize = 100;

/// What a capture holds.
#[derive(Debug, Default)]
pub struct Inspection {
    statistics: capture::Statistics,
    warnings: Vec<String>,
    warnings_in_all: usize,
    first: Option<HostTime>,
    last: HostTime,
    devices: BTreeMap<Port, Found>,
}

/// One USB device of a capture.
#[derive(Debug)]
struct Found {
    id: Option<UsbId>,
    entry: Option<&'static Entry>,
    inertial_reports: u32,
    /// What the device is may turn out late: until then each family counts for itself.
    inspector: Inspector,
    slimevr: slimevr::inspect::Inspector,
    joycon: joycon::inspect::Inspector,
}

impl Default for Found {
    fn default() -> Self {
        Self {
            id: None,
            entry: None,
            inertial_reports: 0,
            inspector: Inspector::new(None),
            slimevr: slimevr::inspect::Inspector::default(),
            joycon: joycon::inspect::Inspector::default(),
        }
    }
}

impl Found {
    fn known(&mut self, id: UsbId) {
        self.id = Some(id);
        self.entry = catalog::find(id).or(self.entry);
    }

    fn family(&self) -> Family {
        self.entry.map_or(Family::Lighthouse, |entry| entry.family)
    }

    fn packet(&mut self, packet: &Packet) {
        if let Some(id) = identity::device_descriptor(packet) {
            self.known(id);
        }
        if self.entry.is_none() {
            self.entry = catalog::recognise(packet, &mut self.inertial_reports);
        }
        if self.entry.is_none() || self.family() == Family::Lighthouse {
            self.inspector.packet(packet);
        }
        if self.entry.is_none() || self.family() == Family::SlimeVr {
            self.slimevr.packet(packet);
        }
        if self.entry.is_none() || self.family() == Family::JoyCon {
            self.joycon.packet(packet);
        }
    }
}

/// Prints what the capture holds.
///
/// # Errors
/// The file cannot be opened or is no capture. Damage further in is a warning.
pub fn run(args: &InspectArgs) -> Result<(), CommandError> {
    let inspection = inspect(&args.file)?;
    if args.json {
        let value = inspection.json(&args.file);
        println!(
            "{}",
            serde_json::to_string_pretty(&value).map_err(std::io::Error::from)?
        );
    } else {
        print!("{}", inspection.text(&args.file));
    }
    Ok(())
}

/// Reads a capture through.
///
/// # Errors
/// The file cannot be opened or is no capture.
pub fn inspect(path: &Path) -> Result<Inspection, CommandError> {
    let file = File::open(path).map_err(|error| CommandError::file(path, error))?;
    let length = file.metadata().map_or(0, |data| data.len());
    let progress = indicatif::ProgressBar::new(length);
    let input = progress.wrap_read(BufReader::with_capacity(1 << 16, file));
    let mut reader = capture::open(input)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))?;
    let mut inspection = Inspection::default();
    for (port, id) in identities_beside(path) {
        inspection.devices.entry(port).or_default().known(id);
    }
    for item in reader.by_ref() {
        inspection.item(item);
    }
    inspection.statistics = reader.statistics();
    progress.finish_and_clear();
    Ok(inspection)
}

impl Inspection {
    fn item(&mut self, item: Item) {
        match item {
            Item::Device(port, id) => self.devices.entry(port).or_default().known(id),
            Item::Packet(packet) => {
                self.first.get_or_insert(packet.at);
                self.last = self.last.max(packet.at);
                self.devices.entry(packet.port).or_default().packet(&packet);
            }
            Item::Warning(warning) => {
                self.warnings_in_all += 1;
                if self.warnings.len() < WARNINGS_MAX {
                    self.warnings.push(warning.to_string());
                }
            }
        }
    }

    fn seconds(&self) -> f64 {
        self.first.map_or(0.0, |first| self.last.since_secs(first))
    }

    /// As JSON.
    #[must_use]
    pub fn json(&self, path: &Path) -> Value {
        let devices: Vec<_> = self
            .devices
            .iter()
            .map(|(port, found)| found.json(*port))
            .collect();
        json!({
            "file": path.display().to_string(),
            "seconds": self.seconds(),
            "records": self.statistics.records,
            "packets": self.statistics.packets,
            "failed_transfers": self.statistics.failed,
            "malformed_records": self.statistics.malformed,
            "warnings": self.warnings,
            "warnings_in_all": self.warnings_in_all,
            "devices": devices,
        })
    }

    /// For people.
    #[must_use]
    pub fn text(&self, path: &Path) -> String {
        let mut text = format!(
            "{}: {:.1} s, {} records, {} packets with data\n",
            path.display(),
            self.seconds(),
            self.statistics.records,
            self.statistics.packets
        );
        for warning in &self.warnings {
            let _ = writeln!(text, "warning: {warning}");
        }
        for (port, found) in &self.devices {
            found.text(*port, &mut text);
        }
        text
    }
}

impl Found {
    fn json(&self, port: Port) -> Value {
        let mut value = match self.family() {
            Family::Lighthouse => self.lighthouse_json(),
            Family::SlimeVr => trackers::slimevr_json(&self.slimevr.report()),
            Family::JoyCon => trackers::joycon_json(&self.joycon.report()),
        };
        if let Value::Object(fields) = &mut value {
            fields.insert("port".into(), port.to_string().into());
            fields.insert("usb".into(), self.id.map(|id| id.to_string()).into());
            fields.insert("device".into(), self.entry.map(|entry| entry.name).into());
        }
        value
    }

    fn lighthouse_json(&self) -> Value {
        let report = self.inspector.report();
        let out_of_slot_order = report.imu_samples_out_of_slot_order();
        let configuration = report
            .configuration
            .as_deref()
            .and_then(|text| serde_json::from_str::<Value>(text).ok());
        json!({
            "model": report.model,
            "serial": report.serial,
            "packets": report.packets,
            "errors": report.errors,
            "first_error": report.first_error,
            // Published counts leave out what lies out of slot order; the tracker uses both.
            "imu_samples": report.imu_samples - out_of_slot_order,
            "imu_samples_out_of_slot_order": out_of_slot_order,
            "median_accel_lsb": report.median_accel_lsb,
            "median_accel_g": report.median_accel_g,
            "clock_mhz": report.clock_hz.map(|hz| hz * 1e-6),
            "clock_jumps": report.clock_jumps,
            "sweeps": report.sweeps,
            "syncs": report.syncs,
            "pulses": report.pulses,
            "raw_beams": report.raw_beams,
            "radio_packets": report.radio_packets,
            "inputs": report.inputs,
            "battery_percent": report.battery.map(|(percent, _)| percent),
            "channels": channels(&report),
            "troubles": shared(&report).map(|trouble| trouble.to_string()).collect::<Vec<_>>(),
            "configuration": configuration,
        })
    }

    fn text(&self, port: Port, text: &mut String) {
        let id = self
            .id
            .map_or_else(|| "????:????".into(), |id| id.to_string());
        let entry = self.entry.map(|entry| entry.name);
        match self.family() {
            Family::Lighthouse => {}
            Family::SlimeVr => {
                let name = entry.unwrap_or("SlimeVR receiver");
                let _ = writeln!(text, "\n{port}  {id}  {name}");
                return trackers::slimevr_text(&self.slimevr.report(), text);
            }
            Family::JoyCon => {
                let report = self.joycon.report();
                let name = report.model.or(entry).unwrap_or("Joy-Con");
                let serial = report.serial.as_deref().unwrap_or("");
                let _ = writeln!(text, "\n{port}  {id}  {name}  {serial}");
                return trackers::joycon_text(&report, text);
            }
        }
        let report = self.inspector.report();
        let name = report.model.or(entry).unwrap_or("unknown device");
        let serial = report.serial.as_deref().unwrap_or("");
        let _ = writeln!(text, "\n{port}  {id}  {name}  {serial}");
        let _ = write!(text, "  {} packets", report.packets);
        if report.errors > 0 {
            let first = report.first_error.as_deref().unwrap_or("");
            let _ = write!(text, ", {} not decoded (first: {first})", report.errors);
        }
        let _ = writeln!(text);
        if report.imu_samples > 0 {
            let out_of_slot_order = report.imu_samples_out_of_slot_order();
            let in_order = report.imu_samples - out_of_slot_order;
            let _ = write!(text, "  inertial: {in_order} samples");
            if out_of_slot_order > 0 {
                let _ = write!(text, " and {out_of_slot_order} out of slot order");
            }
            if let Some(g) = report.median_accel_g {
                let _ = write!(text, ", median |a| {g:.4} g");
            }
            if let Some(hz) = report.clock_hz {
                let _ = write!(text, ", device clock {:.4} MHz", hz * 1e-6);
            }
            let _ = writeln!(text);
        }
        if report.sweeps + report.pulses > 0 {
            let _ = writeln!(
                text,
                "  light: {} sweeps, {} syncs, {} pulses",
                report.sweeps, report.syncs, report.pulses
            );
        }
        for (channel, seen) in &report.channels {
            let rotor = seen
                .rotor_hz
                .map_or_else(String::new, |hz| format!(", rotor {hz:.4} Hz"));
            let _ = writeln!(
                text,
                "    channel {channel}: {} sweeps, {} syncs{rotor}",
                seen.sweeps, seen.syncs
            );
        }
        for trouble in shared(&report) {
            let _ = writeln!(text, "  trouble: {trouble}");
        }
        if let Some(configuration) = &report.configuration {
            let _ = writeln!(
                text,
                "  configuration: {} bytes of JSON",
                configuration.len()
            );
        }
    }
}

/// Channels that two base stations share.
fn shared(report: &Report) -> impl Iterator<Item = Trouble> {
    let stations = report.stations.iter().filter(|(_, seen)| seen.shared);
    stations.map(|(source, _)| Trouble::Shared(*source))
}

fn channels(report: &Report) -> Value {
    let one = |(channel, seen): (&u8, &posed_device::lighthouse::inspect::ChannelReport)| {
        json!({
            "channel": channel,
            "sweeps": seen.sweeps,
            "syncs": seen.syncs,
            "rotor_hz": seen.rotor_hz,
        })
    };
    report.channels.iter().map(one).collect()
}
