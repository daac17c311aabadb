//! The streaming reader behind [`open`].

use std::{
    collections::{BTreeMap, VecDeque},
    io::{self, Read},
    mem::{self, Discriminant},
};

use super::{
    hid_recorder::HidRecorder,
    identity,
    pairing::Pairing,
    records::{Link, Record, Records, Step},
    source::Source,
    usbmon, usbpcap,
};
use crate::usb::{Packet, Port, UsbId};

/// Ports whose device is remembered, so that a repeated descriptor is not news.
const PORTS_MAX: usize = 1_024;

/// Why a capture cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// There is nothing in it.
    #[error("the capture is empty")]
    Empty,
    /// Nothing that is known begins like this.
    #[error(
        "no capture format begins with the bytes {first}; posed reads pcap and pcapng files with \
         usbmon or USBPcap records, and hid-recorder text, each also gzip'd"
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

enum Format<'a> {
    Records(Records<'a>),
    HidRecorder(HidRecorder<'a>),
    Ended,
}

/// Reads a capture as a stream; an iterator over [`Item`]s.
pub struct CaptureReader<'a> {
    format: Format<'a>,
    pairing: Pairing,
    devices: BTreeMap<Port, UsbId>,
    queue: VecDeque<Item>,
    warned: Vec<Discriminant<Warning>>,
}

/// Opens a capture; the format is told by its first bytes.
///
/// # Errors
/// The bytes are of no known format, or cannot be read at all.
pub fn open<'a>(input: impl Read + Send + 'a) -> Result<CaptureReader<'a>, CaptureError> {
    let source = Source::new(Box::new(input))?;
    let format = match *source.prefix() {
        [] => return Err(CaptureError::Empty),
        [0x0a, 0x0d, 0x0d, 0x0a, ..]
        | [0xa1, 0xb2, 0xc3, 0xd4, ..]
        | [0xd4, 0xc3, 0xb2, 0xa1, ..]
        | [0xa1, 0xb2, 0x3c, 0x4d, ..]
        | [0x4d, 0x3c, 0xb2, 0xa1, ..] => Format::Records(Records::new(source)?),
        ref text if HidRecorder::recognises(text) => Format::HidRecorder(HidRecorder::new(source)),
        ref other => {
            let first = other
                .iter()
                .take(8)
                .map(|byte| format!("{byte:02x}"))
                .collect();
            return Err(CaptureError::Unknown { first });
        }
    };
    Ok(CaptureReader {
        format,
        pairing: Pairing::default(),
        devices: BTreeMap::new(),
        queue: VecDeque::new(),
        warned: Vec::new(),
    })
}

impl CaptureReader<'_> {
    /// Counts so far.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let mut statistics = self.pairing.statistics;
        if let Format::Records(records) = &self.format {
            statistics.records = records.count();
        }
        statistics
    }

    /// Reads on by one record, line or block.
    fn step(&mut self) {
        let pairing = &mut self.pairing;
        let step = match &mut self.format {
            Format::Records(records) => records.step(|record| decode(&record, pairing)),
            Format::HidRecorder(text) => text.step(pairing),
            Format::Ended => Step::End(None),
        };
        match step {
            Step::Record(packet) => self.packet(packet),
            Step::Other => {}
            Step::Warning(warning) => self.warn(warning),
            Step::End(warning) => {
                self.pairing.statistics = self.statistics();
                self.format = Format::Ended;
                if let Some(warning) = warning {
                    self.warn(warning);
                }
            }
        }
    }

    fn packet(&mut self, found: Found) {
        self.warn_of_records();
        if let Some((port, id)) = found.device {
            self.device(port, id);
        }
        let Some(packet) = found.packet else { return };
        self.pairing.statistics.packets += 1;
        if let Some(id) = identity::device_descriptor(&packet) {
            self.device(packet.port, id);
        }
        self.queue.push_back(Item::Packet(packet));
    }

    fn device(&mut self, port: Port, id: UsbId) {
        let known = self.devices.get(&port) == Some(&id);
        if !known {
            if self.devices.len() < PORTS_MAX || self.devices.contains_key(&port) {
                self.devices.insert(port, id);
            }
            self.queue.push_back(Item::Device(port, id));
        }
    }

    fn warn_of_records(&mut self) {
        let Pairing {
            statistics,
            misheaded,
            overflowed,
            ..
        } = &self.pairing;
        let (misheaded, overflowed) = (*misheaded, *overflowed);
        let (malformed, shortened) = (statistics.malformed > 0, statistics.shortened > 0);
        if misheaded {
            self.warn(Warning::WrongHeader);
        }
        if overflowed {
            self.warn(Warning::Unfinished);
        }
        if malformed {
            self.warn(Warning::Malformed);
        }
        if shortened && !misheaded {
            self.warn(Warning::Shortened);
        }
    }

    fn warn(&mut self, warning: Warning) {
        let kind = mem::discriminant(&warning);
        if !self.warned.contains(&kind) {
            self.warned.push(kind);
            self.queue.push_back(Item::Warning(warning));
        }
    }
}

impl Iterator for CaptureReader<'_> {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        loop {
            if let Some(item) = self.queue.pop_front() {
                return Some(item);
            }
            if matches!(self.format, Format::Ended) {
                return None;
            }
            self.step();
        }
    }
}

/// What a record or a line gave.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub(super) device: Option<(Port, UsbId)>,
    pub(super) packet: Option<Packet>,
}

fn decode(record: &Record<'_>, pairing: &mut Pairing) -> Found {
    let packet = match record.link {
        Link::Usbmon48 | Link::Usbmon64 => usbmon::packet(record, pairing),
        Link::UsbPcap => usbpcap::packet(record, pairing),
    };
    Found {
        device: None,
        packet,
    }
}
