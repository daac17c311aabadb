//! Transports deliver packets: live through hidraw or libusb, from captures, or simulated.
//!
//! None of them spawns threads or reads the clock: the daemon hands [`Live`] a [`Clock`] and a
//! way to run a reader, and paces [`Replay`].
//!
//! [`Clock`]: posed_signal::Clock

mod hidraw;
mod live;
mod replay;
mod scan;
mod usb;

pub use hidraw::Hidraw;
pub use live::{Job, Live, Spawn};
pub use replay::{Merge, Recording, Replay};
pub use scan::{Backend, Control, Found, Input, InputReader, Opened};
pub use usb::Usb;

use crate::{
    capture,
    decode::Command,
    usb::{Packet, Port, UsbId},
};

/// What happened on a transport.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A device is there, or what it is became known.
    Attached {
        /// Where.
        port: Port,
        /// What.
        id: UsbId,
    },
    /// A device was unplugged.
    Detached {
        /// Where it was.
        port: Port,
    },
    /// A finished transfer.
    Packet(Packet),
    /// Nothing happened within the time given.
    Idle,
    /// There will be nothing more: a replay's end.
    End,
    /// Something that people should know; the transport goes on.
    Warning(Warning),
}

/// Something that people should know about a transport that goes on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Warning {
    /// About a capture.
    #[error("{name}: {warning}")]
    Capture {
        /// The capture's name.
        name: String,
        /// What is wrong with it.
        warning: capture::Warning,
    },
    /// There is nothing to read from, yet.
    #[error("no device that posed knows is reachable through {access}; waiting for one")]
    Waiting {
        /// How it was looked for.
        access: &'static str,
    },
    /// Devices cannot even be listed.
    #[error("devices cannot be listed through {access}: {reason}; trying again")]
    Listing {
        /// How it was looked for.
        access: &'static str,
        /// What the library said.
        reason: String,
    },
    /// The user may not open a device.
    #[error(
        "{name} on port {port} may not be opened by this user: put systemd/70-posed.rules into \
         /etc/udev/rules.d, run `udevadm control --reload`, and plug the device in again"
    )]
    Permission {
        /// The device's name in the catalogue.
        name: &'static str,
        /// Where it is.
        port: Port,
    },
    /// A device cannot be opened.
    #[error("{name} on port {port} cannot be opened: {reason}; trying again")]
    Open {
        /// The device's name in the catalogue.
        name: &'static str,
        /// Where it is.
        port: Port,
        /// What the library said.
        reason: String,
    },
    /// There is no thread for a device.
    #[error("port {port} cannot be read: no thread for it: {reason}")]
    Thread {
        /// Where it is.
        port: Port,
        /// What the operating system said.
        reason: String,
    },
}

/// Why a command was not sent.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// The device has gone.
    #[error("there is no device on port {0}")]
    NoDevice(Port),
    /// Too many commands wait for the device already.
    #[error("the device on port {0} does not keep up with its commands")]
    Busy(Port),
}

/// A source of packets, and the way of commands to the devices.
pub trait Transport: Send {
    /// The next event; waits `wait_ns` at most where it has to wait at all. Replays never wait:
    /// whoever wants real speed holds a packet back until its time has come.
    fn next(&mut self, wait_ns: u64) -> Event;

    /// Sends a command to a device. The answer, if any, comes as a control [`Packet`], just as
    /// captures hold it; a device that refuses gives none.
    ///
    /// # Errors
    /// The device has gone, or does not keep up; the transport goes on.
    fn send(&mut self, port: Port, command: &Command) -> Result<(), TransportError>;
}
