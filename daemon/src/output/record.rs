//! Recordings of the live pose into files, one at a time.
//!
//! A thread of its own reads the poses out of the hub's window of ten seconds, so that a slow disk
//! costs recorded poses at worst, and counts them. BVH and lines of JSON grow with every pose; glTF
//! is made of lines of JSON at the end, so that a killed process leaves a readable file in any
//! case.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
    thread,
    time::Duration,
};

use super::{
    bvh::Unit,
    export::{self, Export, ExportError},
    jsonl::JsonLines,
    motion::Frame,
    names::Names,
};
use crate::grpc::{Behind, Hub};

/// How often poses are fetched; the hub remembers many times that.
const FETCH_INTERVAL: Duration = Duration::from_millis(50);
/// Poses in one recording: an hour and a half at 90 Hz, 1.5 GB as lines of JSON.
const POSES_MAX: u64 = 500_000;
/// Characters in a recording's name.
const NAME_CHARS_MAX: usize = 64;
/// End of the names of files that hold poses as lines of JSON.
const LINES_ENDING: &str = "poses.jsonl";

/// The formats of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Poses as lines of JSON.
    Poses,
    /// For other programs.
    Motion(export::Format),
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 3] = [
        Self::Poses,
        Self::Motion(export::Format::Bvh),
        Self::Motion(export::Format::Glb),
    ];

    /// The word on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Poses => "poses",
            Self::Motion(format) => format.name(),
        }
    }

    /// The inverse of [`Format::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    fn ending(self) -> &'static str {
        match self {
            Self::Poses => LINES_ENDING,
            Self::Motion(format) => format.name(),
        }
    }
}

/// What somebody wants recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wish {
    /// In which format.
    pub format: Format,
    /// The file's name without folder and ending; empty for the time of day.
    pub name: String,
    /// What the joints are called; `None` for what programs expect of the format.
    pub names: Option<Names>,
}

/// A recording, under way or just ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
    /// Poses written.
    pub poses: u64,
    /// Poses that were fetched too late.
    pub lost: u64,
    /// Why nothing more is written.
    pub error: Option<String>,
}

/// Why a recording does not begin or end.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// One at a time.
    #[error("{0} is being recorded already: stop that first")]
    Busy(PathBuf),
    /// Nothing to stop.
    #[error("nothing is being recorded")]
    Idle,
    /// The name could lead out of the folder, or is none.
    #[error(
        "`{0}` cannot be a recording's name: give letters, digits, `-`, `_` and `.`, at most \
         {NAME_CHARS_MAX}, the first no `.`"
    )]
    Name(String),
    /// Nothing is replaced.
    #[error("{0} exists already: give another name")]
    Exists(PathBuf),
    /// There is no place for recordings.
    #[error("there is no folder for recordings: name one as recording.folder in the configuration")]
    NoFolder,
    /// The folder or the file.
    #[error("{path}: {source}")]
    File {
        /// Its name.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
    },
}

/// Records the poses of a hub. Clones share everything.
#[derive(Debug, Clone)]
pub struct Recorder {
    hub: Hub,
    folder: Option<PathBuf>,
    rate_hz: f64,
    running: Arc<Mutex<Option<Running>>>,
}

#[derive(Debug)]
struct Running {
    state: Arc<Mutex<Recording>>,
    stop: mpsc::Sender<()>,
    thread: thread::JoinHandle<()>,
}

/// States are whole after every change.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Recorder {
    /// Records into `folder`, which is made when it is needed; BVH with `rate_hz` frames a second.
    #[must_use]
    pub fn new(hub: Hub, folder: Option<PathBuf>, rate_hz: f64) -> Self {
        Self {
            hub,
            folder,
            rate_hz,
            running: Arc::default(),
        }
    }

    /// What is being recorded.
    #[must_use]
    pub fn recording(&self) -> Option<Recording> {
        lock(&self.running)
            .as_ref()
            .map(|running| lock(&running.state).clone())
    }

    /// Begins to record. May wait for the disk.
    ///
    /// # Errors
    /// Another recording goes on, or the file cannot be had.
    pub fn start(&self, wish: &Wish) -> Result<Recording, RecordError> {
        let mut running = lock(&self.running);
        if let Some(running) = &*running {
            return Err(RecordError::Busy(lock(&running.state).path.clone()));
        }
        let folder = self.folder.as_deref().ok_or(RecordError::NoFolder)?;
        let failed = |path: &Path, source| RecordError::File {
            path: path.into(),
            source,
        };
        fs::create_dir_all(folder).map_err(|source| failed(folder, source))?;
        let path = folder.join(file_name(wish)?);
        let writer = Writer::create(&path, wish, self.rate_hz)?;
        let recording = Recording {
            path: path.clone(),
            format: wish.format,
            poses: 0,
            lost: 0,
            error: None,
        };
        let state = Arc::new(Mutex::new(recording.clone()));
        let (stop, stopped) = mpsc::channel();
        let work = Work {
            hub: self.hub.clone(),
            // Sequence numbers begin at 1: before the first pose, one stands before it.
            after: Some(self.hub.newest().unwrap_or(0)),
            writer,
            state: Arc::clone(&state),
        };
        let thread = thread::Builder::new()
            .name("recorder".into())
            .spawn(move || work.run(&stopped))
            .map_err(|source| failed(&path, source))?;
        *running = Some(Running {
            state,
            stop,
            thread,
        });
        Ok(recording)
    }

    /// Ends the recording and completes its file: waits for the disk.
    ///
    /// # Errors
    /// Nothing is being recorded. What went wrong with the file is in the answer.
    pub fn stop(&self) -> Result<Recording, RecordError> {
        let running = lock(&self.running).take().ok_or(RecordError::Idle)?;
        // The thread may have ended already, at the last pose.
        let _ = running.stop.send(());
        let ended = running.thread.join();
        let mut recording = lock(&running.state).clone();
        if ended.is_err() && recording.error.is_none() {
            recording.error = Some("the recorder's thread failed; this is a bug".into());
        }
        Ok(recording)
    }
}

