//! The table of tracked devices: ids, identities, roles, rings.

use posed_signal::{
    DeviceId, Role, Sample, Serial,
    device::DEVICES_MAX,
    ring::{Consumer, Producer, ring},
};

use super::{Counters, DeviceInfo};
use crate::{
    decode::{DecodeError, Identity},
    trouble::Trouble,
    usb::{Port, UsbId},
};

/// Which unit behind which USB device feeds a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) port: Port,
    pub(super) unit: usize,
}

/// Every tracked device. A device's index is its id.
pub(super) struct Table {
    devices: Vec<DeviceInfo>,
    rings: Vec<Producer<Sample>>,
    /// Roles that the user gave.
    given: Vec<(Serial, Role)>,
    revision: u64,
    refused: u64,
}

impl Table {
    pub(super) fn new(
        given: Vec<(Serial, Role)>,
        ring_samples: usize,
    ) -> (Self, Vec<Consumer<Sample>>) {
        let (rings, consumers) = (0..DEVICES_MAX).map(|_| ring(ring_samples)).unzip();
        let devices = Vec::with_capacity(DEVICES_MAX);
        (
            Self {
                devices,
                rings,
                given,
                revision: 0,
                refused: 0,
            },
            consumers,
        )
    }

    pub(super) fn devices(&self) -> &[DeviceInfo] {
        &self.devices
    }

    pub(super) fn revision(&self) -> u64 {
        self.revision
    }

    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// The id for a unit that says it is `identity`, and that was known as `bound` so far. `None`
    /// when there are too many devices.
    ///
    /// A serial number that was seen before keeps its id, wherever it turns up: the newest place
    /// is the valid one (a controller is the same on its cable and over the air).
    pub(super) fn identify(
        &mut self,
        bound: Option<DeviceId>,
        owner: Owner,
        usb: Option<UsbId>,
        identity: Identity,
    ) -> Option<DeviceId> {
        let named = identity.serial != Serial::default();
        let same_serial = |device: &&DeviceInfo| device.identity.serial == identity.serial;
        let seen = self
            .devices
            .iter()
            .find(same_serial)
            .filter(|_| named)
            .map(|d| d.id);
        let own = bound.filter(|&id| self.owns(id, owner));
        let anonymous = own.filter(|&id| self.device(id).identity.serial == Serial::default());
        let id = seen.or(anonymous).or_else(|| self.free_id());
        if let Some(left) = own.filter(|&own| id != Some(own)) {
            let left = &mut self.devices[usize::from(left.0)];
            left.connected = false;
            left.troubles.clear();
        }
        let Some(id) = id else {
            self.refused += 1;
            return None;
        };
        self.take(id, owner, usb, identity);
        self.changed();
        Some(id)
    }

    /// A sample of the device `id`; one from a place that another has taken over is dropped.
    pub(super) fn sample(&mut self, id: DeviceId, owner: Owner, sample: Sample) {
        if !self.owns(id, owner) {
            return;
        }
        let index = usize::from(id.0);
        let device = &mut self.devices[index];
        if !is_sound(&sample) {
            device.counters.unsound += 1;
            return;
        }
        device.counters.samples += 1;
        match sample {
            Sample::Imu(imu) => {
                device.counters.imu += 1;
                device.imu = Some(imu);
            }
            Sample::Pose(pose) => {
                device.counters.poses += 1;
                device.pose = Some(pose);
            }
            Sample::Orientation(orientation) => {
                device.counters.orientations += 1;
                device.orientation = Some(orientation);
            }
            Sample::Buttons(buttons) => device.buttons = Some(buttons),
            Sample::Battery(battery) => device.battery = Some(battery),
            Sample::Radio(radio) => device.radio = Some(radio),
        }
        if !self.rings[index].push(sample) {
            device.counters.dropped += 1;
        }
    }

    /// Counts a packet of the USB device that a device hangs on.
    pub(super) fn count_packet(&mut self, id: DeviceId, owner: Owner, error: Option<&DecodeError>) {
        if !self.owns(id, owner) {
            return;
        }
        self.devices[usize::from(id.0)].counters.count_packet(error);
    }

    /// Adds what was counted before the device behind the packets was known.
    pub(super) fn count_early(&mut self, id: DeviceId, early: Counters) {
        let counters = &mut self.devices[usize::from(id.0)].counters;
        counters.packets += early.packets;
        counters.decode_errors += early.decode_errors;
        counters.last_error = early.last_error.or(counters.last_error.take());
    }

    /// What sits on `port` became known.
    pub(super) fn name_usb(&mut self, port: Port, usb: UsbId) {
        for device in self
            .devices
            .iter_mut()
            .filter(|d| d.connected && d.port == port)
        {
            device.usb = Some(usb);
        }
        self.revision += 1;
    }

    /// The devices behind `port` have gone.
    pub(super) fn disconnect(&mut self, port: Port) {
        for device in self.devices.iter_mut().filter(|d| d.port == port) {
            device.connected = false;
            device.troubles.clear();
        }
        self.changed();
    }

