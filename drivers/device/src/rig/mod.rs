//! The rig: every device that is there, its decoder, its role, and the rings that its samples go
//! into. No I/O, no clock.

mod link;
mod table;

use std::collections::BTreeMap;

use posed_signal::{
    Battery, Buttons, DeviceId, HostTime, Imu, Orientation, Pose, Radio, Role, Sample, Serial,
    ring::Consumer,
};

use self::{link::Link, table::Table};
use crate::{
    capture, catalog,
    decode::{Command, DecodeError, Identity},
    haptic::{Haptic, HapticError},
    trouble::Trouble,
    usb::{Packet, Port, UsbId},
};

/// Samples that a device's ring holds by default: 2 s of a headset's 1 kHz IMU.
pub const RING_SAMPLES: usize = 2_048;
/// USB devices that are looked after at once; what sits on further ports is ignored.
pub const PORTS_MAX: usize = 64;

/// What a rig is told when it is made.
#[derive(Debug, Clone)]
pub struct Settings {
    /// For the decoders.
    pub devices: catalog::Settings,
    /// Roles that the user gave to serial numbers; they override the devices' natural roles.
    pub roles: Vec<(Serial, Role)>,
    /// Samples that each device's ring holds.
    pub ring_samples: usize,
}

impl Default for Settings {
    fn default() -> Self {
        let devices = catalog::Settings::default();
        Self {
            devices,
            roles: Vec::new(),
            ring_samples: RING_SAMPLES,
        }
    }
}

/// What was counted about a device.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counters {
    /// Packets of the USB device it hangs on.
    pub packets: u64,
    /// Packets of that USB device which could not be decoded.
    pub decode_errors: u64,
    /// The last of those errors.
    pub last_error: Option<DecodeError>,
    /// Samples of any kind that were sound, dropped ones included.
    pub samples: u64,
    /// Inertial samples among them.
    pub imu: u64,
    /// Poses among them.
    pub poses: u64,
    /// Orientations among them.
    pub orientations: u64,
    /// Samples stopped at the door because a number was not finite or a rotation not unit.
    pub unsound: u64,
    /// Samples dropped because the ring was full.
    pub dropped: u64,
    /// Buzzes asked of it.
    pub haptics: u64,
    /// Buzzes that it could not be sent: it had gone, or did not keep up.
    pub haptics_dropped: u64,
}

impl Counters {
    fn count_packet(&mut self, error: Option<&DecodeError>) {
        self.packets += 1;
        if let Some(error) = error {
            self.decode_errors += 1;
            self.last_error = Some(error.clone());
        }
    }
}

/// A tracked device.
#[derive(Debug, Clone)]
pub struct DeviceInfo {
    /// Index of its ring and of this entry; kept over a re-plug once its serial number is known.
    pub id: DeviceId,
    /// The USB device it hangs on.
    pub port: Port,
    /// Which of the devices behind that USB device.
    pub unit: usize,
    /// Ids of that USB device, if known.
    pub usb: Option<UsbId>,
    /// What it says about itself; its serial number is empty until it has.
    pub identity: Identity,
    /// What it stands for on the body. Of two devices that could be the same, the one that was
    /// there first is.
    pub role: Role,
    /// Whether it is there.
    pub connected: bool,
    /// Counts.
    pub counters: Counters,
    /// Its newest inertial sample.
    pub imu: Option<Imu>,
    /// Its newest pose.
    pub pose: Option<Pose>,
    /// Its newest orientation.
    pub orientation: Option<Orientation>,
    /// The newest state of its buttons.
    pub buttons: Option<Buttons>,
    /// Its battery.
    pub battery: Option<Battery>,
    /// Its radio link.
    pub radio: Option<Radio>,
    /// What keeps it from being tracked well, by the last tick.
    pub troubles: Vec<Trouble>,
}

/// Every device that is there.
pub struct Rig {
    settings: catalog::Settings,
    links: BTreeMap<Port, Link>,
    table: Table,
    unclaimed: u64,
    commands: Vec<Command>,
}

impl Rig {
    /// An empty rig, and the reading ends of its rings: the ring of [`DeviceId`] `i` is at `i`.
    #[must_use]
    pub fn new(settings: Settings) -> (Self, Vec<Consumer<Sample>>) {
        let (table, consumers) = Table::new(settings.roles, settings.ring_samples);
        let rig = Self {
            settings: settings.devices,
            links: BTreeMap::new(),
            table,
            unclaimed: 0,
            commands: Vec::new(),
        };
        (rig, consumers)
    }

