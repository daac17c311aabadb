//! `posed survey`: how well the devices of many captures are tracked, one table.

mod measure;
mod reference;

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use posed_device::{
    capture, catalog,
    lighthouse::{base_station::BaseStation, inspect::Inspector, room},
    rig::{self, Rig},
    transport::{Event, Merge, Replay, Transport},
    usb::Port,
};
use posed_signal::{DeviceId, HostTime, Sample, ring::Consumer, time::MILLISECOND_NS};
use serde::Serialize;

use self::{
    measure::Measures,
    reference::{Comparison, Reference},
};
use super::{CommandError, replay::recording, settings};
use crate::cli::{Stations, SurveyArgs};

/// Decoders are ticked this often.
const TICK_NS: i64 = 50 * MILLISECOND_NS as i64;

/// One device of one capture.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The capture's file name.
    pub capture: String,
    /// Serial number.
    pub serial: String,
    /// Product.
    pub model: String,
    /// Base stations whose light it saw, by channel or slot.
    pub light: Vec<String>,
    /// Sweeps of sensors by light planes.
    pub sweeps: u64,
    /// Where the base stations' poses came from: a file's name, or nothing.
    pub stations: Option<String>,
    /// What was measured of its poses.
    pub measures: Measures,
    /// How far they are from libsurvive's, where a recording has those.
    pub reference: Option<Comparison>,
}

/// A base station of one capture, relative to the first one, as its light tells.
#[derive(Debug, Clone, Serialize)]
pub struct Relation {
    /// The capture's file name.
    pub capture: String,
    /// Which one, and relative to which.
    pub stations: [String; 2],
    /// How far apart they are, m.
    pub apart_m: f64,
    /// Standard deviation of the relative place by the light, over all axes, m.
    pub sigma_m: Option<f64>,
    /// The same of the relative rotation, degrees.
    pub sigma_degrees: Option<f64>,
    /// How far off the file beside the capture the place is, where that holds both, m.
    pub off_m: Option<f64>,
    /// The same of the rotation, degrees.
    pub off_degrees: Option<f64>,
    /// The distance in that file over the one found.
    pub file_scale: Option<f64>,
}

/// Everything about some captures.
#[derive(Debug, Default, Serialize)]
struct Survey {
    devices: Vec<Row>,
    stations: Vec<Relation>,
}

/// Surveys the captures and prints the table.
///
/// # Errors
/// A folder cannot be read, or there is no capture in any. A capture that cannot be read is a line
/// of the table.
pub fn run(args: &SurveyArgs) -> Result<(), CommandError> {
    let mut files = BTreeSet::new();
    for path in &args.paths {
        find(path, &mut files)?;
    }
    let mut all = Survey::default();
    let mut captures = 0;
    for path in &files {
        let file = fs::File::open(path).map_err(|error| CommandError::file(path, error))?;
        if capture::open(file).is_err() {
            continue;
        }
        captures += 1;
        match survey(path, args.base_stations) {
            Ok(found) => {
                all.devices.extend(found.devices);
                all.stations.extend(found.stations);
            }
            Err(error) => tracing::warn!("{error}"),
        }
    }
    if captures == 0 {
        return Err(CommandError::Input(
            "there is no capture in any of these".into(),
        ));
    }
    if args.json {
        let text = serde_json::to_string_pretty(&all).map_err(std::io::Error::from)?;
        println!("{text}");
    } else {
        print!("{}{}", table(&all.devices), relations(&all.stations));
    }
    Ok(())
}

/// The files under a path.
fn find(path: &Path, files: &mut BTreeSet<PathBuf>) -> Result<(), CommandError> {
    if !path.is_dir() {
        files.insert(path.to_owned());
        return Ok(());
    }
    let entries = fs::read_dir(path).map_err(|error| CommandError::file(path, error))?;
    for entry in entries {
        find(&entry?.path(), files)?;
    }
    Ok(())
}

/// What lies beside `NAME.pcap.gz` or `NAME.rec.gz` with another ending, the first that is there.
fn beside(path: &Path, endings: &[&str]) -> Option<PathBuf> {
    let name = path.file_name()?.to_string_lossy();
    let stem = name.split(".pcap").next()?.split(".rec").next()?;
    endings
        .iter()
        .map(|ending| path.with_file_name(format!("{stem}{ending}")))
        .find(|path| path.is_file())
}

