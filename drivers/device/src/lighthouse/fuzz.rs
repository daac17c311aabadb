//! The entry point of fuzz targets.

use glam::{DQuat, DVec3};
use posed_signal::{HostTime, Sample};

use super::{
    Settings, Variant,
    base_station::{BaseStation, Source, parse_libsurvive},
    decoder::Device,
    inspect::{Inspector, Report},
    model::DeviceModel,
};
use crate::{
    decode::{Decoder, Emit, Identity},
    usb::{Packet, Port, Setup, Transfer},
};

/// A device with so few sensors that chance may find a pose for it.
const CONFIGURATION: &str = r#"{
    "device_class": "controller", "model_number": "Knuckles Left", "device_serial_number": "LHR-0",
    "lighthouse_config": {
        "modelPoints": [[0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0], [0, -0.05, 0], [0, 0, 0.05]],
        "modelNormals": [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    }
}"#;

/// Reads `data` as a base-station file, as a device's configuration and as the traffic of a
/// device, wired or by radio, whose configuration is known: each packet begins with its kind and
/// its length. Returns what was counted, so that nothing can be optimised away.
///
/// # Panics
/// A sample is not sound. That is what fuzzing looks for.
pub fn fuzz_entry(data: &[u8]) -> Report {
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = parse_libsurvive(text);
        let _ = DeviceModel::from_json(text);
    }
    let mut inspector = Inspector::new(None);
    let mut device = Device::new(
        Variant::Watchman,
        &Settings {
            base_stations: stations(),
            ..Settings::default()
        },
    );
    let mut sink = Sink;
    let known = device.configure(CONFIGURATION, &mut sink);
    assert!(
        known.is_ok(),
        "the configuration of the fuzzed device is sound"
    );
    let (mut rest, mut at, mut commands) = (data, HostTime(0), Vec::new());
    while let [kind, length, tail @ ..] = rest {
        let (bytes, next) = tail.split_at(tail.len().min(usize::from(*length % 66)));
        at = at.plus_ns(i64::from(*kind) << 12);
        let packet = packet(*kind, bytes, at);
        let _ = device.packet(&packet, &mut sink);
        inspector.packet(&packet);
        commands.clear();
        device.tick(at, &mut commands);
        assert!(commands.len() < 64, "a flood of commands");
        rest = next;
    }
    inspector.report()
}

fn packet(kind: u8, bytes: &[u8], at: HostTime) -> Packet {
    let report = u16::from_le_bytes([[0x01, 0x10, 0x11, 0xff][usize::from(kind >> 2 & 3)], 3]);
    let (transfer, endpoint) = match kind & 3 {
        0 => {
            let read = Setup {
                request_type: 0xa1,
                request: 1,
                value: report,
                index: 0,
                length: 64,
            };
            (Transfer::Control(read), 0x80)
        }
        1 if kind & 0x80 != 0 => {
            let write = Setup {
                request_type: 0x21,
                request: 9,
                value: report,
                index: 0,
                length: 64,
            };
            (Transfer::Control(write), 0)
        }
        _ => (Transfer::Interrupt, 0x81),
    };
    Packet {
        at,
        port: Port { bus: 1, address: 1 },
        endpoint,
        transfer,
        data: bytes.to_vec(),
    }
}

fn stations() -> Vec<BaseStation> {
    let station = |source: Source, x: f64| BaseStation {
        source,
        id: 1,
        position: DVec3::new(x, 2.0, 2.0),
        rotation: DQuat::IDENTITY,
        calibration: Default::default(),
    };
    vec![
        station(Source::Channel(0), 1.0),
        station(Source::Channel(6), -1.0),
        station(Source::Slot(0), 1.0),
        station(Source::Slot(1), -1.0),
    ]
}

struct Sink;

impl Emit for Sink {
    fn identity(&mut self, _unit: usize, _identity: Identity) {}

    fn sample(&mut self, _unit: usize, sample: Sample) {
        let sound = match sample {
            Sample::Imu(imu) => imu.accel.is_finite() && imu.gyro.is_finite(),
            Sample::Pose(pose) => pose.is_sound(),
            Sample::Buttons(state) => (0.0..=1.0).contains(&state.trigger),
            Sample::Battery(battery) => (0.0..=1.0).contains(&battery.charge),
            Sample::Orientation(_) | Sample::Radio(_) => false,
        };
        assert!(sound, "{sample:?}");
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Packets that look like a device's, with random content.
    fn traffic() -> impl Strategy<Value = Vec<u8>> {
        let report = prop::sample::select(vec![0x01u8, 0x20, 0x21, 0x23, 0x24, 0x25, 0x27, 0x28]);
        let packet = (
            any::<u8>(),
            report,
            prop::collection::vec(any::<u8>(), 0..64),
        )
            .prop_map(|(kind, report, bytes)| {
                [&[kind, bytes.len() as u8 + 1, report], &bytes[..]].concat()
            });
        prop::collection::vec(packet, 0..60).prop_map(|packets| packets.concat())
    }

    #[test]
    fn the_fuzzers_corpus_is_survived() {
        let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/lighthouse");
        let mut imu_samples = 0;
        for file in std::fs::read_dir(corpus).unwrap() {
            let data = std::fs::read(file.unwrap().path()).unwrap();
            imu_samples += fuzz_entry(&data).imu_samples;
            // Cut anywhere, and with any bit flipped.
            for at in (0..data.len()).step_by(997) {
                fuzz_entry(&data[..at]);
                let mut flipped = data.clone();
                flipped[at] ^= 1 << (at % 8);
                fuzz_entry(&flipped);
            }
        }
        assert!(
            imu_samples > 250,
            "the corpus holds devices that stream: {imu_samples}"
        );
    }

    proptest! {
        #[test]
        fn any_traffic_is_survived(data in traffic()) {
            prop_assert!(fuzz_entry(&data).packets as usize <= data.len());
        }

        #[test]
        fn any_bytes_are_survived(data in prop::collection::vec(any::<u8>(), 0..600)) {
            fuzz_entry(&data);
        }
    }
}
