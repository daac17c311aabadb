//! Captures of USB traffic: read in any of the usual formats, written as usbmon or hid-recorder.
//!
//! [`open`] takes any [`std::io::Read`] and tells the format by content, never by name: classic
//! pcap and pcapng with link types 189 and 220 (usbmon) or 249 (USBPcap), and hid-recorder's text,
//! each also gzip'd. A [`CaptureReader`] streams: its memory does not grow with the file. What is
//! wrong with a file comes as a typed [`Warning`] among its packets, and costs nothing else.

pub mod identity;
mod reader;
mod usbmon_writer;

pub use reader::{CaptureError, CaptureReader, Item, Statistics, Warning, open};
pub use usbmon_writer::{UsbmonOptions, UsbmonWriter};
