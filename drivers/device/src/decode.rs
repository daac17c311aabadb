//! What every decoder is: bytes in, samples out, no I/O, no clock.

use posed_signal::{HostTime, Role, Sample, Serial};

use crate::{haptic::Haptic, trouble::Trouble, usb::Packet};

/// At most this many tracked devices hang on one USB device (a dongle pairs with one, a receiver
/// for inertial trackers with many).
pub const UNITS_MAX: usize = 16;

/// Why a packet could not be decoded. The packet is dropped and counted; the decoder goes on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The report ends too early.
    #[error("report 0x{id:02x} is {got} bytes long, at least {needed} are needed")]
    TooShort {
        /// Report id.
        id: u8,
        /// Bytes there are.
        got: usize,
        /// Bytes there have to be.
        needed: usize,
    },
    /// The report's content contradicts itself.
    #[error("report 0x{id:02x}: {what}")]
    Malformed {
        /// Report id.
        id: u8,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The device's configuration cannot be used.
    #[error("device configuration: {0}")]
    Configuration(String),
}

/// What a decoder knows about a tracked device once it has seen its configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Identity {
    /// Serial number.
    pub serial: Serial,
    /// Product name, for people.
    pub model: &'static str,
    /// What the device is made for: a headset's is [`Role::Head`], a left controller's
    /// [`Role::LeftHand`], a tracker's [`Role::None`].
    pub natural_role: Role,
    /// Whether it can buzz.
    pub has_haptics: bool,
}

/// Where decoders put what they find. `unit` counts the tracked devices behind one USB device.
pub trait Emit {
    /// The configuration of a unit became known, or changed.
    fn identity(&mut self, unit: usize, identity: Identity);
    /// A sample, in host time.
    fn sample(&mut self, unit: usize, sample: Sample);
}

/// A request to the device that a decoder wants sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Command {
    /// HID `SET_REPORT` of a feature report; the first byte is the report id.
    SetFeature {
        /// Interface number.
        interface: u8,
        /// Report id and data.
        data: Vec<u8>,
    },
    /// HID `GET_REPORT` of a feature report; the answer comes back as a control [`Packet`].
    GetFeature {
        /// Interface number.
        interface: u8,
        /// Report id.
        id: u8,
        /// Bytes to ask for, report id included.
        length: u16,
    },
    /// An output report; it comes back as the interrupt [`Packet`] that a capture would hold.
    Output {
        /// Interface number.
        interface: u8,
        /// Report id and data.
        data: Vec<u8>,
    },
}

/// A decoder of one USB device: a state machine without I/O.
pub trait Decoder: Send {
    /// Takes one finished transfer of the device, in the order of time.
    ///
    /// # Errors
    /// The packet is not what the protocol says; it is lost, the decoder's state stays usable.
    fn packet(&mut self, packet: &Packet, out: &mut dyn Emit) -> Result<(), DecodeError>;

    /// Called at least ten times a second with the present time: what to send to the device now.
    /// Start-up requests, retries and keep-alives live here, so that nothing depends on who reads
    /// the device, or how.
    fn tick(&mut self, now: HostTime, commands: &mut Vec<Command>);

    /// Adds what keeps a unit from being tracked well, now.
    fn troubles(&self, _unit: usize, _troubles: &mut Vec<Trouble>) {}

    /// Has a unit buzz: adds what to send to it. `false` where it cannot.
    fn buzz(&mut self, _unit: usize, _haptic: &Haptic, _commands: &mut Vec<Command>) -> bool {
        false
    }
}
