//! USBPcap records (Windows; link type 249; `USBPCAP_BUFFER_PACKET_HEADER`).
//!
//! A control transfer is a set-up record, then data and status records; newer versions put the
//! data that the host sends behind the set-up packet, and join data and status into one record.

use posed_signal::HostTime;

use super::{pairing::Pairing, records::Record};
use crate::usb::{Packet, Port, Setup, Transfer};

/// The header without what control and isochronous transfers add to it.
const HEADER_BYTES: usize = 27;

const STAGE_SETUP: u8 = 0;
const STAGE_DATA: u8 = 1;

struct Irp<'r> {
    id: u64,
    /// The `USBD_STATUS`; 0 is success.
    status: u32,
    /// The record was made when the transfer came back from the device.
    completed: bool,
    port: Port,
    endpoint: u8,
    transfer_type: u8,
    /// For control transfers.
    stage: u8,
    data: &'r [u8],
    shortened: bool,
}

/// Takes a record into account, and makes a packet of it if it holds data.
pub(super) fn packet(record: &Record<'_>, pairing: &mut Pairing) -> Option<Packet> {
    let Some(irp) = parse(record.data) else {
        pairing.statistics.malformed += 1;
        return None;
    };
    pairing.statistics.shortened += u64::from(irp.shortened);
    let transfer = match irp.transfer_type {
        0 => Transfer::Isochronous,
        1 => Transfer::Interrupt,
        2 => return control(&irp, record.at, pairing),
        3 => Transfer::Bulk,
        _ => {
            pairing.statistics.malformed += 1;
            return None;
        }
    };
    let input = irp.endpoint & 0x80 != 0;
    pairing.statistics.failed += u64::from(irp.completed && irp.status != 0);
    if input != irp.completed {
        return None;
    }
    irp.to_packet(record.at, irp.endpoint, transfer, irp.data)
}

fn control(irp: &Irp<'_>, at: HostTime, pairing: &mut Pairing) -> Option<Packet> {
    let key = (irp.port, irp.id);
    if irp.stage == STAGE_SETUP {
        let Some((bytes, sent)) = irp.data.split_first_chunk() else {
            pairing.statistics.malformed += 1;
            return None;
        };
        let setup = Setup::from_bytes(*bytes);
        pairing.begin(key, setup);
        if is_input(setup) {
            return None;
        }
        return irp.to_packet(at, 0, Transfer::Control(setup), sent);
    }
    pairing.statistics.failed += u64::from(irp.status != 0);
    let setup = if irp.stage == STAGE_DATA {
        pairing.open(key)
    } else {
        pairing.end(key)
    };
    let Some(setup) = setup else {
        return pairing.unpaired(!irp.data.is_empty());
    };
    let direction = setup.request_type & 0x80;
    irp.to_packet(
        at,
        irp.endpoint & 0x7f | direction,
        Transfer::Control(setup),
        irp.data,
    )
}

fn is_input(setup: Setup) -> bool {
    setup.request_type & 0x80 != 0
}

impl Irp<'_> {
    fn to_packet(
        &self,
        at: HostTime,
        endpoint: u8,
        transfer: Transfer,
        data: &[u8],
    ) -> Option<Packet> {
        if data.is_empty() {
            return None;
        }
        Some(Packet {
            at,
            port: self.port,
            endpoint,
            transfer,
            data: data.to_vec(),
        })
    }
}

fn parse(record: &[u8]) -> Option<Irp<'_>> {
    let header: &[u8; HEADER_BYTES] = record.first_chunk()?;
    let header_bytes = usize::from(u16::from_le_bytes([header[0], header[1]]));
    let transfer_type = header[22];
    let control = transfer_type == 2;
    if header_bytes < HEADER_BYTES + usize::from(control) {
        return None;
    }
    let rest = record.get(header_bytes..)?;
    let length = u32::from_le_bytes(*header[23..].first_chunk()?) as usize;
    let data = &rest[..length.min(rest.len())];
    Some(Irp {
        id: u64::from_le_bytes(*header[2..].first_chunk()?),
        status: u32::from_le_bytes(*header[10..].first_chunk()?),
        completed: header[16] & 1 != 0,
        port: Port {
            bus: u16::from_le_bytes([header[17], header[18]]),
            address: u16::from_le_bytes([header[19], header[20]]),
        },
        endpoint: header[21],
        transfer_type,
        stage: if control { record[HEADER_BYTES] } else { 0 },
        data,
        shortened: data.len() < length,
    })
}