    /// Devices that are there, have a serial number, and of which neither they themselves nor the
    /// user have said what they stand for.
    pub(super) fn unassigned(&self) -> impl Iterator<Item = &DeviceInfo> {
        let given = |serial: Serial| self.given.iter().any(|(given, _)| *given == serial);
        self.devices.iter().filter(move |device| {
            let (identity, silent) = (&device.identity, Serial::default());
            device.connected
                && identity.natural_role == Role::None
                && identity.serial != silent
                && !given(identity.serial)
        })
    }

    /// Gives a device its role, as if the user had done so.
    pub(super) fn assign(&mut self, serial: Serial, role: Role) {
        self.given.retain(|(given, _)| *given != serial);
        self.given.push((serial, role));
        self.changed();
    }

    fn device(&self, id: DeviceId) -> &DeviceInfo {
        &self.devices[usize::from(id.0)]
    }

    fn owns(&self, id: DeviceId, owner: Owner) -> bool {
        let device = self.device(id);
        device.connected && device.port == owner.port && device.unit == owner.unit
    }

    /// An id that nobody has; else one of a device that has gone, preferably one that never said
    /// its serial number.
    fn free_id(&self) -> Option<DeviceId> {
        if self.devices.len() < DEVICES_MAX {
            return Some(DeviceId(self.devices.len() as u8));
        }
        let gone = self.devices.iter().filter(|device| !device.connected);
        gone.min_by_key(|device| device.identity.serial != Serial::default())
            .map(|d| d.id)
    }

    /// Puts the device at `owner` into the entry `id`.
    fn take(&mut self, id: DeviceId, owner: Owner, usb: Option<UsbId>, identity: Identity) {
        let Owner { port, unit } = owner;
        let mut fresh = DeviceInfo {
            id,
            port,
            unit,
            usb,
            identity,
            role: Role::None,
            connected: true,
            counters: Counters::default(),
            imu: None,
            pose: None,
            orientation: None,
            buttons: None,
            battery: None,
            radio: None,
            troubles: Vec::new(),
        };
        let index = usize::from(id.0);
        let Some(known) = self.devices.get_mut(index) else {
            self.devices.push(fresh);
            return;
        };
        let (stays, serial) = (known.connected, known.identity.serial);
        if stays && (known.port, known.unit) == (port, unit) {
            (known.identity, known.usb) = (identity, usb);
            return;
        }
        // Who comes back goes on counting; who is given the id of one that has gone begins anew.
        if serial == identity.serial && serial != Serial::default() {
            (fresh.counters, fresh.role) = (std::mem::take(&mut known.counters), known.role);
        }
        *known = fresh;
    }

    /// Where a device that is there hangs.
    pub(super) fn place(&self, id: DeviceId) -> Option<(Port, usize)> {
        let device = self.devices.get(usize::from(id.0))?;
        device.connected.then_some((device.port, device.unit))
    }

    /// Counts a buzz.
    pub(super) fn count_buzz(&mut self, id: DeviceId, sent: bool) {
        if let Some(device) = self.devices.get_mut(usize::from(id.0)) {
            let counters = &mut device.counters;
            counters.haptics += u64::from(sent);
            counters.haptics_dropped += u64::from(!sent);
        }
    }

    /// What keeps a device from being tracked well now.
    pub(super) fn troubles(&mut self, id: DeviceId, owner: Owner) -> Option<&mut Vec<Trouble>> {
        let owns = self.owns(id, owner);
        owns.then(|| &mut self.devices[usize::from(id.0)].troubles)
    }

    fn changed(&mut self) {
        self.revision += 1;
        self.assign_roles();
    }

    /// Gives each role to one device: rather to one that is there, that the user chose for it,
    /// that has it already, that came first.
    fn assign_roles(&mut self) {
        let mut order: Vec<usize> = (0..self.devices.len()).collect();
        let wish = |device: &DeviceInfo| {
            let named = device.identity.serial != Serial::default();
            let given = self
                .given
                .iter()
                .find(|(serial, _)| *serial == device.identity.serial);
            let given = given.filter(|_| named);
            let role = given.map_or(device.identity.natural_role, |(_, role)| *role);
            (role, given.is_some())
        };
        let wishes: Vec<_> = self.devices.iter().map(wish).collect();
        order.sort_by_key(|&index| {
            let (device, (role, given)) = (&self.devices[index], wishes[index]);
            (!device.connected, !given, device.role != role, index)
        });
        let mut taken = [false; Role::COUNT];
        for index in order {
            let (role, _) = wishes[index];
            let free = role != Role::None && !std::mem::replace(&mut taken[role as usize], true);
            self.devices[index].role = if free { role } else { Role::None };
        }
    }
}

/// Whether every number of a sample is one that may be calculated with.
fn is_sound(sample: &Sample) -> bool {
    match sample {
        Sample::Imu(imu) => imu.accel.is_finite() && imu.gyro.is_finite(),
        Sample::Pose(pose) => pose.is_sound(),
        Sample::Orientation(orientation) => orientation.is_sound(),
        Sample::Buttons(buttons) => {
            let [x, y] = buttons.stick;
            [buttons.trigger, buttons.squeeze, x, y]
                .into_iter()
                .all(f32::is_finite)
        }
        Sample::Battery(battery) => battery.charge.is_finite(),
        Sample::Radio(radio) => radio.rssi_dbm.is_none_or(f32::is_finite),
    }
}