/// Replays one capture and measures its devices.
fn survey(path: &Path, stations: Stations) -> Result<Survey, CommandError> {
    let file = match stations {
        Stations::Beside => beside(path, &[".rec.json", ".json"]),
        Stations::None => None,
    };
    // A file without usable stations is as good as none.
    let known: Vec<BaseStation> = file
        .as_deref()
        .and_then(|file| settings::base_stations(file).ok())
        .unwrap_or_default();
    let named = file.filter(|_| !known.is_empty());
    let mut devices = catalog::Settings::default();
    devices.lighthouse.base_stations = known;
    let room = devices.lighthouse.room.clone();
    let settings = rig::Settings {
        devices,
        ..rig::Settings::default()
    };
    let (rig, rings) = Rig::new(settings);
    let mut run = Run {
        rig,
        rings,
        samples: BTreeMap::new(),
        inspectors: BTreeMap::new(),
        first: None,
        ticked: HostTime(0),
    };
    run.replay(path)?;
    let reference = beside(path, &[".rec.gz", ".rec"])
        .map(|file| Reference::read(&file))
        .transpose()?;
    let from_light = named.is_none();
    Ok(Survey {
        devices: run.rows(path, named.as_deref(), reference.as_ref()),
        stations: if from_light {
            related(path, &room)
        } else {
            Vec::new()
        },
    })
}

/// The stations found in a capture, relative to the first of them.
fn related(path: &Path, room: &room::Handle) -> Vec<Relation> {
    let file = beside(path, &[".rec.json", ".json"]);
    let file = file.and_then(|file| settings::base_stations(&file).ok());
    let file = file.unwrap_or_default();
    let of_file = |station: &BaseStation| file.iter().find(|other| other.id == station.id);
    let pose = |from: &BaseStation, to: &BaseStation| {
        let back = from.rotation.conjugate();
        (back * (to.position - from.position), back * to.rotation)
    };
    let (first, others) = room.with(|room| {
        let others = room.certainties().map(|(station, sigma)| (*station, sigma));
        (room.stations().next().copied(), others.collect::<Vec<_>>())
    });
    let Some(first) = first else {
        return Vec::new();
    };
    let relation = |(station, sigma): (BaseStation, Option<[f64; 2]>)| {
        let (place, turn) = pose(&first, &station);
        let filed = of_file(&first).zip(of_file(&station));
        let filed = filed.map(|(first, station)| pose(first, station));
        Relation {
            capture: path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into(),
            stations: [station.source, first.source].map(|source| source.to_string()),
            apart_m: place.length(),
            sigma_m: sigma.map(|sigma| sigma[0]),
            sigma_degrees: sigma.map(|sigma| sigma[1].to_degrees()),
            off_m: filed.map(|(filed, _)| (filed - place).length()),
            off_degrees: filed.map(|(_, filed)| filed.angle_between(turn).to_degrees()),
            file_scale: filed.map(|(filed, _)| filed.length() / place.length()),
        }
    };
    others.into_iter().map(relation).collect()
}

struct Run {
    rig: Rig,
    rings: Vec<Consumer<Sample>>,
    samples: BTreeMap<DeviceId, Vec<Sample>>,
    inspectors: BTreeMap<Port, Inspector>,
    first: Option<HostTime>,
    ticked: HostTime,
}

impl Run {
    fn replay(&mut self, path: &Path) -> Result<(), CommandError> {
        let mut transport = Replay::new(vec![recording(path)?], Merge::OneSession);
        let mut commands = Vec::new();
        loop {
            match transport.next(0) {
                Event::Packet(packet) => {
                    self.first.get_or_insert(packet.at);
                    self.inspectors
                        .entry(packet.port)
                        .or_insert_with(|| Inspector::new(None))
                        .packet(&packet);
                    self.rig.packet(&packet);
                    if packet.at.since_ns(self.ticked) >= TICK_NS {
                        self.ticked = packet.at;
                        self.rig.tick(packet.at, &mut commands);
                        commands.clear();
                    }
                    self.drain();
                }
                Event::Attached { port, id } => self.rig.attach(port, id),
                Event::Detached { port } => self.rig.detach(port),
                Event::End => return Ok(()),
                Event::Idle | Event::Warning(_) => {}
            }
        }
    }