fn file_name(wish: &Wish) -> Result<String, RecordError> {
    let ending = wish.format.ending();
    if wish.name.is_empty() {
        let now = jiff::ZonedDateTime::now().strftime("%Y-%m-%d_%H-%M-%S");
        return Ok(format!("{now}.{ending}"));
    }
    let fits = |c: char| c.is_ascii_alphanumeric() || ['-', '_', '.'].contains(&c);
    let name = &wish.name;
    if name.len() > NAME_CHARS_MAX || name.starts_with('.') || !name.chars().all(fits) {
        return Err(RecordError::Name(name.clone()));
    }
    Ok(format!("{name}.{ending}"))
}

/// The recorder's thread.
struct Work {
    hub: Hub,
    after: Option<u64>,
    writer: Writer,
    state: Arc<Mutex<Recording>>,
}

impl Work {
    fn run(mut self, stop: &mpsc::Receiver<()>) {
        let mut changes = self.hub.changes();
        let ended = loop {
            let waited = stop.recv_timeout(FETCH_INTERVAL);
            // Asked before the last fetch, so that the last poses are not missed.
            let is_last =
                waited != Err(mpsc::RecvTimeoutError::Timeout) || changes.has_changed().is_err();
            changes.mark_unchanged();
            match self.fetch() {
                Ok(()) if !is_last => {}
                Ok(()) => break Ok(()),
                Err(text) => break Err(text),
            }
        };
        let finished = self.writer.finish();
        let error = ended.and(finished).err();
        if let Some(error) = &error {
            tracing::warn!("the recording ends: {error}");
        }
        lock(&self.state).error = error;
    }

    /// Writes the poses that came since the last time.
    fn fetch(&mut self) -> Result<(), String> {
        while let Some((pose, lost)) = self.hub.next(self.after, Behind::InOrder) {
            self.after = Some(pose.sequence);
            self.writer.pose(&pose).map_err(|error| error.to_string())?;
            let mut state = lock(&self.state);
            state.poses += 1;
            state.lost += lost;
            if state.poses == POSES_MAX {
                return Err(format!("it is full: {POSES_MAX} poses are the most"));
            }
        }
        Ok(())
    }
}

enum Writer {
    Lines(JsonLines),
    Motion(Box<Export>),
    /// Lines of JSON, of which glTF is made at the end.
    Glb {
        lines: JsonLines,
        lines_path: PathBuf,
        path: PathBuf,
        options: export::Options,
    },
}

impl Writer {
    fn create(path: &Path, wish: &Wish, rate_hz: f64) -> Result<Self, RecordError> {
        let lines = |path: &Path| {
            if path.exists() {
                return Err(RecordError::Exists(path.into()));
            }
            JsonLines::create(path).map_err(|source| RecordError::File {
                path: path.into(),
                source,
            })
        };
        let Format::Motion(format) = wish.format else {
            return Ok(Self::Lines(lines(path)?));
        };
        if path.exists() {
            return Err(RecordError::Exists(path.into()));
        }
        let options = export::Options {
            format,
            names: wish.names,
            unit: Unit::Centimetres,
            rate_hz,
        };
        if format == export::Format::Bvh {
            return Ok(Self::Motion(Box::new(Export::new(path, options))));
        }
        let lines_path = path.with_extension(format!("glb.{LINES_ENDING}"));
        Ok(Self::Glb {
            lines: lines(&lines_path)?,
            lines_path,
            path: path.into(),
            options,
        })
    }

    fn pose(&mut self, pose: &crate::published::PublishedPose) -> Result<(), ExportError> {
        match self {
            Self::Lines(lines) | Self::Glb { lines, .. } => {
                lines.line(pose);
                Ok(())
            }
            Self::Motion(export) => export.frame(&Frame::from(pose)),
        }
    }

