//! Linux usbmon records (`Documentation/usb/usbmon.rst`; link types 189 and 220).
//!
//! A transfer gives a submission (S) and a completion (C), or a submission error (E). Data that
//! the host sends stands in the submission, data that it reads in the completion, and a control
//! transfer's set-up packet in the submission only.

use posed_signal::HostTime;

use super::{
    pairing::Pairing,
    records::{Link, Record},
};
use crate::usb::{Packet, Port, Setup, Transfer};

/// The header of link type 189, and the common part of both.
const HEADER_BYTES: usize = 48;
/// The header of link type 220.
const HEADER_MMAPPED_BYTES: usize = 64;
/// An isochronous descriptor: status, offset, length, padding.
const ISO_DESCRIPTOR_BYTES: usize = 16;
/// `URB_DIR_IN` of the kernel's `transfer_flags`.
const URB_DIR_IN: u32 = 0x200;
/// Every transfer flag that the kernel has.
const URB_FLAGS: u32 = 0x07ff;
/// Polling intervals in microframes do not reach this.
const INTERVAL_MAX: u32 = 1 << 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Submission,
    Completion,
    Error,
}

struct Urb<'r> {
    id: u64,
    stage: Stage,
    transfer_type: u8,
    endpoint: u8,
    port: Port,
    setup: Option<Setup>,
    status: i32,
    data: &'r [u8],
    shortened: bool,
    misheaded: bool,
}

/// Takes a record into account, and makes a packet of it if it holds data.
pub(super) fn packet(record: &Record<'_>, pairing: &mut Pairing) -> Option<Packet> {
    let Some(urb) = parse(record) else {
        pairing.statistics.malformed += 1;
        return None;
    };
    pairing.statistics.shortened += u64::from(urb.shortened);
    pairing.misheaded |= urb.misheaded;
    let key = (urb.port, urb.id);
    match urb.stage {
        Stage::Submission => {
            let transfer = match (urb.transfer_type, urb.setup) {
                (2, Some(setup)) if urb.is_input() => {
                    pairing.begin(key, setup);
                    return None;
                }
                (2, setup) => Transfer::Control(setup?),
                _ => urb.plain_transfer(),
            };
            (!urb.is_input()).then(|| urb.to_packet(record.at, transfer))?
        }
        Stage::Completion => {
            let setup = if urb.transfer_type == 2 {
                pairing.end(key)
            } else {
                None
            };
            pairing.statistics.failed += u64::from(urb.status < 0 && urb.data.is_empty());
            let transfer = match (urb.transfer_type, setup) {
                (2, None) => return pairing.unpaired(urb.is_input() && !urb.data.is_empty()),
                (2, Some(setup)) => Transfer::Control(setup),
                _ => urb.plain_transfer(),
            };
            urb.is_input().then(|| urb.to_packet(record.at, transfer))?
        }
        Stage::Error => {
            pairing.end(key);
            pairing.statistics.failed += 1;
            None
        }
    }
}

impl Urb<'_> {
    fn is_input(&self) -> bool {
        self.endpoint & 0x80 != 0
    }

    fn plain_transfer(&self) -> Transfer {
        match self.transfer_type {
            0 => Transfer::Isochronous,
            1 => Transfer::Interrupt,
            _ => Transfer::Bulk,
        }
    }

    fn to_packet(&self, at: HostTime, transfer: Transfer) -> Option<Packet> {
        if self.data.is_empty() {
            return None;
        }
        let (port, endpoint) = (self.port, self.endpoint);
        Some(Packet {
            at,
            port,
            endpoint,
            transfer,
            data: self.data.to_vec(),
        })
    }
}

fn parse<'r>(record: &Record<'r>) -> Option<Urb<'r>> {
    let header: &[u8; HEADER_BYTES] = record.data.first_chunk()?;
    let stage = match header[8] {
        b'S' => Stage::Submission,
        b'C' => Stage::Completion,
        b'E' => Stage::Error,
        _ => return None,
    };
    let [transfer_type, endpoint, address] = [header[9], header[10], header[11]];
    if transfer_type > 3 {
        return None;
    }
    let length = u32_at(header, 36) as usize;
    let misheaded = record.link == Link::Usbmon48 && has_mmapped_header(record.data, length);
    let long = misheaded || record.link == Link::Usbmon64;
    let header_bytes = if long {
        HEADER_MMAPPED_BYTES
    } else {
        HEADER_BYTES
    };
    let rest = record.data.get(header_bytes..)?;
    // A data flag other than 0 says why there is no data.
    let wanted = if header[15] == 0 { length } else { 0 };
    let mut data = &rest[..wanted.min(rest.len())];
    let shortened = data.len() < wanted;
    if transfer_type == 0 && long {
        let descriptors = (u32_at(record.data, 60) as usize).saturating_mul(ISO_DESCRIPTOR_BYTES);
        data = data.get(descriptors..).unwrap_or(&[]);
    }
    let has_setup = transfer_type == 2 && stage == Stage::Submission && header[14] == 0;
    let setup = || {
        header[40..48]
            .first_chunk()
            .map(|bytes| Setup::from_bytes(*bytes))
    };
    Some(Urb {
        id: u64::from_le_bytes(*header.first_chunk()?),
        stage,
        transfer_type,
        endpoint,
        port: Port {
            bus: u16::from_le_bytes([header[12], header[13]]),
            address: u16::from(address),
        },
        setup: if has_setup { setup() } else { None },
        status: u32_at(header, 28).cast_signed(),
        data,
        shortened,
        misheaded,
    })
}

/// Whether a record of link type 189 has the longer header of link type 220 all the same, with its
/// length counted as if it had not, so that the last 16 bytes of data are lost (seen in the wild).
/// The four words in question then hold interval, start frame, flags and descriptor count.
fn has_mmapped_header(record: &[u8], length: usize) -> bool {
    let counted_short = record.len() == HEADER_BYTES + length;
    if !counted_short || length < HEADER_MMAPPED_BYTES - HEADER_BYTES {
        return false;
    }
    let [interval, start_frame, flags, descriptors] = [48, 52, 56, 60].map(|at| u32_at(record, at));
    let inward = record[10] & 0x80 != 0;
    interval < INTERVAL_MAX
        && start_frame == 0
        && flags & !URB_FLAGS == 0
        && (flags & URB_DIR_IN != 0) == inward
        && inward
        && descriptors == 0
}

/// The little-endian word at `offset`; 0 beyond the end.
fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    bytes
        .get(offset..)
        .and_then(<[u8]>::first_chunk)
        .map_or(0, |word| u32::from_le_bytes(*word))
}
