//! Looks for devices, again and again, and opens those that are in the catalogue.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    sync::mpsc::{Receiver, RecvTimeoutError, SyncSender},
    time::Duration,
};

use super::{Warning, live::Message};
use crate::{
    catalog::Entry,
    usb::{Port, UsbId},
};

/// How often devices are looked for.
const SCAN_INTERVAL: Duration = Duration::from_secs(1);

/// A device of the catalogue that is plugged in.
#[derive(Clone, Copy)]
pub struct Found {
    /// Where.
    pub port: Port,
    /// What.
    pub id: UsbId,
    /// Its entry.
    pub entry: &'static Entry,
}

/// A device that has been opened.
pub struct Opened {
    /// For its control transfers.
    pub control: Box<dyn Control>,
    /// For its input reports.
    pub inputs: Vec<Input>,
}

/// An interrupt IN endpoint of an opened device.
pub struct Input {
    /// Its address.
    pub endpoint: u8,
    /// Reads it.
    pub reader: Box<dyn InputReader>,
}

/// Waits for input reports; used by one thread of its own.
pub trait InputReader: Send {
    /// Reads the next report into `buffer` and returns its length; 0 when none came within
    /// `timeout`.
    ///
    /// # Errors
    /// The device cannot be read any more.
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize>;
}

/// Makes control transfers; used by one thread of its own.
pub trait Control: Send {
    /// HID `SET_REPORT` of a feature report; `data` begins with the report id.
    ///
    /// # Errors
    /// The device refuses or has gone.
    fn set_feature(&mut self, interface: u8, data: &[u8]) -> io::Result<()>;

    /// An output report; `data` begins with the report id.
    ///
    /// # Errors
    /// The device refuses or has gone.
    fn output(&mut self, interface: u8, data: &[u8]) -> io::Result<()>;

    /// HID `GET_REPORT` of a feature report into `data`, whose first byte is the report id when
    /// asked and when answered; returns the answer's length.
    ///
    /// # Errors
    /// The device refuses or has gone.
    fn get_feature(&mut self, interface: u8, data: &mut [u8]) -> io::Result<usize>;
}

/// A way to reach devices.
pub trait Backend: Send {
    /// What people call it.
    fn name(&self) -> &'static str;

    /// Devices of the catalogue that are plugged in and reached this way.
    ///
    /// # Errors
    /// Devices cannot be listed.
    fn scan(&mut self) -> Result<Vec<Found>, Warning>;

    /// Opens one of them.
    ///
    /// # Errors
    /// The device cannot be opened (yet).
    fn open(&mut self, found: &Found) -> Result<Opened, Warning>;
}

/// What a scanner remembers from one look to the next.
pub(super) struct Scanner {
    backend: Box<dyn Backend>,
    messages: SyncSender<Message>,
    open: BTreeSet<Port>,
    failed: BTreeMap<Port, Warning>,
    /// The last thing said about devices as a whole.
    said: Option<Warning>,
}

/// The other end has gone: nobody wants to know any more.
struct NobodyListens;

impl Scanner {
    pub(super) fn new(backend: Box<dyn Backend>, messages: SyncSender<Message>) -> Self {
        let (open, failed) = (BTreeSet::new(), BTreeMap::new());
        Self {
            backend,
            messages,
            open,
            failed,
            said: None,
        }
    }

    /// Scans until the sending end of `lost` is dropped, through which come ports whose device
    /// could not be read any more.
    pub(super) fn run(mut self, lost: &Receiver<Port>) {
        while self.scan().is_ok() {
            loop {
                match lost.recv_timeout(SCAN_INTERVAL) {
                    // It is opened again if it is still there, but not in a tight loop.
                    Ok(port) => self.open.remove(&port),
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return,
                };
            }
        }
    }

    fn scan(&mut self) -> Result<(), NobodyListens> {
        let found = match self.backend.scan() {
            Ok(found) => found,
            Err(warning) => return self.say(Some(warning)),
        };
        let there: BTreeSet<Port> = found.iter().map(|found| found.port).collect();
        self.failed.retain(|port, _| there.contains(port));
        for port in self.open.difference(&there).copied().collect::<Vec<_>>() {
            self.open.remove(&port);
            self.send(Message::Unplugged(port))?;
        }
        for device in found {
            if !self.open.contains(&device.port) {
                self.open(device)?;
            }
        }
        let access = self.backend.name();
        self.say(there.is_empty().then_some(Warning::Waiting { access }))
    }

    fn open(&mut self, found: Found) -> Result<(), NobodyListens> {
        match self.backend.open(&found) {
            Ok(opened) => {
                self.failed.remove(&found.port);
                self.open.insert(found.port);
                self.send(Message::Plugged { found, opened })
            }
            Err(warning) => {
                let before = self.failed.insert(found.port, warning.clone());
                if before.as_ref() == Some(&warning) {
                    return Ok(());
                }
                self.send(Message::Warning(warning))
            }
        }
    }

    /// Says something about devices as a whole, unless it was said just before.
    fn say(&mut self, warning: Option<Warning>) -> Result<(), NobodyListens> {
        if warning == self.said {
            return Ok(());
        }
        self.said.clone_from(&warning);
        warning.map_or(Ok(()), |warning| self.send(Message::Warning(warning)))
    }

    fn send(&self, message: Message) -> Result<(), NobodyListens> {
        self.messages.send(message).map_err(|_| NobodyListens)
    }
}