    fn finish(self) -> Result<(), String> {
        let text = |error: &dyn std::error::Error| error.to_string();
        match self {
            Self::Lines(lines) => lines.finish().map(drop).map_err(|error| text(&error)),
            Self::Motion(export) => export.finish().map(drop).map_err(|error| text(&error)),
            Self::Glb {
                lines,
                lines_path,
                path,
                options,
            } => {
                lines.finish().map_err(|error| text(&error))?;
                let written = fs::File::open(&lines_path)
                    .map_err(|error| text(&error))
                    .and_then(|file| {
                        let lines = io::BufReader::new(file);
                        export::poses(lines, &path, options).map_err(|error| text(&error))
                    });
                let kept = |error| format!("{error}; the poses are in {}", lines_path.display());
                written.map_err(kept)?;
                fs::remove_file(&lines_path).map_err(|error| text(&error))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;

    use super::*;
    use crate::{output::motion::PoseLines, published::tests::pose_at};

    fn wish(format: Format, name: &str) -> Wish {
        Wish {
            format,
            name: name.into(),
            names: None,
        }
    }

    fn publish(sink: &mut crate::grpc::PoseSink, hub: &Hub, sequences: std::ops::Range<u64>) {
        for sequence in sequences {
            sink.publish(&pose_at(sequence, HostTime(sequence * 11_111_111)));
            while hub.newest() != Some(sequence) {
                thread::yield_now();
            }
        }
    }

    fn wait_for(recorder: &Recorder, poses: u64) {
        while recorder.recording().unwrap().poses < poses {
            thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn every_pose_between_start_and_stop_is_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let (mut sink, hub) = Hub::new().unwrap();
        let recorder = Recorder::new(hub.clone(), Some(folder.path().join("made")), 90.0);
        publish(&mut sink, &hub, 1..6);
        let mut next = 6;
        for format in Format::ALL {
            assert_eq!(Format::from_name(format.name()), Some(format));
            let begun = recorder.start(&wish(format, "walk")).unwrap();
            let error = recorder.start(&wish(format, "other")).unwrap_err();
            assert!(error.to_string().contains("walk"), "{error}");
            publish(&mut sink, &hub, next..next + 30);
            next += 30;
            let ended = recorder.stop().unwrap();
            assert_eq!((ended.poses, ended.lost, ended.error), (30, 0, None));
            assert_eq!(ended.path, begun.path);
            let size = fs::metadata(&ended.path).unwrap().len();
            assert!(size > 1_000, "{}: {size} bytes", ended.path.display());
            let again = recorder.start(&wish(format, "walk")).unwrap_err();
            assert!(again.to_string().contains("exists already"), "{again}");
        }
        assert!(matches!(recorder.stop(), Err(RecordError::Idle)));
        let files = fs::read_dir(folder.path().join("made")).unwrap().count();
        assert_eq!(files, 3, "nothing else is left");
    }

    #[test]
    fn the_file_of_a_glb_recording_can_be_read_before_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let (mut sink, hub) = Hub::new().unwrap();
        let recorder = Recorder::new(hub.clone(), Some(folder.path().into()), 90.0);
        let format = Format::Motion(export::Format::Glb);
        recorder.start(&wish(format, "")).unwrap();
        publish(&mut sink, &hub, 1..200);
        wait_for(&recorder, 199);
        // As a killed process leaves it.
        let left = fs::read_dir(folder.path())
            .unwrap()
            .next()
            .unwrap()
            .unwrap();
        let lines = io::BufReader::new(fs::File::open(left.path()).unwrap());
        let frames = PoseLines::new(lines).filter(Result::is_ok).count();
        assert!(frames > 150, "{frames} of 199 can be read");
        drop(sink);
        assert_eq!(recorder.stop().unwrap().error, None);
    }

    #[test]
    fn names_stay_in_the_folder() {
        let (_sink, hub) = Hub::new().unwrap();
        let recorder = Recorder::new(hub, None, 90.0);
        let error = recorder.start(&wish(Format::Poses, "a")).unwrap_err();
        assert!(error.to_string().contains("recording.folder"), "{error}");
        let long = "x".repeat(NAME_CHARS_MAX + 1);
        for name in ["../a", "a/b", ".a", "ü", "a b", "a\0", &long] {
            let refused = file_name(&wish(Format::Poses, name)).unwrap_err();
            assert!(matches!(refused, RecordError::Name(_)), "{name}");
        }
        let name = file_name(&wish(Format::Motion(export::Format::Bvh), "a-b_c.1")).unwrap();
        assert_eq!(name, "a-b_c.1.bvh");
        assert!(
            file_name(&wish(Format::Poses, ""))
                .unwrap()
                .starts_with("20")
        );
    }
}
