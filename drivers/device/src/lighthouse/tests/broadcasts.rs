//! What base stations say about themselves in the shared captures, against what libsurvive noted.

use std::collections::BTreeMap;

use super::{
    super::{
        base_station::{BaseStation, parse_libsurvive},
        light::{Light, Seen},
        ootx::Broadcast,
        reader::Reader,
        reproject::PlaneCalibration,
    },
    captures::{captures, packets},
};

/// What was heard, by serial number: seconds after the capture's begin, and what.
fn heard(path: &std::path::Path) -> BTreeMap<u32, (f64, Broadcast)> {
    let mut devices = BTreeMap::<_, (Reader, Light)>::new();
    let (mut events, mut heard) = (Vec::new(), BTreeMap::new());
    let packets = packets(path);
    let begin = packets[0].at;
    for packet in &packets {
        let (reader, light) = devices.entry(packet.port).or_default();
        let _ = reader.packet(packet, &mut events);
        for event in events.drain(..) {
            light.event(&event, &mut |seen| {
                if let Seen::Broadcast(_, broadcast) = seen {
                    let at = packet.at.since_secs(begin);
                    heard.entry(broadcast.id).or_insert((at, broadcast));
                }
            });
        }
    }
    heard
}

/// Calibrations agree: files keep six decimals.
fn same(broadcast: &Broadcast, station: &BaseStation) -> bool {
    let fields = |plane: &PlaneCalibration| {
        [
            plane.phase,
            plane.tilt,
            plane.curve,
            plane.gibphase,
            plane.gibmag,
            plane.ogeephase,
            plane.ogeemag,
        ]
    };
    let planes = broadcast.calibration.iter().zip(&station.calibration);
    planes
        .flat_map(|(a, b)| fields(a).into_iter().zip(fields(b)))
        .all(|(a, b)| (a - b).abs() < 2e-6)
}

/// Captures and files from libsurvive-extras-data: both generations, generation 2 by cable and by radio.
/// A generation-1 tracker by radio (wireless-tracker) reports a third of the flashes: too few bits.
#[test]
fn base_stations_say_what_libsurvive_noted() {
    let Some(captures) = captures("base_stations_say_what_libsurvive_noted") else {
        return;
    };
    for (name, count, seconds) in [
        ("vive-index-cal", 2, 20.0),
        ("index-hmd-and-two-knuckles", 2, 20.0),
        ("tracker-cal-attempt", 4, 20.0),
        ("vive_cal", 2, 20.0),
    ] {
        let capture = format!("{name}.pcap.gz");
        let heard = heard(&captures.join(&capture));
        let text = std::fs::read_to_string(captures.join(format!("{name}.json"))).unwrap();
        let stations = parse_libsurvive(&text).unwrap();
        assert_eq!(stations.len(), count, "{capture}");
        for station in &stations {
            let (at, broadcast) = heard.get(&station.id).unwrap_or_else(|| {
                panic!("{capture}: {:08x} was not heard: {heard:?}", station.id)
            });
            println!("{capture}: {:08x} heard after {at:.1} s", station.id);
            assert!(*at < seconds, "{capture}: {at} s");
            assert!(
                same(broadcast, station),
                "{capture}: {broadcast:?} {station:?}"
            );
            assert!(broadcast.up.y > 0.5, "{capture}: {broadcast:?}");
        }
    }
}
