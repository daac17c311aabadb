//! Captures of USB traffic: read in any of the usual formats, written as usbmon or hid-recorder.
//!
//! [`open`] takes any [`std::io::Read`] and tells the format by content, never by name: classic
//! pcap and pcapng with link types 189 and 220 (usbmon) or 249 (USBPcap), hid-recorder's text,
//! libsurvive's recordings, and traces of the Joy-Con relay `joy`, each also gzip'd. A
//! [`CaptureReader`] streams: its memory does not grow with the file. What is wrong with a file comes
//! as a typed [`Warning`] among its packets, and costs nothing else.

mod hid_recorder;
mod hid_recorder_writer;
pub mod identity;
mod joy_trace;
mod lines;
mod pairing;
mod reader;
mod records;
mod report;
mod source;
mod survive_recording;
mod usbmon;
mod usbmon_writer;
mod usbpcap;

pub use hid_recorder_writer::HidRecorderWriter;
pub use lines::LINE_BYTES_MAX;
pub use pairing::PENDING_CONTROLS_MAX;
pub use reader::{CaptureReader, Item, open};
pub use records::RECORD_BYTES_MAX;
pub use report::{CaptureError, Statistics, Warning};
pub use survive_recording::{PoseLines, SurvivePose, SurvivePoses, survive_poses};
pub use usbmon_writer::{UsbmonOptions, UsbmonWriter};

/// Reads `data` as a capture to its end: the entry point of fuzz targets. Returns what was read,
/// so that nothing of it can be optimised away.
pub fn fuzz_entry(data: &[u8]) -> Statistics {
    let _ = survive_poses(data);
    let Ok(mut reader) = open(data) else {
        return Statistics::default();
    };
    for item in &mut reader {
        if let Item::Packet(packet) = item {
            assert!(
                packet.data.len() <= RECORD_BYTES_MAX,
                "a packet longer than its record"
            );
        }
    }
    reader.statistics()
}

#[cfg(test)]
pub(crate) mod tests;
