//! A motion into a file for other programs.

use std::{
    fs,
    io::{self, BufRead, Write as _},
    path::{Path, PathBuf},
};

use posed_body::{JOINTS, Skeleton};

use super::{
    bvh::{self, Bvh, Unit},
    gltf::{self, GlbError},
    motion::{Frame, PoseLines, PosesError},
    names::Names,
};

/// Bones that differ by more than this, metres, are another person's.
const SAME_BONE: f32 = 1e-3;

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Biovision hierarchy: text; the file grows as poses come.
    Bvh,
    /// glTF, binary, with VRM's bones: the file is written at the end.
    Glb,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 2] = [Self::Bvh, Self::Glb];

    /// The word on the command line, and the end of a file's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::Glb => "glb",
        }
    }

    /// The inverse of [`Format::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }
}

/// How to write.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// In which format.
    pub format: Format,
    /// What the joints are called; `None` for what programs expect of the format.
    pub names: Option<Names>,
    /// The unit of BVH; glTF has metres.
    pub unit: Unit,
    /// Frames a second of BVH; glTF keeps the poses' own times.
    pub rate_hz: f64,
}

/// Why a motion could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The file.
    #[error("{path}: {source}")]
    File {
        /// Its name.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
    },
    /// The motion.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// The poses that the motion is made of.
    #[error(transparent)]
    Poses(#[from] PosesError),
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Summary {
    /// Frames.
    pub frames: u64,
    /// Poses of a wearer of another size than the first pose's. The file has the first one's bones,
    /// so that in these the joints are not where they were.
    pub other_wearer: u64,
}

/// A file being written.
#[derive(Debug)]
pub struct Export {
    path: PathBuf,
    options: Options,
    skeleton: Option<Skeleton>,
    writer: Writer,
    other_wearer: u64,
}

#[derive(Debug)]
enum Writer {
    Bvh(Option<Box<Bvh<fs::File>>>),
    Glb(Vec<Frame>),
}

impl Export {
    /// Writes to `path`, which is created with the first frame.
    #[must_use]
    pub fn new(path: &Path, options: Options) -> Self {
        let writer = match options.format {
            Format::Bvh => Writer::Bvh(None),
            Format::Glb => Writer::Glb(Vec::new()),
        };
        Self {
            path: path.into(),
            options,
            skeleton: None,
            writer,
            other_wearer: 0,
        }
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn frame(&mut self, frame: &Frame) -> Result<(), ExportError> {
        let skeleton = *self.skeleton.get_or_insert(frame.skeleton);
        self.other_wearer += u64::from(!is_same(&skeleton, &frame.skeleton));
        let written = match &mut self.writer {
            Writer::Glb(frames) => {
                frames.push(*frame);
                Ok(())
            }
            Writer::Bvh(Some(bvh)) => bvh.frame(frame),
            Writer::Bvh(bvh) => {
                let options = bvh::Options {
                    names: self.options.names.unwrap_or(Names::Mixamo),
                    unit: self.options.unit,
                    rate_hz: self.options.rate_hz,
                };
                Bvh::create(&self.path, &skeleton, options)
                    .and_then(|created| bvh.insert(Box::new(created)).frame(frame))
            }
        };
        written.map_err(|source| self.failed(source))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// There was no frame, or the file cannot be written.
    pub fn finish(mut self) -> Result<Summary, ExportError> {
        let writer = std::mem::replace(&mut self.writer, Writer::Bvh(None));
        let frames = match writer {
            Writer::Bvh(None) => return Err(GlbError::Empty.into()),
            Writer::Bvh(Some(bvh)) => bvh.finish().map_err(|source| self.failed(source))?,
            Writer::Glb(frames) => {
                let names = self.options.names.unwrap_or(Names::Vrm);
                let bytes = gltf::glb(&frames, names)?;
                replace(&self.path, &bytes).map_err(|source| self.failed(source))?;
                frames.len() as u64
            }
        };
        Ok(Summary {
            frames,
            other_wearer: self.other_wearer,
        })
    }

    fn failed(&self, source: io::Error) -> ExportError {
        ExportError::File {
            path: self.path.clone(),
            source,
        }
    }
}

/// Writes the poses of `lines`, as `--poses` wrote them, to `path`.
///
/// # Errors
/// A line is no pose, or the file cannot be written.
pub fn poses(lines: impl BufRead, path: &Path, options: Options) -> Result<Summary, ExportError> {
    let mut export = Export::new(path, options);
    for frame in PoseLines::new(lines) {
        export.frame(&frame?)?;
    }
    export.finish()
}

fn is_same(one: &Skeleton, other: &Skeleton) -> bool {
    (0..JOINTS).all(|joint| one.offsets[joint].distance(other.offsets[joint]) < SAME_BONE)
}

/// Puts a whole file in place at once: whoever looks finds the old one or the new one. What is no
/// file (a pipe, a device) is written to, not replaced.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        return fs::File::options().write(true).open(path)?.write_all(bytes);
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = fs::File::create(&part)
        .and_then(|mut file| file.write_all(bytes))
        .and_then(|()| fs::rename(&part, path));
    if written.is_err() {
        let _ = fs::remove_file(&part);
    }
    written
}

#[cfg(test)]
mod tests {
    use posed_signal::{HostTime, time::SECOND_NS};

    use super::*;
    use crate::{output::motion::tests::frames, published::tests::pose_at};

    fn options(format: Format) -> Options {
        Options {
            format,
            names: None,
            unit: Unit::Centimetres,
            rate_hz: 90.0,
        }
    }

    #[test]
    fn what_is_no_file_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        let reader = {
            let pipe = pipe.clone();
            std::thread::spawn(move || fs::read(pipe))
        };
        replace(&pipe, b"motion").unwrap();
        assert_eq!(reader.join().unwrap().unwrap(), b"motion");
        assert!(!fs::metadata(&pipe).unwrap().is_file());
    }

    #[test]
    fn both_formats_are_written_with_the_names_that_programs_expect() {
        let folder = tempfile::tempdir().unwrap();
        for (format, name) in [(Format::Bvh, "LeftUpLeg"), (Format::Glb, "leftUpperLeg")] {
            assert_eq!(Format::from_name(format.name()), Some(format));
            let path = folder.path().join("motion").with_extension(format.name());
            let mut export = Export::new(&path, options(format));
            for frame in frames(30) {
                export.frame(&frame).unwrap();
            }
            assert_eq!(
                export.finish().unwrap(),
                Summary {
                    frames: 30,
                    other_wearer: 0
                }
            );
            let bytes = fs::read(&path).unwrap();
            assert!(
                bytes
                    .windows(name.len())
                    .any(|window| window == name.as_bytes()),
                "{name}"
            );
        }
        assert_eq!(
            fs::read_dir(folder.path()).unwrap().count(),
            2,
            "nothing else is left"
        );
    }

    #[test]
    fn another_wearer_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut export = Export::new(&folder.path().join("m.glb"), options(Format::Glb));
        let mut frames = frames(5);
        frames[3].skeleton = Skeleton::of_height(1.6);
        for frame in &frames {
            export.frame(frame).unwrap();
        }
        assert_eq!(export.finish().unwrap().other_wearer, 1);
    }

    #[test]
    fn lines_of_poses_become_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.bvh");
        let line = |sequence: u64| {
            let at = HostTime(sequence * SECOND_NS / 90);
            serde_json::to_string(&pose_at(sequence, at)).unwrap() + "\n"
        };
        let mut text: String = (1..=10).map(line).collect();
        let written = poses(text.as_bytes(), &path, options(Format::Bvh)).unwrap();
        assert_eq!(written.frames, 10);
        text.insert(0, '?');
        let error = poses(text.as_bytes(), &path, options(Format::Bvh))
            .unwrap_err()
            .to_string();
        assert!(error.contains("line 1"), "{error}");
    }

    #[test]
    fn nothing_to_write_and_nowhere_to_write_are_errors() {
        for format in Format::ALL {
            let path = Path::new("/nonexistent/m");
            let error = Export::new(path, options(format)).finish().unwrap_err();
            assert!(error.to_string().contains("no pose"), "{error}");
            let mut export = Export::new(path, options(format));
            let written = export.frame(&frames(1)[0]).and_then(|()| export.finish());
            let error = written.unwrap_err().to_string();
            assert!(error.starts_with("/nonexistent/m: "), "{error}");
        }
    }
}
