//! The driver side: a transport and the rig it feeds. One thread owns both.

use std::collections::VecDeque;

use posed_device::{
    haptic::Haptic,
    rig::Rig,
    transport::{Event, Transport},
    trouble::Trouble,
};
use posed_signal::{
    DeviceId, HostTime, Role, device::DEVICES_MAX, latest::Writer, ring::Consumer,
    time::MILLISECOND_NS,
};

use super::{naming::Unnamed, tracking::RoleTable};

/// Decoders are ticked this often: start-up requests and keep-alives hang on it.
const RIG_TICK_NS: i64 = 50 * MILLISECOND_NS as i64;

/// A device is to buzz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Buzz {
    /// Which one.
    pub device: DeviceId,
    /// How.
    pub haptic: Haptic,
}

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
    buzzes: Consumer<Buzz>,
    revision: Option<u64>,
    next_tick: HostTime,
    commands: Vec<(posed_device::usb::Port, posed_device::decode::Command)>,
    refused: u64,
    unnamed: Unnamed,
    /// What is wrong with the room, and has been told.
    troubles: Vec<Trouble>,
    /// What people should know, to be told with the next events.
    notices: VecDeque<String>,
}

impl Source {
    /// Joins a transport and a rig.
    #[must_use]
    pub fn new(
        transport: Box<dyn Transport>,
        rig: Rig,
        roles: Writer<RoleTable>,
        buzzes: Consumer<Buzz>,
    ) -> Self {
        Self {
            transport,
            rig,
            roles,
            buzzes,
            revision: None,
            next_tick: HostTime(0),
            commands: Vec::new(),
            refused: 0,
            unnamed: Unnamed::default(),
            troubles: Vec::new(),
            notices: VecDeque::new(),
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
            Taken::Something | Taken::Nothing => {
                self.notices.pop_front().map_or(taken, Taken::Warning)
            }
            Taken::Warning(_) | Taken::End => taken,
        }
    }

    /// To be called often with the present time: sends what the decoders want sent.
    pub fn tick(&mut self, now: HostTime) {
        self.buzz();
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
            self.notices.push_back(notice);
        }
        self.tell_troubles();
        self.publish_roles();
    }

    /// Hands on what devices are to buzz.
    fn buzz(&mut self) {
        while let Some(Buzz { device, haptic }) = self.buzzes.pop() {
            if let Err(error) = self.rig.buzz(device, &haptic, &mut self.commands) {
                self.rig.count_buzz(device, false);
                tracing::debug!(%error, "no buzz");
            }
            for (port, command) in self.commands.drain(..) {
                let sent = self.transport.send(port, &command);
                self.rig.count_buzz(device, sent.is_ok());
                if let Err(error) = sent {
                    tracing::debug!(%error, %port, "no buzz");
                }
            }
        }
    }

    /// Tells of what is wrong with the room, once while it lasts.
    fn tell_troubles(&mut self) {
        let devices = self.rig.devices().iter();
        let mut now: Vec<Trouble> = devices
            .flat_map(|device| &device.troubles)
            .filter(|trouble| trouble.is_of_the_room())
            .copied()
            .collect();
        now.sort_unstable();
        now.dedup();
        let fresh = now
            .iter()
            .filter(|trouble| !self.troubles.contains(trouble));
        self.notices.extend(fresh.map(ToString::to_string));
        self.troubles = now;
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

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use posed_device::{
        decode::Command,
        rig,
        simulate::{Device, Model, Options, Placement, Simulator},
        transport::TransportError,
        usb::Port,
    };
    use posed_signal::{latest::latest, ring::ring};

    use super::*;

    /// A simulated right controller, which takes so many commands.
    struct Bench {
        simulator: Simulator,
        sent: Arc<Mutex<Vec<Command>>>,
        takes: usize,
    }

    impl Transport for Bench {
        fn next(&mut self, _wait_ns: u64) -> Event {
            self.simulator.next().map_or(Event::End, Event::Packet)
        }

        fn send(&mut self, port: Port, command: &Command) -> Result<(), TransportError> {
            let mut sent = self.sent.lock().unwrap();
            if sent.len() == self.takes {
                return Err(TransportError::Busy(port));
            }
            sent.push(command.clone());
            Ok(())
        }
    }

    #[test]
    fn buzzes_reach_the_device_and_those_that_do_not_are_counted() {
        let options = Options {
            duration_s: 0.3,
            ..Options::default()
        };
        let device = Device::new(Model::RightController, |_: f64| Placement {
            position: glam::DVec3::Y,
            rotation: glam::DQuat::IDENTITY,
        });
        let sent = Arc::default();
        let transport = Bench {
            simulator: Simulator::new(options, vec![device]).unwrap(),
            sent: Arc::clone(&sent),
            takes: 2,
        };
        let (rig, _rings) = Rig::new(rig::Settings::default());
        let (roles, _reader) = latest();
        let (mut buzzes, buzzes_in) = ring(4);
        let mut source = Source::new(Box::new(transport), rig, roles, buzzes_in);
        let mut now = HostTime(0);
        loop {
            let event = source.next(0);
            if let Event::Packet(packet) = &event {
                now = packet.at;
            }
            if source.take(event) == Taken::End {
                break;
            }
        }
        let [device] = source.rig().devices() else {
            panic!("one controller is there")
        };
        let (here, nowhere) = (device.id, DeviceId(9));
        let haptic = Haptic::new(0.5, 100.0, 1.0).unwrap();
        let mut push = |device| buzzes.push(Buzz { device, haptic });
        assert!(
            [here, nowhere, here, here]
                .map(&mut push)
                .iter()
                .all(|taken| *taken)
        );
        assert!(!push(here), "the queue is full");
        // The configuration is there, so that nothing else is sent at this tick.
        source.tick(now);
        let counters = &source.rig().devices()[0].counters;
        assert_eq!((counters.haptics, counters.haptics_dropped), (2, 1));
        let data = vec![0xff, 0x8f, 7, 0, 0x9f, 0x0f, 0x71, 0x17, 50, 0];
        let command = Command::SetFeature { interface: 0, data };
        assert_eq!(*sent.lock().unwrap(), [command.clone(), command]);
    }
}
