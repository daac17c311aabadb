//! Devices that are plugged in: readers and their queue.
//!
//! Each input endpoint is read by a thread of its own, which stamps every report with host time at
//! once; each device's control transfers, which may block, run on another; a scanner per backend
//! looks for devices. They all feed one bounded queue. Reports that find it full are dropped and
//! counted.

use std::{
    collections::BTreeMap,
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{self, Receiver, SyncSender, TrySendError},
    },
    time::Duration,
};

use posed_signal::Clock;

use super::{
    Event, Transport, TransportError, Warning,
    scan::{Backend, Control, Found, Input, Opened, Scanner},
};
use crate::{
    decode::Command,
    usb::{Packet, Port, Setup, Transfer},
};

/// Events that may wait in the queue: 1 s of four devices at 1 kHz.
const MESSAGES_MAX: usize = 4_096;
/// Commands that may wait for one device.
const COMMANDS_MAX: usize = 64;
/// Longer reports are cut; HID devices of full and high speed send 64 or up to 1024 bytes.
const REPORT_BYTES_MAX: usize = 4_096;
/// How long a reader waits before it looks whether it is still wanted.
const READ_TIMEOUT: Duration = Duration::from_millis(200);

/// Something to be run on a thread of its own; it ends soon after its [`Live`] is dropped.
pub type Job = Box<dyn FnOnce() + Send>;
/// Runs a job on a thread of the given name.
pub type Spawn = Box<dyn FnMut(&str, Job) -> io::Result<()> + Send>;

type SharedClock = Arc<dyn Clock + Send + Sync>;

/// What threads tell the transport.
pub(super) enum Message {
    Plugged {
        found: Found,
        opened: Opened,
    },
    Unplugged(Port),
    /// A finished transfer of the device that was plugged in as the given one.
    Packet(u64, Packet),
    /// That device cannot be read any more.
    Lost(u64, Port),
    Warning(Warning),
}

/// A device that is open.
struct Plugged {
    /// Which device since the start, counted: a port may see several.
    number: u64,
    commands: SyncSender<Command>,
    unplugged: Arc<AtomicBool>,
}

/// The live transport: every device that its backends reach.
pub struct Live {
    clock: SharedClock,
    spawn: Spawn,
    devices: BTreeMap<Port, Plugged>,
    count: u64,
    sender: SyncSender<Message>,
    messages: Receiver<Message>,
    /// To the scanners: ports whose device was lost.
    lost: Vec<mpsc::Sender<Port>>,
    dropped: Arc<AtomicU64>,
    refused: Arc<AtomicU64>,
}

impl Live {
    /// Starts to look for devices through `backends`. Time stamps are `clock`'s; `spawn` runs
    /// what has to wait.
    ///
    /// # Errors
    /// A scanner's thread cannot be started.
    pub fn new(
        backends: Vec<Box<dyn Backend>>,
        clock: Arc<dyn Clock + Send + Sync>,
        mut spawn: Spawn,
    ) -> io::Result<Self> {
        let (sender, messages) = mpsc::sync_channel(MESSAGES_MAX);
        let mut lost = Vec::new();
        for backend in backends {
            let (lost_sender, lost_receiver) = mpsc::channel();
            lost.push(lost_sender);
            let name = format!("scan-{}", backend.name());
            let scanner = Scanner::new(backend, sender.clone());
            spawn(&name, Box::new(move || scanner.run(&lost_receiver)))?;
        }
        Ok(Self {
            clock,
            spawn,
            devices: BTreeMap::new(),
            count: 0,
            sender,
            messages,
            lost,
            dropped: Arc::default(),
            refused: Arc::default(),
        })
    }

    /// Reports dropped so far because the queue was full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Control transfers so far that devices refused, as they do while they are asleep.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    fn take(&mut self, message: Message) -> Option<Event> {
        match message {
            Message::Plugged { found, opened } => Some(self.plug(found, opened)),
            Message::Unplugged(port) => self.unplug(port),
            Message::Packet(number, packet) => {
                let current = self.devices.get(&packet.port)?.number == number;
                current.then_some(Event::Packet(packet))
            }
            Message::Lost(number, port) => {
                if self.devices.get(&port)?.number != number {
                    return None;
                }
                for scanner in &self.lost {
                    // A scanner that has ended cannot open the port again either.
                    let _ = scanner.send(port);
                }
                self.unplug(port)
            }
            Message::Warning(warning) => Some(Event::Warning(warning)),
        }
    }

    fn plug(&mut self, found: Found, opened: Opened) -> Event {
        let Found { port, id, .. } = found;
        self.count += 1;
        let number = self.count;
        let (commands, command_receiver) = mpsc::sync_channel(COMMANDS_MAX);
        let unplugged = Arc::new(AtomicBool::new(false));
        let plugged = Plugged {
            number,
            commands,
            unplugged: Arc::clone(&unplugged),
        };
        self.devices.insert(port, plugged);
        let line = Line {
            number,
            port,
            clock: self.clock.clone(),
            messages: self.sender.clone(),
        };
        let mut result = Ok(());
        for input in opened.inputs {
            let (line, unplugged) = (line.clone(), Arc::clone(&unplugged));
            let dropped = Arc::clone(&self.dropped);
            let name = format!("usb-{port}-{:02x}", input.endpoint);
            let job = Box::new(move || read_reports(input, &line, &unplugged, &dropped));
            result = result.and_then(|()| (self.spawn)(&name, job));
        }
        let (control, refused) = (opened.control, Arc::clone(&self.refused));
        let job = Box::new(move || run_commands(control, &command_receiver, &line, &refused));
        result = result.and_then(|()| (self.spawn)(&format!("usb-{port}-00"), job));
        if let Err(error) = result {
            self.unplug(port);
            return Event::Warning(Warning::Thread {
                port,
                reason: error.to_string(),
            });
        }
        Event::Attached { port, id }
    }

    fn unplug(&mut self, port: Port) -> Option<Event> {
        let device = self.devices.remove(&port)?;
        device.unplugged.store(true, Ordering::Relaxed);
        Some(Event::Detached { port })
    }
}

