//! Where the room is kept between starts: `posed/room.json` in the state directory (XDG Base
//! Directory Specification 0.8), written whole or not at all.

use std::{
    fs,
    io::{self, Write as _},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    time::SystemTime,
};

use posed_device::lighthouse::room::{Handle, Stored, StoredError};
use posed_signal::HostTime;

use crate::config::files;

/// The room is written this long after it last changed, s: it changes often while it is measured.
const SETTLED_S: f64 = 2.0;
/// While it keeps changing it is written this often, s.
const PATIENCE_S: f64 = 20.0;

/// Why a room cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum RoomError {
    /// The file system refused.
    #[error("{path}: {error}")]
    File {
        /// Which file or folder.
        path: String,
        /// What went wrong.
        error: io::Error,
    },
    /// The file holds something else.
    #[error("{path}: {error}; the room is measured anew")]
    Content {
        /// Which file.
        path: String,
        /// What is wrong with it.
        error: StoredError,
    },
}

fn file_error(path: &Path) -> impl FnOnce(io::Error) -> RoomError + '_ {
    move |error| RoomError::File {
        path: path.display().to_string(),
        error,
    }
}

/// The user's room.
#[must_use]
pub fn path() -> Option<PathBuf> {
    Some(files::state_dir()?.join("room.json"))
}

/// Reads a kept room; `None` where there is none yet.
///
/// # Errors
/// The file cannot be read, or is not one.
pub fn load(path: &Path) -> Result<Option<Stored>, RoomError> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(file_error(path)(error)),
    };
    let stored = Stored::from_json(&text).map_err(|error| RoomError::Content {
        path: path.display().to_string(),
        error,
    })?;
    Ok(Some(stored))
}

/// Keeps a room: a reader sees the old file or the new one, whatever happens meanwhile.
///
/// # Errors
/// The file system refuses.
pub fn save(path: &Path, stored: &Stored) -> Result<(), RoomError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(file_error(folder))?;
    let text = stored.to_json().map_err(|error| RoomError::Content {
        path: path.display().to_string(),
        error,
    })?;
    let written = || -> io::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        file.write_all(text.as_bytes())?;
        file.as_file().sync_all()?;
        file.persist(path).map_err(|failed| failed.error)?;
        Ok(())
    };
    written().map_err(file_error(path))
}

/// Watches a room and keeps it when it has settled.
#[derive(Debug)]
pub struct Keeper {
    room: Handle,
    path: PathBuf,
    kept: u64,
    /// Revision seen last, since when, and since when the file has been out of date.
    seen: (u64, HostTime),
    stale: Option<HostTime>,
    /// When the file was written last, as the file system says.
    written: Option<(SystemTime, u64)>,
}

impl Keeper {
    /// Keeps `room` in `path`.
    #[must_use]
    pub fn new(room: Handle, path: PathBuf) -> Self {
        let revision = room.with(|room| room.revision());
        let written = written(&path);
        Self {
            written,
            room,
            path,
            kept: revision,
            seen: (revision, HostTime(0)),
            stale: None,
        }
    }

    /// To be called now and then with the present time.
    ///
    /// # Errors
    /// The file cannot be written; it is tried again when the room changes again.
    pub fn look(&mut self, now: HostTime) -> Result<(), RoomError> {
        self.take_over()?;
        let revision = self.room.with(|room| room.revision());
        if revision != self.seen.0 {
            self.seen = (revision, now);
        }
        if revision == self.kept {
            return Ok(());
        }
        let stale = *self.stale.get_or_insert(now);
        if now.since_secs(self.seen.1) < SETTLED_S && now.since_secs(stale) < PATIENCE_S {
            return Ok(());
        }
        self.keep()
    }

    /// Writes the file now, if the room has changed.
    ///
    /// # Errors
    /// As [`Keeper::look`].
    pub fn keep(&mut self) -> Result<(), RoomError> {
        let (revision, stored) = self.room.with(|room| (room.revision(), room.to_store()));
        if revision == self.kept {
            return Ok(());
        }
        (self.kept, self.stale) = (revision, None);
        if stored.is_empty() {
            return Ok(());
        }
        save(&self.path, &stored)?;
        self.written = written(&self.path);
        Ok(())
    }

