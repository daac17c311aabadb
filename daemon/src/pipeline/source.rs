//! The driver side: a transport and the rig it feeds. One thread owns both.

use posed_device::{
    rig::Rig,
    transport::{Event, Transport},
};
use posed_signal::{HostTime, Role, device::DEVICES_MAX, latest::Writer, time::MILLISECOND_NS};

use super::{naming::Unnamed, tracking::RoleTable};

/// Decoders are ticked this often: start-up requests and keep-alives hang on it.
const RIG_TICK_NS: i64 = 50 * MILLISECOND_NS as i64;

/// What came of taking one event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Taken {
    /// Something was there.
    Something,
    /// Nothing was.
    Nothing,
    /// The transport said something that people should know.
    Warning(String),
    /// There will be nothing more.
    End,
}

/// A transport, its rig, and the role table that the tracker reads.
pub struct Source {
    transport: Box<dyn Transport>,
    rig: Rig,
    roles: Writer<RoleTable>,
    revision: Option<u64>,
    next_tick: HostTime,
    commands: Vec<(posed_device::usb::Port, posed_device::decode::Command)>,
    refused: u64,
    unnamed: Unnamed,
    /// What people should know, to be told with the next event.
    notice: Option<String>,
}

impl Source {
    /// Joins a transport and a rig.
    #[must_use]
    pub fn new(transport: Box<dyn Transport>, rig: Rig, roles: Writer<RoleTable>) -> Self {
        Self {
            transport,
            rig,
            roles,
            revision: None,
            next_tick: HostTime(0),
            commands: Vec::new(),
            refused: 0,
            unnamed: Unnamed::default(),
            notice: None,
        }
    }

    /// The rig, for listings.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Commands that a device refused or was not there for.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The transport's next event; waits `wait_ns` at most.
    pub fn next(&mut self, wait_ns: u64) -> Event {
        self.transport.next(wait_ns)
    }

    /// Takes an event that [`Source::next`] gave.
    pub fn take(&mut self, event: Event) -> Taken {
        let taken = match event {
            Event::Attached { port, id } => {
                self.rig.attach(port, id);
                Taken::Something
            }
            Event::Detached { port } => {
                self.rig.detach(port);
                Taken::Something
            }
            Event::Packet(packet) => {
                self.rig.packet(&packet);
                Taken::Something
            }
            Event::Idle => Taken::Nothing,
            Event::Warning(warning) => Taken::Warning(warning.to_string()),
            Event::End => Taken::End,
        };
        self.publish_roles();
        match taken {
            Taken::Something | Taken::Nothing => self.notice.take().map_or(taken, Taken::Warning),
            Taken::Warning(_) | Taken::End => taken,
        }
    }

    /// To be called often with the present time: sends what the decoders want sent.
    pub fn tick(&mut self, now: HostTime) {
        if now < self.next_tick {
            return;
        }
        self.next_tick = now.plus_ns(RIG_TICK_NS);
        self.rig.tick(now, &mut self.commands);
        for (port, command) in self.commands.drain(..) {
            if let Err(error) = self.transport.send(port, &command) {
                self.refused += 1;
                tracing::debug!(%error, %port, "a command was not sent");
            }
        }
        if let Some(notice) = self.unnamed.tick(now, &mut self.rig) {
            self.notice = Some(notice);
        }
        self.publish_roles();
    }

    fn publish_roles(&mut self) {
        let revision = self.rig.revision();
        if self.revision == Some(revision) {
            return;
        }
        let mut table = [Role::None; DEVICES_MAX];
        for device in self.rig.devices().iter().filter(|device| device.connected) {
            table[usize::from(device.id.0)] = device.role;
        }
        // A reader in the way of every slot: the next call tries again.
        if self.roles.publish(table) {
            self.revision = Some(revision);
        }
    }
}
