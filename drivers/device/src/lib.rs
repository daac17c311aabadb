//! Devices: from USB bytes to samples.
//!
//! Transports ([`transport`]) deliver [`usb::Packet`]s; the catalogue ([`catalog`]) says which
//! [`decode::Decoder`] takes them; decoders are state machines without I/O, one folder a device
//! family; a [`rig::Rig`] joins them and hands out samples. Captures ([`capture`]) are read and
//! written here too, and the simulator ([`simulate`]) makes them.

pub mod capture;
pub mod catalog;
pub mod decode;
pub mod fusion;
pub mod haptic;
pub mod joycon;
pub mod lighthouse;
pub mod rig;
pub mod simulate;
pub mod slimevr;
pub mod transport;
pub mod trouble;
pub mod usb;