    /// Takes over what another posed wrote, as the set-up command does.
    fn take_over(&mut self) -> Result<(), RoomError> {
        let written = written(&self.path);
        if written == self.written {
            return Ok(());
        }
        self.written = written;
        if let Some(stored) = load(&self.path)? {
            self.kept = self.room.with(|room| {
                room.adopt(&stored);
                room.revision()
            });
        }
        Ok(())
    }
}

/// When a file was written last, and which one it is.
fn written(path: &Path) -> Option<(SystemTime, u64)> {
    let metadata = fs::metadata(path).ok()?;
    Some((metadata.modified().ok()?, metadata.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: &str = r#"{"version": 1, "floor": "setup", "stations": [{"channel": 6, "id": 7,
        "position": [1.0, 2.0, 3.0], "rotation": [0.0, 0.0, 0.0, 1.0], "heard": true, "planes": [
        {"phase": 0.0, "tilt": -0.05, "curve": 0.1, "gibphase": 1.0, "gibmag": -0.004,
         "ogeephase": 1.0, "ogeemag": 0.2},
        {"phase": 0.0, "tilt": 0.05, "curve": 0.1, "gibphase": 1.0, "gibmag": -0.004,
         "ogeephase": 1.0, "ogeemag": 0.2}]}]}"#;

    fn room(stored: &Stored) -> Handle {
        let handle = Handle::default();
        handle.with(|room| room.adopt(stored));
        handle
    }

    fn room_height(stored: &Stored) -> f64 {
        room(stored).with(|room| room.stations().next().unwrap().position.y)
    }

    #[test]
    fn a_room_is_read_back_as_it_was_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("posed/room.json");
        assert!(load(&path).unwrap().is_none(), "nobody has to have one");
        let stored = Stored::from_json(ROOM).unwrap();
        save(&path, &stored).unwrap();
        save(&path, &stored).unwrap();
        let read = load(&path).unwrap().unwrap();
        assert_eq!(read, stored);
        let room = room(&read);
        assert_eq!(room.with(|room| room.to_store()), stored);
        let files = fs::read_dir(path.parent().unwrap()).unwrap().count();
        assert_eq!(files, 1, "nothing is left beside it");
    }

    #[test]
    fn what_is_no_room_is_named_and_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.json");
        for (from, to) in [
            ("\"version\": 1", "\"version\": 9"),
            ("\"channel\": 6", "\"channel\": 66"),
            ("[1.0, 2.0, 3.0]", "[1.0, 2.0, 3e9]"),
            ("0.0, 1.0]", "0.0, 9.0]"),
            ("\"stations\"", "\"planets\""),
            ("}]}]}", ""),
        ] {
            fs::write(&path, ROOM.replacen(from, to, 1)).unwrap();
            let error = load(&path).unwrap_err().to_string();
            assert!(error.contains("room.json"), "{from}: {error}");
        }
    }

    #[test]
    fn a_room_is_kept_once_it_has_settled() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.json");
        let room = room(&Stored::from_json(ROOM).unwrap());
        let mut keeper = Keeper::new(room.clone(), path.clone());
        let at = |seconds| HostTime::from_secs_f64(seconds);
        keeper.look(at(1.0)).unwrap();
        room.with(|room| room.set_floor(0.1));
        keeper.look(at(2.0)).unwrap();
        assert!(!path.exists(), "it may change again");
        keeper.look(at(4.5)).unwrap();
        let kept = room_height(&load(&path).unwrap().unwrap());
        assert!((kept - 1.9).abs() < 1e-12);
        // Another posed, as `posed setup` is one, changes the file.
        save(&path, &Stored::from_json(ROOM).unwrap()).unwrap();
        keeper.look(at(6.0)).unwrap();
        assert!((room_height(&room.with(|room| room.to_store())) - 2.0).abs() < 1e-12);
    }
}