    fn drain(&mut self) {
        for (index, ring) in self.rings.iter_mut().enumerate() {
            while let Some(sample) = ring.pop() {
                let id = DeviceId(index as u8);
                self.samples.entry(id).or_default().push(sample);
            }
        }
    }
}

impl Run {
    fn rows(
        &self,
        path: &Path,
        stations: Option<&Path>,
        reference: Option<&Reference>,
    ) -> Vec<Row> {
        let name = |path: &Path| {
            path.file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        let first = self.first.unwrap_or(HostTime(0));
        // A recording's times count from its own begin, a capture's from its first packet.
        let origin = if name(path).contains(".rec") {
            HostTime(0)
        } else {
            first
        };
        let row = |device: &rig::DeviceInfo| {
            let samples = self.samples.get(&device.id).map_or(&[][..], Vec::as_slice);
            let report = self.inspectors.get(&device.port)?.report();
            let serial = device.identity.serial.to_string();
            if serial.is_empty() || report.imu_samples + report.light() == 0 {
                return None;
            }
            Some(Row {
                capture: name(path),
                model: device.identity.model.to_owned(),
                light: report.stations.keys().map(ToString::to_string).collect(),
                sweeps: report.stations.values().map(|seen| seen.sweeps).sum(),
                stations: stations.map(name),
                measures: Measures::of(samples),
                reference: reference
                    .and_then(|reference| reference.compare(&serial, samples, origin)),
                serial,
            })
        };
        self.rig.devices().iter().filter_map(row).collect()
    }
}

/// For people.
fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:<34} {:<13} {:<18} {:<22} {:>7} {:>8} {:>8} {:>7} {:>14} {:>22}\n",
        "capture",
        "serial",
        "model",
        "light of",
        "sweeps",
        "tracked",
        "residual",
        "tilt",
        "noise at rest",
        "off libsurvive (p95)"
    );
    for row in rows {
        let Measures {
            tracked,
            residual_rms_rad,
            tilt_degrees,
            noise_m,
            noise_degrees,
            ..
        } = row.measures;
        let some = |value: Option<f64>, unit: f64, digits: usize| {
            value.map_or_else(
                || "-".to_owned(),
                |value| format!("{:.digits$}", unit * value),
            )
        };
        let noise = format!(
            "{} mm {}",
            some(noise_m, 1e3, 3),
            some(noise_degrees, 1.0, 3)
        );
        let off = row.reference.as_ref().map_or_else(String::new, |off| {
            format!(
                "{:.1} ({:.1}) mm {:.2} ({:.2})",
                1e3 * off.median_m,
                1e3 * off.p95_m,
                off.median_degrees,
                off.p95_degrees
            )
        });
        let _ = writeln!(
            text,
            "{:<34} {:<13} {:<18} {:<22} {:>7} {:>8} {:>8} {:>7} {:>14} {:>22}",
            shortened(&row.capture, 34),
            row.serial,
            shortened(&row.model, 18),
            row.light.join(", "),
            row.sweeps,
            some(tracked, 100.0, 1),
            some(residual_rms_rad, 1e6, 0),
            some(tilt_degrees, 1.0, 2),
            noise,
            off,
        );
    }
    text.push_str(
        "tracked: per cent of the time from 3 s after its first inertial sample on; residual: urad; \
         tilt, rotations: degrees\n",
    );
    text
}

/// For people: the base stations, where they were found by their light.
fn relations(all: &[Relation]) -> String {
    if all.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "\n{:<34} {:<24} {:>7} {:>19} {:>19} {:>7}\n",
        "capture", "base stations", "apart", "sigma", "off the file", "scale"
    );
    for one in all {
        let both = |metres: Option<f64>, degrees: Option<f64>| {
            metres
                .zip(degrees)
                .map_or_else(String::new, |(m, degrees)| {
                    format!("{:.1} mm {degrees:.3}", 1e3 * m)
                })
        };
        let _ = writeln!(
            text,
            "{:<34} {:<24} {:>5.2} m {:>19} {:>19} {:>7}",
            shortened(&one.capture, 34),
            one.stations.join(" from "),
            one.apart_m,
            both(one.sigma_m, one.sigma_degrees),
            both(one.off_m, one.off_degrees),
            one.file_scale
                .map_or_else(String::new, |scale| format!("{scale:.4}")),
        );
    }
    text
}

fn shortened(text: &str, length: usize) -> String {
    text.chars().take(length).collect()
}
