//! One USB device: its decoder, and the tracked devices behind it.

use std::collections::VecDeque;

use posed_signal::{DeviceId, HostTime, Sample};

use super::{
    Counters,
    table::{Owner, Table},
};
use crate::{
    catalog::{self, Entry},
    decode::{Command, Decoder, Emit, Identity, UNITS_MAX},
    haptic::Haptic,
    usb::{Packet, Port, UsbId},
};

/// Packets kept of a device while it is not known what it is: its configuration may be among them.
const BACKLOG_PACKETS: usize = 256;
/// Longer packets are not kept; no configuration comes in such.
const BACKLOG_PACKET_BYTES: usize = 256;

/// A USB device.
pub(super) struct Link {
    port: Port,
    usb: Option<UsbId>,
    entry: Option<&'static Entry>,
    decoder: Option<Box<dyn Decoder>>,
    units: Units,
    backlog: VecDeque<Packet>,
    inertial_reports: u32,
}

/// The tracked devices behind a USB device.
pub(super) struct Units {
    ids: [Option<DeviceId>; UNITS_MAX],
    /// What was counted before the first of them was known.
    early: Counters,
}

impl Link {
    /// A device on `port`; without an id, its reports will have to say what it is.
    pub(super) fn new(port: Port, usb: Option<UsbId>, settings: &catalog::Settings) -> Self {
        let entry = usb.and_then(catalog::find);
        let units = Units {
            ids: [None; UNITS_MAX],
            early: Counters::default(),
        };
        Self {
            port,
            usb,
            entry,
            decoder: entry.map(|entry| (entry.make)(settings)),
            units,
            backlog: VecDeque::new(),
            inertial_reports: 0,
        }
    }

    /// Whether this is known to be `id`.
    pub(super) fn is(&self, id: UsbId) -> bool {
        self.usb == Some(id)
    }

    /// Takes note that the device is `id`, if its reports have shown as much.
    pub(super) fn confirm(&mut self, id: UsbId) -> bool {
        let same = self.usb.is_none() && self.entry.is_some_and(|entry| entry.ids.contains(&id));
        if same {
            self.usb = Some(id);
        }
        same
    }

    pub(super) fn take_backlog(&mut self) -> VecDeque<Packet> {
        std::mem::take(&mut self.backlog)
    }

    /// Decodes a packet; `false` if nobody knows how (yet).
    pub(super) fn packet(
        &mut self,
        packet: &Packet,
        settings: &catalog::Settings,
        table: &mut Table,
    ) -> bool {
        if self.decoder.is_some() {
            self.decode(packet, table);
            return true;
        }
        if self.usb.is_some() {
            return false;
        }
        self.remember(packet);
        let Some(entry) = catalog::recognise(packet, &mut self.inertial_reports) else {
            return false;
        };
        self.entry = Some(entry);
        self.decoder = Some((entry.make)(settings));
        for packet in self.take_backlog() {
            self.decode(&packet, table);
        }
        true
    }

    pub(super) fn tick(&mut self, now: HostTime, commands: &mut Vec<Command>) {
        if let Some(decoder) = &mut self.decoder {
            decoder.tick(now, commands);
        }
    }

    /// Takes note of what keeps the devices behind it from being tracked well.
    pub(super) fn look(&self, table: &mut Table) {
        let Some(decoder) = &self.decoder else { return };
        for (unit, id) in self.units.ids.iter().enumerate() {
            let owner = Owner {
                port: self.port,
                unit,
            };
            if let Some(troubles) = id.and_then(|id| table.troubles(id, owner)) {
                troubles.clear();
                decoder.troubles(unit, troubles);
            }
        }
    }

    /// Has a device behind it buzz; `false` where it cannot.
    pub(super) fn buzz(
        &mut self,
        unit: usize,
        haptic: &Haptic,
        commands: &mut Vec<Command>,
    ) -> bool {
        let decoder = self.decoder.as_mut();
        decoder.is_some_and(|decoder| decoder.buzz(unit, haptic, commands))
    }

    fn remember(&mut self, packet: &Packet) {
        if packet.data.len() > BACKLOG_PACKET_BYTES {
            return;
        }
        if self.backlog.len() == BACKLOG_PACKETS {
            self.backlog.pop_front();
        }
        self.backlog.push_back(packet.clone());
    }

    fn decode(&mut self, packet: &Packet, table: &mut Table) {
        let Some(decoder) = &mut self.decoder else {
            return;
        };
        let (port, usb, units) = (self.port, self.usb, &mut self.units);
        let error = decoder
            .packet(
                packet,
                &mut Emitter {
                    port,
                    usb,
                    units,
                    table,
                },
            )
            .err();
        let mut counted = false;
        for (unit, id) in self.units.ids.iter().enumerate() {
            if let Some(id) = *id {
                table.count_packet(id, Owner { port, unit }, error.as_ref());
                counted = true;
            }
        }
        if !counted {
            self.units.early.count_packet(error.as_ref());
        }
    }

    #[cfg(test)]
    pub(super) fn with_decoder(port: Port, usb: UsbId, decoder: Box<dyn Decoder>) -> Self {
        let mut link = Self::new(port, None, &catalog::Settings::default());
        (link.usb, link.decoder) = (Some(usb), Some(decoder));
        link
    }
}

/// Where a decoder's finds go.
struct Emitter<'a> {
    port: Port,
    usb: Option<UsbId>,
    units: &'a mut Units,
    table: &'a mut Table,
}

impl Emitter<'_> {
    fn bind(&mut self, unit: usize, id: Option<DeviceId>) {
        self.units.ids[unit] = id;
        if let Some(id) = id {
            self.table
                .count_early(id, std::mem::take(&mut self.units.early));
        }
    }
}

impl Emit for Emitter<'_> {
    fn identity(&mut self, unit: usize, identity: Identity) {
        let Some(&bound) = self.units.ids.get(unit) else {
            return;
        };
        let owner = Owner {
            port: self.port,
            unit,
        };
        let id = self.table.identify(bound, owner, self.usb, identity);
        self.bind(unit, id);
    }

    fn sample(&mut self, unit: usize, sample: Sample) {
        let Some(&bound) = self.units.ids.get(unit) else {
            return;
        };
        let owner = Owner {
            port: self.port,
            unit,
        };
        let id = bound.or_else(|| {
            let id = self
                .table
                .identify(None, owner, self.usb, Identity::default());
            self.bind(unit, id);
            id
        });
        if let Some(id) = id {
            self.table.sample(id, owner, sample);
        }
    }
}
