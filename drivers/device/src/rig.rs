//! The rig: every device that is there, its decoder, its role, and the rings that its samples go
//! into. No I/O, no clock.

use posed_signal::{
    Battery, Buttons, DeviceId, HostTime, Imu, Pose, Role, Sample, Serial,
    device::DEVICES_MAX,
    ring::{Consumer, ring},
};

use crate::{
    catalog,
    decode::{Command, DecodeError, Identity},
    usb::{Packet, Port, UsbId},
};

/// Samples that a device's ring holds by default: 2 s of a headset's 1 kHz IMU.
pub const RING_SAMPLES: usize = 2_048;

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
    /// Samples of any kind, dropped ones included.
    pub samples: u64,
    /// Inertial samples.
    pub imu: u64,
    /// Poses.
    pub poses: u64,
    /// Samples stopped at the door because a number was not finite or a rotation not unit.
    pub unsound: u64,
    /// Samples dropped because the ring was full.
    pub dropped: u64,
}

/// A tracked device.
#[derive(Debug, Clone)]
pub struct DeviceInfo {
    /// Index of its ring; kept over a re-plug once its serial number is known.
    pub id: DeviceId,
    /// The USB device it hangs on.
    pub port: Port,
    /// Which of the devices behind that USB device.
    pub unit: usize,
    /// Ids of that USB device, if known.
    pub usb: Option<UsbId>,
    /// What it says about itself; its serial number is empty until it has.
    pub identity: Identity,
    /// What it stands for on the body.
    pub role: Role,
    /// Whether it is there.
    pub connected: bool,
    /// Counts.
    pub counters: Counters,
    /// Its newest inertial sample.
    pub imu: Option<Imu>,
    /// Its newest pose.
    pub pose: Option<Pose>,
    /// The newest state of its buttons.
    pub buttons: Option<Buttons>,
    /// Its battery.
    pub battery: Option<Battery>,
}

/// Every device that is there.
pub struct Rig {
    settings: Settings,
    devices: Vec<DeviceInfo>,
    revision: u64,
}

impl Rig {
    /// An empty rig, and the reading ends of its rings: the ring of [`DeviceId`] `i` is at `i`.
    #[must_use]
    pub fn new(settings: Settings) -> (Self, Vec<Consumer<Sample>>) {
        let (_producers, consumers): (Vec<_>, Vec<_>) = (0..DEVICES_MAX)
            .map(|_| ring(settings.ring_samples))
            .unzip();
        (
            Self {
                settings,
                devices: Vec::new(),
                revision: 0,
            },
            consumers,
        )
    }

    /// A device was plugged in, or what it is became known.
    pub fn attach(&mut self, port: Port, id: UsbId) {
        let _ = (port, id, &self.settings);
    }

    /// A device was unplugged.
    pub fn detach(&mut self, port: Port) {
        let _ = port;
    }

    /// Decodes a packet; its samples go into the rings.
    pub fn packet(&mut self, packet: &Packet) {
        let _ = packet;
    }

    /// Called at least ten times a second: what the decoders want sent now.
    pub fn tick(&mut self, now: HostTime, commands: &mut Vec<(Port, Command)>) {
        let _ = (now, commands);
    }

    /// Every device seen so far, in the order of their ids.
    #[must_use]
    pub fn devices(&self) -> &[DeviceInfo] {
        &self.devices
    }

    /// Goes up whenever a device comes or goes, or an identity or a role changes.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }
}
