//! From reports of a receiver to samples of its trackers.

use glam::Vec3;
use posed_signal::{Battery, Buttons, HostTime, Orientation, Radio, Role, Sample, Serial};

use super::{
    turning::Turning,
    wire::{self, Content, LinkStatus, Motion, Power, Signal, WORLD},
};
use crate::{
    decode::{Command, DecodeError, Decoder, Emit, Identity, UNITS_MAX},
    usb::{Packet, Transfer},
};

/// Signal strength is told this often, battery too: trackers repeat them with every few motions.
const TOLD_NS: i64 = 500_000_000;

/// A receiver, or a tracker on its own cable.
pub(super) struct Receiver {
    /// Addresses by the trackers' numbers, heard or not.
    addresses: [Option<u64>; 256],
    /// Which unit a number has; numbers get one when something of theirs is heard.
    units: [Option<u8>; 256],
    trackers: Vec<Tracker>,
}

impl Default for Receiver {
    fn default() -> Self {
        Self {
            addresses: [None; 256],
            units: [None; 256],
            trackers: Vec::new(),
        }
    }
}

impl Decoder for Receiver {
    fn packet(&mut self, packet: &Packet, out: &mut dyn Emit) -> Result<(), DecodeError> {
        if packet.transfer != Transfer::Interrupt || !packet.is_input() {
            return Ok(());
        }
        let mut first_error = Ok(());
        for content in wire::packets(&packet.data)? {
            let taken = content.and_then(|content| self.take(packet.at, content, out));
            first_error = first_error.and(taken);
        }
        first_error
    }

    fn tick(&mut self, _now: HostTime, _commands: &mut Vec<Command>) {}
}

impl Receiver {
    fn take(
        &mut self,
        at: HostTime,
        packet: wire::Packet,
        out: &mut dyn Emit,
    ) -> Result<(), DecodeError> {
        let number = usize::from(packet.tracker);
        if let Content::Register { address } = packet.content {
            let news = self.addresses[number] != Some(address);
            self.addresses[number] = Some(address);
            if let (true, Some(unit)) = (news, self.units[number]) {
                out.identity(usize::from(unit), identity(address));
            }
            return Ok(());
        }
        let unit = self.unit(number, out).ok_or(DecodeError::Malformed {
            id: 0,
            what: "there are more trackers behind this receiver than posed looks after",
        })?;
        self.trackers[unit].take(at, packet.content, &mut |sample| out.sample(unit, sample));
        Ok(())
    }

    /// The unit of a tracker that is heard.
    fn unit(&mut self, number: usize, out: &mut dyn Emit) -> Option<usize> {
        if let Some(unit) = self.units[number] {
            return Some(usize::from(unit));
        }
        let unit = self.trackers.len();
        if unit >= UNITS_MAX {
            return None;
        }
        self.units[number] = Some(unit as u8);
        self.trackers.push(Tracker::default());
        if let Some(address) = self.addresses[number] {
            out.identity(unit, identity(address));
        }
        Some(unit)
    }
}

/// A tracker goes by its address, in the digits that SlimeVR shows.
fn identity(address: u64) -> Identity {
    Identity {
        serial: Serial::new(&format!("{address:012X}")),
        model: "SlimeVR tracker",
        natural_role: Role::None,
        has_haptics: false,
    }
}

/// One tracker.
#[derive(Default)]
struct Tracker {
    turning: Turning,
    /// Time of the last motion: two in one report are still one after the other.
    last: Option<HostTime>,
    /// The last acceleration, in the tracker's frame; packets with a magnetic field have none.
    accel: Vec3,
    received: u64,
    lost: u64,
    radio_told: Option<HostTime>,
    battery_told: Option<HostTime>,
    button: u8,
}

impl Tracker {
    fn take(&mut self, at: HostTime, content: Content, out: &mut dyn FnMut(Sample)) {
        match content {
            Content::Info { power, signal, .. } => {
                self.power(at, power, out);
                self.signal(at, signal, out);
            }
            Content::Motion(motion) => self.motion(at, motion, false, out),
            Content::MotionAndPower {
                motion,
                power,
                signal,
            } => {
                self.motion(at, motion, true, out);
                self.power(at, power, out);
                self.signal(at, signal, out);
            }
            Content::Status { link, signal } => self.status(at, link, signal, out),
            Content::Field { rotation, .. } => {
                let accel = self.accel;
                self.motion(at, Motion { rotation, accel }, false, out);
            }
            Content::Button { button, signal } => {
                self.button(at, button, out);
                self.signal(at, signal, out);
            }
            Content::MotionAndButton {
                motion,
                button,
                signal,
            } => {
                self.motion(at, motion, true, out);
                self.button(at, button, out);
                self.signal(at, signal, out);
            }
            Content::Runtime { signal, .. } => self.signal(at, signal, out),
            Content::Register { .. } => {}
        }
    }

    /// The protocol has no time of its own: a motion is as old as its report, and the radio adds
    /// a few milliseconds that nobody tells.
    fn motion(&mut self, at: HostTime, motion: Motion, coarse: bool, out: &mut dyn FnMut(Sample)) {
        let at = self.last.map_or(at, |last| at.max(last.plus_ns(1)));
        self.last = Some(at);
        self.accel = motion.accel;
        let rotation = (WORLD * motion.rotation).normalize();
        out(Sample::Orientation(Orientation {
            at,
            rotation,
            accel: rotation * motion.accel,
            angular_velocity: self.turning.update(at, rotation, coarse),
        }));
    }

    fn power(&mut self, at: HostTime, power: Power, out: &mut dyn FnMut(Sample)) {
        let Some(charge) = power.charge() else { return };
        if !due(&mut self.battery_told, at) {
            return;
        }
        out(Sample::Battery(Battery {
            at,
            charge,
            charging: power.is_charging(),
        }));
    }

    fn signal(&mut self, at: HostTime, signal: Signal, out: &mut dyn FnMut(Sample)) {
        if signal.dbm().is_some() && due(&mut self.radio_told, at) {
            out(self.radio(at, signal));
        }
    }

    fn status(
        &mut self,
        at: HostTime,
        link: LinkStatus,
        signal: Signal,
        out: &mut dyn FnMut(Sample),
    ) {
        self.received += u64::from(link.received);
        self.lost += u64::from(link.lost);
        self.radio_told = Some(at);
        out(self.radio(at, signal));
    }

    fn radio(&self, at: HostTime, signal: Signal) -> Sample {
        Sample::Radio(Radio {
            at,
            rssi_dbm: signal.dbm(),
            received: self.received,
            lost: self.lost,
        })
    }

    /// The tracker sends what was done with its button, after it was let go, and repeats it for a
    /// second: once is the menu button, twice the system button.
    fn button(&mut self, at: HostTime, button: u8, out: &mut dyn FnMut(Sample)) {
        let action = button & 3;
        if action == std::mem::replace(&mut self.button, action) {
            return;
        }
        let pressed = match action {
            0 => 0,
            1 => Buttons::MENU,
            _ => Buttons::SYSTEM,
        };
        out(Sample::Buttons(Buttons {
            pressed,
            ..Buttons::released(at)
        }));
    }
}

/// Whether it is time to tell something again that was told at `told`, which then is now.
fn due(told: &mut Option<HostTime>, at: HostTime) -> bool {
    let due = told.is_none_or(|told| !(0..TOLD_NS).contains(&at.since_ns(told)));
    if due {
        *told = Some(at);
    }
    due
}
