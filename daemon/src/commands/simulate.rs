//! `posed simulate`.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::Path,
};

use indicatif::ProgressBar;
use posed_device::{
    capture::{UsbmonOptions, UsbmonWriter},
    simulate::{Simulator, write_libsurvive},
};

use super::CommandError;
use crate::{cli::SimulateArgs, output::jsonl::JsonLines, simulated};

/// Truth is written this often: at the rate of poses.
const TRUTH_STEP_NS: u64 = 1_000_000_000 / 90;

/// Writes the capture, the true poses and the base stations.
///
/// # Errors
/// The motion cannot be read, or an output cannot be written.
pub fn run(args: &SimulateArgs) -> Result<(), CommandError> {
    let clip = match (&args.motion, &args.clip) {
        (Some(path), Some(name)) => clip(path, name)?,
        _ => simulated::built_in(args.height, args.seed),
    };
    let person = simulated::Person::new(&clip);
    let options = person.options(args.seed, args.seconds);
    let (seconds, start) = (options.duration_s, options.start);
    let simulator = Simulator::new(options, person.devices())
        .map_err(|error| CommandError::Input(error.to_string()))?;
    if let Some(path) = &args.base_stations {
        let text = write_libsurvive(simulator.stations());
        std::fs::write(path, text).map_err(|error| CommandError::file(path, error))?;
    }
    if let Some(path) = &args.truth {
        let mut lines = JsonLines::create(path).map_err(|error| CommandError::file(path, error))?;
        for truth in simulator.truth(TRUTH_STEP_NS) {
            lines.line(&truth);
        }
        for truth in person.truth(TRUTH_STEP_NS, start, seconds) {
            lines.line(&truth);
        }
        lines.finish()?;
    }
    write(&args.out, simulator, seconds)
}

fn clip(path: &Path, name: &str) -> Result<posed_body::motion::Clip, CommandError> {
    let bytes = std::fs::read(path).map_err(|error| CommandError::file(path, error))?;
    simulated::from_file(&bytes, name)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}

fn write(path: &Path, simulator: Simulator, seconds: f64) -> Result<(), CommandError> {
    let fail = |error| CommandError::file(path, error);
    let output = BufWriter::with_capacity(1 << 16, File::create(path).map_err(fail)?);
    let gzip = path.extension().is_some_and(|extension| extension == "gz");
    let options = UsbmonOptions {
        gzip,
        ..UsbmonOptions::default()
    };
    let mut writer = UsbmonWriter::new(output, options).map_err(fail)?;
    let progress = ProgressBar::new((seconds * 1e3) as u64);
    let mut start = None;
    let mut packets = 0u64;
    for packet in simulator {
        let start = *start.get_or_insert(packet.at);
        progress.set_position((packet.at.since_secs(start) * 1e3) as u64);
        writer.packet(&packet).map_err(fail)?;
        packets += 1;
    }
    progress.finish_and_clear();
    let mut output = writer.finish().map_err(fail)?;
    output.flush().map_err(fail)?;
    println!("{}: {seconds:.1} s, {packets} packets", path.display());
    Ok(())
}
