//! Writes packets as hid-recorder's text, which hid-tools can replay into a kernel.

use std::{
    collections::BTreeMap,
    io::{self, Write},
};

use posed_signal::HostTime;

use super::hid_recorder::{CONTROL_PREFIX, PHYS_PREFIX};
use crate::usb::{Packet, Port, Transfer, UsbId};

/// `BUS_USB` of the kernel's `input.h`.
const BUS_USB: u16 = 3;

/// Writes hid-recorder's text. Each port and endpoint becomes a device of its own there; times
/// count from the first packet.
///
/// Control transfers, in which devices tell their configuration, are no part of the format: they
/// go into comments that only posed reads. Output reports and other transfers are left out.
pub struct HidRecorderWriter<W: Write> {
    output: W,
    ids: BTreeMap<Port, UsbId>,
    descriptors: BTreeMap<(Port, u8), Vec<u8>>,
    indices: BTreeMap<(Port, u8), usize>,
    current: Option<usize>,
    start: Option<HostTime>,
}

impl<W: Write> HidRecorderWriter<W> {
    /// Starts a recording in `output`, which should be buffered.
    pub fn new(output: W) -> Self {
        Self {
            output,
            ids: BTreeMap::new(),
            descriptors: BTreeMap::new(),
            indices: BTreeMap::new(),
            current: None,
            start: None,
        }
    }

    /// Says what sits on `port`; goes into the text with that device's first report.
    pub fn device(&mut self, port: Port, id: UsbId) {
        self.ids.insert(port, id);
    }

    /// Says which report descriptor the interface of `endpoint` has; without it, the text cannot
    /// be replayed into a kernel. Goes into the text with that device's first report.
    pub fn report_descriptor(&mut self, port: Port, endpoint: u8, descriptor: &[u8]) {
        self.descriptors
            .insert((port, endpoint), descriptor.to_vec());
    }

    /// Writes one input report or control transfer.
    ///
    /// # Errors
    /// The output cannot be written to.
    pub fn packet(&mut self, packet: &Packet) -> io::Result<()> {
        let start = *self.start.get_or_insert(packet.at);
        let micros = packet.at.0.saturating_sub(start.0) / 1_000;
        let time = format!("{:06}.{:06}", micros / 1_000_000, micros % 1_000_000);
        match packet.transfer {
            Transfer::Control(setup) => {
                write!(self.output, "{CONTROL_PREFIX} {} {time}", packet.port)?;
                self.bytes(&setup.to_bytes())?;
                self.bytes(&packet.data)?;
            }
            Transfer::Interrupt if packet.is_input() => {
                self.select(packet.port, packet.endpoint)?;
                write!(self.output, "E: {time} {}", packet.data.len())?;
                self.bytes(&packet.data)?;
            }
            _ => return Ok(()),
        }
        writeln!(self.output)
    }

    /// Ends the recording and hands the output back, flushed.
    ///
    /// # Errors
    /// The output cannot be written to.
    pub fn finish(mut self) -> io::Result<W> {
        self.output.flush()?;
        Ok(self.output)
    }

    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        bytes
            .iter()
            .try_for_each(|byte| write!(self.output, " {byte:02x}"))
    }

    /// Makes the lines that follow belong to a device, which is described when it is new.
    fn select(&mut self, port: Port, endpoint: u8) -> io::Result<()> {
        let count = self.indices.len();
        let index = *self.indices.entry((port, endpoint)).or_insert(count);
        if self.current == Some(index) {
            return Ok(());
        }
        self.current = Some(index);
        writeln!(self.output, "D: {index}")?;
        if index < count {
            return Ok(());
        }
        if let Some(descriptor) = self.descriptors.get(&(port, endpoint)).cloned() {
            write!(self.output, "R: {}", descriptor.len())?;
            self.bytes(&descriptor)?;
            writeln!(self.output)?;
        }
        let id = self.ids.get(&port).copied();
        let entry = id.and_then(crate::catalog::find);
        writeln!(
            self.output,
            "N: {}",
            entry.map_or("unknown device", |entry| entry.name)
        )?;
        writeln!(self.output, "P: {PHYS_PREFIX}{port}/{endpoint:02x}")?;
        if let Some(UsbId { vendor, product }) = id {
            writeln!(self.output, "I: {BUS_USB} {vendor:04x} {product:04x}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        capture::{Item, open},
        usb::Setup,
    };

    #[test]
    fn what_is_written_is_read_back() {
        let port = Port {
            bus: 3,
            address: 45,
        };
        let packet = |micros: u64, endpoint, transfer, data: &[u8]| Packet {
            at: HostTime(micros * 1_000),
            port,
            endpoint,
            transfer,
            data: data.to_vec(),
        };
        let setup = Setup::from_bytes([0xa1, 1, 0x10, 3, 0, 0, 64, 0]);
        let packets = [
            packet(0, 0x80, Transfer::Control(setup), &[0x10, 0x40, 0, 7]),
            packet(1_500_000, 0x81, Transfer::Interrupt, &[0x20, 0xff]),
            packet(1_500_001, 0x83, Transfer::Interrupt, &[0x28, 0, 1]),
            packet(2_000_000, 0x81, Transfer::Interrupt, &[0x20, 0xfe]),
        ];
        let id = UsbId::new(0x28de, 0x2300);
        let mut writer = HidRecorderWriter::new(Vec::new());
        writer.device(port, id);
        writer.report_descriptor(port, 0x81, &[6, 0, 0xff]);
        packets
            .iter()
            .for_each(|packet| writer.packet(packet).unwrap());
        let text = writer.finish().unwrap();

        let mut reader = open(&text[..]).unwrap();
        let items: Vec<_> = reader.by_ref().collect();
        let mut expected: Vec<_> = packets.into_iter().map(Item::Packet).collect();
        expected.insert(1, Item::Device(port, id));
        assert_eq!(items, expected);
        assert_eq!(reader.statistics().records, 4);
        let text = std::str::from_utf8(&text).unwrap();
        assert!(text.contains("R: 3 06 00 ff\n"), "{text}");
        assert!(text.contains("E: 000001.500000 2 20 ff\n"), "{text}");
    }
}
