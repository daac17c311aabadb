//! Poses as lines of JSON.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use posed_signal::{Pose, Role, Serial};
use serde::Serialize;

/// One line of `--devices`: a device's tracking frame in the world.
#[derive(Debug, Serialize)]
struct DeviceLine<'a> {
    t_ns: u64,
    device: &'a str,
    role: &'static str,
    position: [f32; 3],
    rotation: [f32; 4],
    velocity: [f32; 3],
    angular_velocity: [f32; 3],
    residual_rad: f32,
    how: &'static str,
}

/// A file of JSON lines. After the first error (a full disk, say) nothing more is written, the
/// error is kept for the end, and whoever writes goes on.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    output: Option<BufWriter<File>>,
    error: Option<io::Error>,
    lines: u64,
}

impl JsonLines {
    /// Creates or replaces `path`.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        let output = Some(BufWriter::with_capacity(1 << 16, File::create(path)?));
        Ok(Self {
            path: path.to_path_buf(),
            output,
            error: None,
            lines: 0,
        })
    }

    /// Writes one line.
    pub fn line(&mut self, value: &impl Serialize) {
        let Some(output) = &mut self.output else {
            return;
        };
        let written = serde_json::to_writer(&mut *output, value)
            .map_err(io::Error::from)
            .and_then(|()| output.write_all(b"\n"));
        match written {
            Ok(()) => self.lines += 1,
            Err(error) => {
                self.output = None;
                self.error = Some(error);
            }
        }
    }

    /// Writes a device's pose.
    pub fn device(&mut self, serial: &Serial, role: Role, pose: &Pose) {
        self.line(&DeviceLine {
            t_ns: pose.at.0,
            device: serial.as_str(),
            role: role.name(),
            position: pose.position.to_array(),
            rotation: pose.rotation.to_array(),
            velocity: pose.velocity.to_array(),
            angular_velocity: pose.angular_velocity.to_array(),
            residual_rad: pose.residual_rad,
            how: pose.how.name(),
        });
    }

    /// Flushes, and says how many lines were written.
    ///
    /// # Errors
    /// The first error of any write, with the file's name.
    pub fn finish(mut self) -> io::Result<u64> {
        let flushed = self
            .output
            .take()
            .map_or(Ok(()), |mut output| output.flush());
        match self.error.map_or(flushed, Err) {
            Ok(()) => Ok(self.lines),
            Err(error) => {
                let (path, lines) = (self.path.display(), self.lines);
                let text = format!("{path}: {error}, after {lines} lines; the rest is lost");
                Err(io::Error::new(error.kind(), text))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;

    use super::*;

    #[test]
    fn lines_hold_what_they_should() {
        let path = std::env::temp_dir().join(format!("posed-jsonl-{}", std::process::id()));
        let mut lines = JsonLines::create(&path).unwrap();
        lines.device(
            &Serial::new("LHR-1"),
            Role::Head,
            &Pose::unknown(HostTime(7)),
        );
        assert_eq!(lines.finish().unwrap(), 1);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let line: serde_json::Value = serde_json::from_str(text.trim_end()).unwrap();
        assert_eq!((&line["t_ns"], &line["role"]), (&7.into(), &"head".into()));
        assert_eq!(
            (&line["how"], &line["device"]),
            (&"lost".into(), &"LHR-1".into())
        );
        assert_eq!(line["rotation"][3], 1.0);
    }

    #[test]
    fn a_full_disk_is_an_error_at_the_end_and_no_panic_before() {
        let full = Path::new("/dev/full");
        if !full.exists() {
            return;
        }
        let mut lines = JsonLines::create(full).unwrap();
        for _ in 0..2_000 {
            lines.line(&"x".repeat(100));
        }
        let error = lines.finish().unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: "), "{error}");
    }
}
