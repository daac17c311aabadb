//! The streaming reader behind [`open`].

use std::{
    collections::{BTreeMap, VecDeque},
    io::Read,
    mem::{self, Discriminant},
};

use super::{
    CaptureError, Statistics, Warning,
    hid_recorder::HidRecorder,
    identity,
    pairing::Pairing,
    records::{Link, Record, Records, Step},
    source::Source,
    survive_recording::SurviveRecording,
    usbmon, usbpcap,
};
use crate::usb::{Packet, Port, UsbId};

/// Ports whose device is remembered, so that a repeated descriptor is not news.
const PORTS_MAX: usize = 1_024;

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

enum Format<'a> {
    Records(Records<'a>),
    HidRecorder(Box<HidRecorder<'a>>),
    Survive(Box<SurviveRecording<'a>>),
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
        ref text if HidRecorder::recognises(text) => {
            Format::HidRecorder(Box::new(HidRecorder::new(source)))
        }
        ref text if SurviveRecording::recognises(text) => {
            Format::Survive(Box::new(SurviveRecording::new(source)))
        }
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
            Format::Survive(text) => text.step(pairing),
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
        let records = matches!(self.format, Format::Records(_));
        let malformed = records && statistics.malformed > 0;
        let shortened = statistics.shortened > 0;
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