impl Transport for Live {
    fn next(&mut self, wait_ns: u64) -> Event {
        loop {
            let Ok(message) = self.messages.recv_timeout(Duration::from_nanos(wait_ns)) else {
                return Event::Idle;
            };
            if let Some(event) = self.take(message) {
                return event;
            }
        }
    }

    fn send(&mut self, port: Port, command: &Command) -> Result<(), TransportError> {
        let device = self
            .devices
            .get(&port)
            .ok_or(TransportError::NoDevice(port))?;
        device
            .commands
            .try_send(command.clone())
            .map_err(|error| match error {
                TrySendError::Full(_) => TransportError::Busy(port),
                TrySendError::Disconnected(_) => TransportError::NoDevice(port),
            })
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        for device in self.devices.values() {
            device.unplugged.store(true, Ordering::Relaxed);
        }
    }
}

/// What a device's threads have in common.
#[derive(Clone)]
struct Line {
    number: u64,
    port: Port,
    clock: SharedClock,
    messages: SyncSender<Message>,
}

impl Line {
    fn packet(&self, endpoint: u8, transfer: Transfer, data: Vec<u8>) -> Message {
        let (at, port) = (self.clock.now(), self.port);
        Message::Packet(
            self.number,
            Packet {
                at,
                port,
                endpoint,
                transfer,
                data,
            },
        )
    }
}

fn read_reports(mut input: Input, line: &Line, unplugged: &AtomicBool, dropped: &AtomicU64) {
    let mut buffer = [0; REPORT_BYTES_MAX];
    while !unplugged.load(Ordering::Relaxed) {
        match input.reader.read(&mut buffer, READ_TIMEOUT) {
            Ok(0) => {}
            Ok(length) => {
                let data = buffer[..length.min(REPORT_BYTES_MAX)].to_vec();
                let message = line.packet(input.endpoint, Transfer::Interrupt, data);
                match line.messages.try_send(message) {
                    Ok(()) => {}
                    Err(TrySendError::Full(_)) => {
                        dropped.fetch_add(1, Ordering::Relaxed);
                    }
                    Err(TrySendError::Disconnected(_)) => return,
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => {
                // Nobody to tell is as good as having told.
                let _ = line.messages.send(Message::Lost(line.number, line.port));
                return;
            }
        }
    }
}

fn run_commands(
    mut control: Box<dyn Control>,
    commands: &Receiver<Command>,
    line: &Line,
    refused: &AtomicU64,
) {
    for command in commands {
        let Ok((transfer, data)) = run_command(control.as_mut(), command) else {
            refused.fetch_add(1, Ordering::Relaxed);
            continue;
        };
        let endpoint = match transfer {
            Transfer::Control(setup) => setup.request_type & 0x80,
            _ => OUTPUT_ENDPOINT,
        };
        let message = line.packet(endpoint, transfer, data);
        if line.messages.send(message).is_err() {
            return;
        }
    }
}

/// Output reports are shown as if they had gone to this endpoint, whichever way they went.
const OUTPUT_ENDPOINT: u8 = 0x01;

/// Makes a transfer; returns it as a capture would hold it.
fn run_command(control: &mut dyn Control, command: Command) -> io::Result<(Transfer, Vec<u8>)> {
    let feature = |id: u8| u16::from(Setup::REPORT_FEATURE) << 8 | u16::from(id);
    match command {
        Command::SetFeature { interface, data } => {
            control.set_feature(interface, &data)?;
            let setup = Setup {
                request_type: 0x21,
                request: Setup::HID_SET_REPORT,
                value: feature(data.first().copied().unwrap_or(0)),
                index: u16::from(interface),
                length: data.len() as u16,
            };
            Ok((Transfer::Control(setup), data))
        }
        Command::Output { interface, data } => {
            control.output(interface, &data)?;
            Ok((Transfer::Interrupt, data))
        }
        Command::GetFeature {
            interface,
            id,
            length,
        } => {
            let mut data = vec![0; usize::from(length).max(1)];
            data[0] = id;
            let count = control.get_feature(interface, &mut data)?;
            data.truncate(count);
            let setup = Setup {
                request_type: 0xa1,
                request: Setup::HID_GET_REPORT,
                value: feature(id),
                index: u16::from(interface),
                length,
            };
            Ok((Transfer::Control(setup), data))
        }
    }
}

#[cfg(test)]
mod tests;
