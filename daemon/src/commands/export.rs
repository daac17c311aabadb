//! `posed export`: a capture, or poses written before, into a file for other programs.

use std::{
    fs::File,
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
};

use posed_device::transport::{Merge, Replay};
use posed_signal::{DeviceId, HostTime, Sample};

use super::{CommandError, replay::recording, settings};
use crate::{
    assemble::{Assembly, assemble},
    cli::ExportArgs,
    output::{
        export::{self, Export, ExportError, Format, Summary},
        motion::Frame,
    },
    pipeline::{
        replay::{Watcher, replay},
        source::Source,
    },
    published::PublishedPose,
};

/// Writes the file, and says what it holds.
///
/// # Errors
/// The input cannot be read, holds no pose, or the file cannot be written.
pub fn run(args: &ExportArgs) -> Result<(), CommandError> {
    let config = settings::configuration(&args.body)?;
    let options = export::Options {
        format: args.format,
        names: args.names,
        unit: args.unit,
        rate_hz: config.tracker.rate_hz,
    };
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| beside(&args.file, args.format));
    let failed = |error: ExportError| CommandError::Input(error.to_string());
    let written = match poses(&args.file)? {
        Some(lines) => {
            let told = |error| CommandError::Input(format!("{}: {error}", args.file.display()));
            export::poses(lines, &out, options).map_err(told)?
        }
        None => capture(args, &out, options)?.map_err(failed)?,
    };
    println!("{}: {} frames", out.display(), written.frames);
    if written.other_wearer > 0 {
        eprintln!(
            "warning: {} frames are of a wearer of another size; the bones are the first one's",
            written.other_wearer
        );
    }
    Ok(())
}

/// `walk.pcap.gz` becomes `walk.bvh`.
fn beside(file: &Path, format: Format) -> PathBuf {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.split('.').next().filter(|stem| !stem.is_empty());
    file.with_file_name(format!("{}.{}", stem.unwrap_or("motion"), format.name()))
}

/// The file's lines, if it holds poses as lines of JSON: no capture begins so.
fn poses(path: &Path) -> Result<Option<BufReader<File>>, CommandError> {
    let told = |error| CommandError::file(path, error);
    let mut lines = BufReader::new(File::open(path).map_err(told)?);
    let begins = lines.fill_buf().map_err(told)?.starts_with(b"{\"");
    Ok(begins.then_some(lines))
}

/// Tracks a capture as fast as possible.
fn capture(
    args: &ExportArgs,
    out: &Path,
    options: export::Options,
) -> Result<Result<Summary, ExportError>, CommandError> {
    let config = settings::configuration(&args.body)?;
    let parts = settings::options(&config)?;
    let transport = Replay::new(vec![recording(&args.file)?], Merge::OneSession);
    let Assembly {
        mut source,
        mut tracker,
        requests: _requests,
    } = assemble(Box::new(transport), parts);
    let mut writing = Writing {
        export: Export::new(out, options),
        error: None,
    };
    replay(
        &mut source,
        &mut tracker,
        config.tracker.rate_hz,
        &mut writing,
    );
    Ok(match writing.error {
        Some(error) => Err(error),
        None => writing.export.finish(),
    })
}

struct Writing {
    export: Export,
    error: Option<ExportError>,
}

impl Watcher for Writing {
    fn pace(&mut self, _: HostTime) -> bool {
        self.error.is_none()
    }

    fn sample(&mut self, _: DeviceId, _: &Sample) {}

    fn pose(&mut self, pose: &PublishedPose, _: &Source) {
        // Before the headset is seen there is nothing that moves.
        if pose.has_input() && self.error.is_none() {
            self.error = self.export.frame(&Frame::from(pose)).err();
        }
    }

    fn warning(&mut self, text: &str) {
        eprintln!("warning: {text}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_lies_beside_its_input() {
        let beside = |file| beside(Path::new(file), Format::Bvh);
        assert_eq!(beside("/a/walk.pcap.gz"), Path::new("/a/walk.bvh"));
        assert_eq!(beside("walk.poses.jsonl"), Path::new("walk.bvh"));
        assert_eq!(beside(".jsonl"), Path::new("motion.bvh"));
    }
}
