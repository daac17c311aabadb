//! The entry point of fuzz targets.

use posed_signal::{HostTime, Sample};

use super::{
    decoder::Device,
    inspect::{Inspector, Report},
};
use crate::{
    decode::{Decoder as _, Emit, Identity},
    usb::{Packet, Port, Transfer},
};

/// Reads `data` as the traffic of a device: each report begins with its direction (bit 7) and
/// how long it took (bits 0-6), and its length. Returns what was counted, so that nothing can be
/// optimised away.
///
/// # Panics
/// A sample is not sound. That is what fuzzing looks for.
pub fn fuzz_entry(data: &[u8]) -> Report {
    let (mut device, mut inspector) = (Device::default(), Inspector::default());
    let (mut rest, mut at, mut commands) = (data, HostTime(0), Vec::new());
    while let [kind, length, tail @ ..] = rest {
        let (bytes, next) = tail.split_at(tail.len().min(usize::from(*length % 66)));
        at = at.plus_ns(i64::from(kind & 0x7f) << 20);
        let packet = Packet {
            at,
            port: Port { bus: 1, address: 1 },
            endpoint: if kind & 0x80 == 0 { 0x81 } else { 0x01 },
            transfer: Transfer::Interrupt,
            data: bytes.to_vec(),
        };
        let _ = device.packet(&packet, &mut Sink);
        inspector.packet(&packet);
        commands.clear();
        device.tick(at, &mut commands);
        assert!(commands.len() < 4, "a flood of commands");
        rest = next;
    }
    inspector.report()
}

struct Sink;

impl Emit for Sink {
    fn identity(&mut self, unit: usize, _identity: Identity) {
        assert_eq!(unit, 0);
    }

    fn sample(&mut self, unit: usize, sample: Sample) {
        let sound = match sample {
            Sample::Imu(imu) => imu.accel.is_finite() && imu.gyro.is_finite(),
            Sample::Orientation(orientation) => orientation.is_sound(),
            Sample::Battery(battery) => (0.0..=1.0).contains(&battery.charge),
            Sample::Buttons(buttons) => buttons.stick.iter().all(|axis| axis.abs() <= 1.0),
            Sample::Pose(_) | Sample::Radio(_) => false,
        };
        assert!(sound && unit == 0, "{sample:?}");
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Reports that look like a device's, with random content.
    fn traffic() -> impl Strategy<Value = Vec<u8>> {
        let ids = prop::sample::select(vec![0x01u8, 0x21, 0x30, 0x31, 0x3f, 0x81]);
        let report = (
            any::<bool>(),
            0u8..40,
            ids,
            prop::collection::vec(any::<u8>(), 0..50),
        );
        let bytes = report.prop_map(|(output, time, id, content)| {
            let mut bytes = vec![u8::from(output) << 7 | time, content.len() as u8 + 1, id];
            bytes.extend(content);
            bytes
        });
        prop::collection::vec(bytes, 0..40).prop_map(|reports| reports.concat())
    }

    proptest! {
        #[test]
        fn anything_is_survived(data in prop::collection::vec(any::<u8>(), 0..1_000)) {
            fuzz_entry(&data);
        }

        #[test]
        fn reports_with_any_content_are_survived(data in traffic()) {
            fuzz_entry(&data);
        }
    }

    #[test]
    fn the_fuzzers_corpus_is_survived() {
        let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/joycon");
        let mut samples = 0;
        for file in std::fs::read_dir(corpus).unwrap() {
            samples += fuzz_entry(&std::fs::read(file.unwrap().path()).unwrap()).imu_samples;
        }
        assert!(samples > 0, "the corpus holds a device that measures");
    }
}
