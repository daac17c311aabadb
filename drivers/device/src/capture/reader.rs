//! The streaming reader behind [`open`].

use std::io::Read;

use crate::usb::{Packet, Port, UsbId};

/// Why a capture cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// Nothing that is known begins like this.
    #[error("not a capture that posed can read: {what}")]
    Format {
        /// What was found instead.
        what: String,
    },
    /// The first bytes could not be read.
    #[error("the capture cannot be read: {0}")]
    Io(#[from] std::io::Error),
}

/// What is wrong with a capture that is read nevertheless.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Warning {
    /// The compressed stream is damaged; everything before was read.
    #[error("the gzip stream is corrupt after byte {at_byte}; everything before it was read")]
    Corrupt {
        /// Offset in the file as it lies there.
        at_byte: u64,
    },
    /// The file ends too early.
    #[error("the capture ends too early, after byte {at_byte}; everything before it was read")]
    CutOff {
        /// Offset in the file as it lies there.
        at_byte: u64,
    },
}

/// What a reader yields, in the order of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Item {
    /// A finished transfer with data.
    Packet(Packet),
    /// The capture itself says which device sits on a port; comes before that device's next packet.
    Device(Port, UsbId),
    /// Something is wrong with the capture; reading goes on if it can.
    Warning(Warning),
}

/// Counts of what has been read so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    /// Records of the file (usbmon counts a transfer's submission and its completion).
    pub records: u64,
    /// Packets made of them.
    pub packets: u64,
    /// Transfers that ended with an error status and without data.
    pub failed: u64,
    /// Records that say they hold more data than they do.
    pub shortened: u64,
    /// Records that are not of any known layout.
    pub malformed: u64,
}

/// Reads a capture as a stream; an iterator over [`Item`]s.
pub struct CaptureReader<'a> {
    input: Box<dyn Read + Send + 'a>,
    statistics: Statistics,
}

/// Opens a capture; the format is told by its first bytes.
///
/// # Errors
/// The bytes are of no known format, or cannot be read at all.
pub fn open<'a>(input: impl Read + Send + 'a) -> Result<CaptureReader<'a>, CaptureError> {
    Ok(CaptureReader {
        input: Box::new(input),
        statistics: Statistics::default(),
    })
}

impl CaptureReader<'_> {
    /// Counts so far.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }
}

impl Iterator for CaptureReader<'_> {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        let _ = &mut self.input;
        None
    }
}