    /// A device was plugged in, or what it is became known. Saying so again changes nothing.
    pub fn attach(&mut self, port: Port, id: UsbId) {
        if self.links.get(&port).is_some_and(|link| link.is(id)) {
            return;
        }
        let recognised = self
            .links
            .get_mut(&port)
            .is_some_and(|link| link.confirm(id));
        if recognised {
            self.table.name_usb(port, id);
            return;
        }
        let backlog = self
            .links
            .get_mut(&port)
            .map(Link::take_backlog)
            .unwrap_or_default();
        self.detach(port);
        if self.links.len() >= PORTS_MAX {
            return;
        }
        self.links
            .insert(port, Link::new(port, Some(id), &self.settings));
        for packet in backlog {
            self.packet(&packet);
        }
    }

    /// A device was unplugged.
    pub fn detach(&mut self, port: Port) {
        if self.links.remove(&port).is_some() {
            self.table.disconnect(port);
        }
    }

    /// Decodes a packet; its samples go into the rings. A device that nobody said what it is is
    /// told by the shape of its reports, if they are like no other's.
    pub fn packet(&mut self, packet: &Packet) {
        let known = self.links.contains_key(&packet.port);
        if !known && self.links.len() < PORTS_MAX {
            self.links
                .insert(packet.port, Link::new(packet.port, None, &self.settings));
        }
        let claimed = self
            .links
            .get_mut(&packet.port)
            .is_some_and(|link| link.packet(packet, &self.settings, &mut self.table));
        self.unclaimed += u64::from(!claimed);
    }

    /// Called at least ten times a second: what the decoders want sent now.
    pub fn tick(&mut self, now: HostTime, commands: &mut Vec<(Port, Command)>) {
        for (port, link) in &mut self.links {
            link.tick(now, &mut self.commands);
            link.look(&mut self.table);
            commands.extend(self.commands.drain(..).map(|command| (*port, command)));
        }
    }

    /// Has a device buzz: what to send to it is added to `commands`.
    ///
    /// # Errors
    /// It is not there, or cannot buzz.
    pub fn buzz(
        &mut self,
        id: DeviceId,
        haptic: &Haptic,
        commands: &mut Vec<(Port, Command)>,
    ) -> Result<(), HapticError> {
        let (port, unit) = self.table.place(id).ok_or(HapticError::NoDevice(id))?;
        let link = self.links.get_mut(&port);
        let link = link.ok_or(HapticError::NoDevice(id))?;
        if !link.buzz(unit, haptic, &mut self.commands) {
            return Err(HapticError::NoMotor(id));
        }
        commands.extend(self.commands.drain(..).map(|command| (port, command)));
        Ok(())
    }

    /// Counts a buzz of a device, which was sent or was not.
    pub fn count_buzz(&mut self, id: DeviceId, sent: bool) {
        self.table.count_buzz(id, sent);
    }

    /// Every device seen so far, in the order of their ids.
    #[must_use]
    pub fn devices(&self) -> &[DeviceInfo] {
        self.table.devices()
    }

    /// Devices that are there, have a serial number, and of which neither they themselves nor the
    /// user have said what they stand for.
    pub fn unassigned(&self) -> impl Iterator<Item = &DeviceInfo> {
        self.table.unassigned()
    }

    /// Gives the device of a serial number its role, until the rig's end: the same as a role in
    /// [`Settings`], which it replaces.
    pub fn assign(&mut self, serial: Serial, role: Role) {
        self.table.assign(serial, role);
    }

    /// Goes up whenever a device comes or goes, or an identity or a role changes.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.table.revision()
    }

    /// Packets so far of USB devices that posed does not know, or not yet.
    #[must_use]
    pub fn unclaimed(&self) -> u64 {
        self.unclaimed
    }

    /// Devices that found no free id, see [`posed_signal::device::DEVICES_MAX`].
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.table.refused()
    }
}

/// Replays `data` as a capture into a rig, with a tick for every packet: the entry point of fuzz
/// targets. Returns the samples that came of it.
pub fn fuzz_entry(data: &[u8]) -> u64 {
    let Ok(reader) = capture::open(data) else {
        return 0;
    };
    let (mut rig, mut rings) = Rig::new(Settings {
        ring_samples: 16,
        ..Settings::default()
    });
    let (mut commands, mut samples) = (Vec::new(), 0);
    for item in reader {
        match item {
            capture::Item::Device(port, id) => rig.attach(port, id),
            capture::Item::Packet(packet) => {
                rig.packet(&packet);
                rig.tick(packet.at, &mut commands);
                commands.clear();
            }
            capture::Item::Warning(_) => {}
        }
        for ring in &mut rings {
            samples += std::iter::from_fn(|| ring.pop()).count() as u64;
        }
    }
    samples
}

#[cfg(test)]
mod tests;
