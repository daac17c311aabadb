//! What is wrong with a capture, and what was counted in it.

use std::io;

/// Why a capture cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// There is nothing in it.
    #[error("the capture is empty")]
    Empty,
    /// Nothing that is known begins like this.
    #[error(
        "no capture format begins with the bytes {first}; posed reads pcap and pcapng files with \
         usbmon or USBPcap records, hid-recorder text and traces of joy, each also gzip'd"
    )]
    Unknown {
        /// The first bytes, in hexadecimal.
        first: String,
    },
    /// The file ends inside its own header.
    #[error("the capture ends inside its header")]
    HeaderCutOff,
    /// A pcap file of something else than USB.
    #[error(
        "link type {link} is not USB traffic that posed reads; capture with usbmon (link type 189 \
         or 220, little-endian) or USBPcap (249)"
    )]
    LinkType {
        /// The file's `LINKTYPE_` number.
        link: i32,
    },
    /// The first bytes could not be read.
    #[error("the capture cannot be read: {0}")]
    Io(#[from] io::Error),
}

/// What is wrong with a capture that is read nevertheless. Each kind is reported once a capture;
/// [`Statistics`] counts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Warning {
    /// The compressed stream is damaged.
    #[error("the gzip stream is corrupt at byte {at_byte}; only what lies before it was read")]
    Corrupt {
        /// Offset in the file as it lies there.
        at_byte: u64,
    },
    /// The file ends inside a record or inside its compressed stream.
    #[error("the capture is cut off after {at_byte} bytes; everything before was read")]
    CutOff {
        /// Offset in the file as it lies there.
        at_byte: u64,
    },
    /// The compressed stream is whole, but something else follows it.
    #[error("what follows the gzip stream from byte {at_byte} on is not part of it; it is ignored")]
    TrailingBytes {
        /// Offset in the file as it lies there.
        at_byte: u64,
    },
    /// The operating system would not read on.
    #[error("reading failed at byte {at_byte}: {kind}; only what lies before it was read")]
    Unreadable {
        /// Offset in the file as it lies there.
        at_byte: u64,
        /// What the operating system said.
        kind: io::ErrorKind,
    },
    /// A record claims an absurd length, behind which nothing can be found again.
    #[error(
        "record {record} claims to be longer than {} bytes; reading ends there",
        super::RECORD_BYTES_MAX
    )]
    RecordTooLong {
        /// Records before it.
        record: u64,
    },
    /// A block of the file makes no sense.
    #[error("what follows record {record} is not a block of a capture; reading ends there")]
    Damaged {
        /// Records before it.
        record: u64,
    },
    /// A pcapng interface is of another link type; its records are skipped.
    #[error("an interface has link type {link}, which is not USB traffic; it is skipped")]
    LinkType {
        /// Its `LINKTYPE_` number.
        link: i32,
    },
    /// A pcapng record names an interface that was not described.
    #[error("a record belongs to no interface that the capture describes; such are skipped")]
    NoInterface,
    /// Records hold less data than they say.
    #[error("records hold less data than was transferred (snapshot length too small?)")]
    Shortened,
    /// Records have link type 220's header in a file of link type 189.
    #[error(
        "the file says link type 189 but its records have link type 220's header; the last 16 \
         bytes of each report are missing from it"
    )]
    WrongHeader,
    /// Records are of no layout that their link type has.
    #[error("a record is not laid out as its link type says; such are skipped")]
    Malformed,
    /// Control transfers begin and never end.
    #[error("control transfers begin and never end; records are missing from the capture")]
    Unfinished,
    /// A line of text is longer than any report's.
    #[error(
        "line {line} is longer than {} bytes; such lines are skipped",
        super::LINE_BYTES_MAX
    )]
    LineTooLong {
        /// Its number, from 1.
        line: u64,
    },
    /// A line of text is not what its prefix says.
    #[error("line {line} cannot be read; such lines are skipped")]
    Line {
        /// Its number, from 1.
        line: u64,
    },
}

/// Counts of what has been read so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    /// Records of the file (usbmon counts a transfer's submission and its completion), or reports
    /// of a text.
    pub records: u64,
    /// Packets made of them.
    pub packets: u64,
    /// Transfers that ended with an error status and without data.
    pub failed: u64,
    /// Records that say they hold more data than they do.
    pub shortened: u64,
    /// Data of control transfers that began before the capture did.
    pub unpaired: u64,
    /// Records or lines that are not laid out as they should be.
    pub malformed: u64,
}
