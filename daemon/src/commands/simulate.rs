//! `posed simulate`.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::Path,
};

use glam::{DQuat, DVec3};
use indicatif::ProgressBar;
use posed_device::{
    capture::{HidRecorderWriter, UsbmonOptions, UsbmonWriter, identity},
    simulate::{
        Absence, Move, Options, SimulateError, Simulator, default_stations, four_stations,
        generation_one_stations, slimevr, write_libsurvive,
    },
    usb::{Packet, Port},
};

use super::CommandError;
use crate::{
    cli::{CaptureFormat, Room, RoomArgs, SimulateArgs},
    output::jsonl::JsonLines,
    postures, simulated,
};

/// Truth is written this often: at the rate of poses.
const TRUTH_STEP_NS: u64 = 1_000_000_000 / 90;
/// Where the trackers' receiver is plugged in.
const RECEIVER_PORT: Port = Port {
    bus: 1,
    address: 20,
};

/// Writes the capture, the true poses and the base stations.
///
/// # Errors
/// The motion cannot be read, or an output cannot be written.
pub fn run(args: &SimulateArgs) -> Result<(), CommandError> {
    let clip = match (&args.motion, &args.clip) {
        (Some(path), Some(name)) => clip(path, name)?,
        _ => simulated::built_in(args.height, args.seed),
    };
    let clip = if args.calibration {
        postures::before(&clip)
    } else {
        clip
    };
    let person = simulated::Person::new(&clip);
    let mut options = person.options(args.seed, args.seconds);
    furnish(&mut options, &args.room)?;
    let (seconds, start) = (options.duration_s, options.start);
    let bad = |error: SimulateError| CommandError::Input(error.to_string());
    let receiver = args
        .trackers
        .as_ref()
        .map(|roles| {
            let options = slimevr::Options {
                seed: args.seed,
                start,
                duration_s: seconds,
                loss: args.loss,
                ..slimevr::Options::default()
            };
            let trackers = person.trackers(&roles.0, args.seed);
            slimevr::Receiver::new(options, RECEIVER_PORT, trackers)
        })
        .transpose()
        .map_err(bad)?;
    let devices = if args.no_headset {
        Vec::new()
    } else {
        person.devices()
    };
    let simulator = Simulator::new(options, devices).map_err(bad)?;
    if let Some(path) = &args.base_stations {
        let text = write_libsurvive(simulator.stations());
        std::fs::write(path, text).map_err(|error| CommandError::file(path, error))?;
    }
    if let Some(path) = &args.truth {
        let mut lines = JsonLines::create(path).map_err(|error| CommandError::file(path, error))?;
        for truth in simulator.truth(TRUTH_STEP_NS) {
            lines.line(&truth);
        }
        if let Some(receiver) = &receiver {
            receiver
                .truth(TRUTH_STEP_NS)
                .for_each(|truth| lines.line(&truth));
        }
        for truth in person.truth(TRUTH_STEP_NS, start, seconds) {
            lines.line(&truth);
        }
        lines.finish()?;
    }
    let simulator = (!args.no_headset).then_some(simulator);
    let packets = merged(
        simulator.into_iter().flatten(),
        receiver.into_iter().flatten(),
    );
    write(args, packets, seconds)
}

/// Puts a room around the wearer, with what goes wrong in it.
fn furnish(options: &mut Options, args: &RoomArgs) -> Result<(), CommandError> {
    options.stations = match args.room {
        Room::One => default_stations().drain(..1).collect(),
        Room::Two => default_stations(),
        Room::Four => four_stations(),
        Room::FirstGeneration => generation_one_stations(),
    };
    if args.no_occlusion {
        options.occluders.clear();
    }
    options.light.reflection = args.reflections;
    options.dark = args.dark.iter().map(|span| span.0).collect();
    options.usb.drift_ppm = args.drift;
    options.usb.radio_loss = args.radio_loss;
    let second = options.stations.get(1).copied();
    let needed = || CommandError::Input("that takes a room with more than one base station".into());
    if let Some(at_s) = args.move_station {
        let second = second.ok_or_else(needed)?;
        options.moves.push(Move {
            at_s,
            source: second.source,
            position: second.position + DVec3::new(-0.3, 0.0, 0.0),
            rotation: DQuat::from_rotation_y(0.1) * second.rotation,
        });
    }
    if let Some(seconds) = args.late_station {
        options.absences.push(Absence {
            source: second.ok_or_else(needed)?.source,
            span: [0.0, seconds],
        });
    }
    if args.share_channel {
        second.ok_or_else(needed)?;
        let first = options.stations[0].source;
        if let Some(last) = options.stations.last_mut() {
            last.source = first;
        }
    }
    Ok(())
}

/// Both streams in the order of time.
fn merged(
    first: impl Iterator<Item = Packet>,
    second: impl Iterator<Item = Packet>,
) -> impl Iterator<Item = Packet> {
    let (mut first, mut second) = (first.peekable(), second.peekable());
    std::iter::from_fn(move || match (first.peek(), second.peek()) {
        (Some(a), Some(b)) if b.at < a.at => second.next(),
        (Some(_), _) => first.next(),
        (None, _) => second.next(),
    })
}

fn clip(path: &Path, name: &str) -> Result<posed_body::motion::Clip, CommandError> {
    let bytes = std::fs::read(path).map_err(|error| CommandError::file(path, error))?;
    simulated::from_file(&bytes, name)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}

/// Either kind of capture file.
enum Capture {
    Usbmon(UsbmonWriter<BufWriter<File>>),
    Text(HidRecorderWriter<BufWriter<File>>),
}

impl Capture {
    fn create(args: &SimulateArgs) -> std::io::Result<Self> {
        let output = BufWriter::with_capacity(1 << 16, File::create(&args.out)?);
        if args.format == CaptureFormat::HidRecorder {
            return Ok(Self::Text(HidRecorderWriter::new(output)));
        }
        let options = UsbmonOptions {
            gzip: args.out.extension().is_some_and(|name| name == "gz"),
            ..UsbmonOptions::default()
        };
        Ok(Self::Usbmon(UsbmonWriter::new(output, options)?))
    }

    fn packet(&mut self, packet: &Packet) -> std::io::Result<()> {
        match self {
            Self::Usbmon(writer) => writer.packet(packet),
            Self::Text(writer) => {
                if let Some(id) = identity::device_descriptor(packet) {
                    writer.device(packet.port, id);
                }
                writer.packet(packet)
            }
        }
    }

    fn finish(self) -> std::io::Result<()> {
        match self {
            Self::Usbmon(writer) => writer.finish()?.flush(),
            Self::Text(writer) => writer.finish()?.flush(),
        }
    }
}

fn write(
    args: &SimulateArgs,
    packets: impl Iterator<Item = Packet>,
    seconds: f64,
) -> Result<(), CommandError> {
    let fail = |error| CommandError::file(&args.out, error);
    let mut capture = Capture::create(args).map_err(fail)?;
    let progress = ProgressBar::new((seconds * 1e3) as u64);
    let mut start = None;
    let mut count = 0u64;
    for packet in packets {
        let start = *start.get_or_insert(packet.at);
        progress.set_position((packet.at.since_secs(start) * 1e3) as u64);
        capture.packet(&packet).map_err(fail)?;
        count += 1;
    }
    progress.finish_and_clear();
    capture.finish().map_err(fail)?;
    println!("{}: {seconds:.1} s, {count} packets", args.out.display());
    Ok(())
}
