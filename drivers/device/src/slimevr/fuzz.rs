//! The entry point of fuzz targets.

use posed_signal::{HostTime, Sample};

use super::{
    decoder::Receiver,
    inspect::{Inspector, Report},
    wire::REPORT_BYTES,
};
use crate::{
    decode::{Decoder as _, Emit, Identity, UNITS_MAX},
    usb::{Packet, Port, Transfer},
};

/// Reads `data` as reports of a receiver, one after the other, the last one cut off. Returns what
/// was counted, so that nothing can be optimised away.
///
/// # Panics
/// A sample is not sound. That is what fuzzing looks for.
pub fn fuzz_entry(data: &[u8]) -> Report {
    let (mut receiver, mut inspector) = (Receiver::default(), Inspector::default());
    for (index, report) in data.chunks(REPORT_BYTES).enumerate() {
        let packet = Packet {
            at: HostTime(index as u64 * 3_000_000),
            port: Port { bus: 1, address: 1 },
            endpoint: 0x81,
            transfer: Transfer::Interrupt,
            data: report.to_vec(),
        };
        let _ = receiver.packet(&packet, &mut Sink);
        inspector.packet(&packet);
    }
    inspector.report()
}

struct Sink;

impl Emit for Sink {
    fn identity(&mut self, unit: usize, _identity: Identity) {
        assert!(unit < UNITS_MAX);
    }

    fn sample(&mut self, unit: usize, sample: Sample) {
        let sound = match sample {
            Sample::Orientation(orientation) => orientation.is_sound(),
            Sample::Battery(battery) => (0.0..=1.0).contains(&battery.charge),
            Sample::Radio(radio) => radio.rssi_dbm.is_none_or(|dbm| dbm <= 0.0),
            Sample::Buttons(_) => true,
            Sample::Imu(_) | Sample::Pose(_) => false,
        };
        assert!(sound && unit < UNITS_MAX, "{sample:?}");
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn anything_is_survived(data in prop::collection::vec(any::<u8>(), 0..1_000)) {
            fuzz_entry(&data);
        }

        #[test]
        fn any_packets_are_survived(
            packets in prop::collection::vec((0u8..9, any::<[u8; 15]>()), 0..64),
        ) {
            let bytes: Vec<u8> = packets.iter().flat_map(|(kind, rest)| {
                std::iter::once(*kind).chain(*rest)
            }).collect();
            fuzz_entry(&bytes);
        }
    }

    #[test]
    fn the_fuzzers_corpus_is_survived() {
        let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/slimevr");
        let mut motions = 0;
        for file in std::fs::read_dir(corpus).unwrap() {
            let report = fuzz_entry(&std::fs::read(file.unwrap().path()).unwrap());
            motions += report.trackers.values().map(|t| t.motions).sum::<u64>();
        }
        assert!(motions > 0, "the corpus holds trackers that move");
    }
}
