//! Transports deliver packets: live through hidraw or libusb, from captures, or simulated.
//!
//! None of them spawns threads or reads the clock: the daemon hands them a [`Clock`] and a way to
//! run a reader.
//!
//! [`Clock`]: posed_signal::Clock

mod replay;

pub use replay::{Merge, Recording, Replay};

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
}

/// Why a command was not sent.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The device has gone.
    #[error("there is no device on port {0}")]
    NoDevice(Port),
}

/// A source of packets, and the way of commands to the devices.
pub trait Transport: Send {
    /// The next event; waits `wait_ns` at most where it has to wait at all. Replays never wait:
    /// whoever wants real speed holds a packet back until its time has come.
    fn next(&mut self, wait_ns: u64) -> Event;

    /// Sends a command to a device. The answer, if any, comes as a control [`Packet`], just as
    /// captures hold it.
    ///
    /// # Errors
    /// The device has gone or refuses; the transport goes on.
    fn send(&mut self, port: Port, command: &Command) -> Result<(), TransportError>;
}
