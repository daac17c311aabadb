//! The shared real captures: read without error, as many records as their list says.

use std::{
    env,
    fs::File,
    path::{Path, PathBuf},
};

use super::{
    super::{HidRecorderWriter, UsbmonOptions, UsbmonWriter, Warning, open},
    read, split,
};
use crate::usb::Packet;

/// What a capture holds: its path, records, duration in seconds (where the list has it), and
/// whether it is torn.
struct Expected(&'static str, u64, Option<f64>, bool);

/// `captures/SOURCES.md` counts the records of those from libsurvive; those of LighthouseRedox
/// were counted by walking the blocks of the files with a script.
const CAPTURES: &[Expected] = &[
    Expected(
        "lighthouse/vive-index-cal.pcap.gz",
        50_325,
        Some(19.6),
        false,
    ),
    Expected("lighthouse/lh2_test_cal.pcap.gz", 11_336, Some(18.9), false),
    Expected(
        "lighthouse/tracker-cal-attempt.pcap.gz",
        60_814,
        Some(61.6),
        false,
    ),
    Expected(
        "lighthouse/wireless-tracker.pcap.gz",
        12_388,
        Some(12.7),
        false,
    ),
    Expected(
        "lighthouse/tracker-gen1-wired-buttons.pcap.gz",
        4_436,
        Some(4.8),
        true,
    ),
    Expected(
        "lighthouse/tracker-gen2-buttons.pcap.gz",
        4_686,
        Some(6.8),
        false,
    ),
    Expected(
        "lighthouse/tracker-gen2-wired-buttons.pcap.gz",
        3_777,
        Some(5.2),
        false,
    ),
    Expected("lighthouse/vive_cal.pcap.gz", 80_666, Some(22.4), false),
    Expected(
        "lighthouse/wand-wired-all-buttons.pcap.gz",
        14_109,
        Some(17.7),
        false,
    ),
    Expected(
        "lighthouse/wand-all-buttons.pcap.gz",
        7_934,
        Some(13.2),
        false,
    ),
    Expected(
        "lighthouse/knuckles_all_buttons.pcap.gz",
        34_392,
        Some(35.6),
        false,
    ),
    Expected("lighthouse/index-lhv1.pcap.gz", 41_965, Some(11.1), false),
    Expected(
        "lighthouse/index-hmd-and-two-knuckles.pcap.gz",
        104_765,
        Some(23.0),
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wired--controller-lying-on",
        15_745,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wired--covering",
        28_785,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wired--klicking",
        7_647,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wired--plugging",
        6_060,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wired--testing",
        46_802,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wireless--klicking",
        5_751,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wireless--testing",
        39_042,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wireless--turning",
        2_489,
        None,
        false,
    ),
    Expected(
        "lighthouse-redox/controller-wireless--wireless",
        14_144,
        None,
        false,
    ),
    Expected("lighthouse-redox/system--01", 1_185, None, false),
    Expected("lighthouse-redox/system--02", 1_613, None, false),
    Expected("lighthouse-redox/system--03", 70_970, None, false),
    Expected("lighthouse-redox/system--04", 65_499, None, false),
    Expected("lighthouse-redox/system--05", 82_821, None, false),
    Expected("lighthouse-redox/system--07", 111, None, false),
    Expected("lighthouse-redox/system--08", 174, None, false),
];

/// The folder of the shared captures, where there is one.
pub(crate) fn captures() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = env::var_os("POSED_SHARED").map_or_else(beside, PathBuf::from);
    let captures = shared.join("captures");
    captures.is_dir().then_some(captures)
}

/// The one file whose path begins like this.
pub(crate) fn file(captures: &Path, prefix: &str) -> PathBuf {
    let (folder, name) = prefix.split_once('/').unwrap();
    let files = captures
        .join(folder)
        .read_dir()
        .unwrap()
        .map(|file| file.unwrap());
    let mut hits = files.filter(|f| f.file_name().to_string_lossy().starts_with(name));
    let hit = hits.next().unwrap_or_else(|| panic!("{prefix} is missing"));
    assert!(hits.next().is_none(), "{prefix} is ambiguous");
    hit.path()
}

#[test]
fn every_shared_capture_is_read() {
    let Some(captures) = captures() else {
        println!("SKIPPED (needs shared data): every_shared_capture_is_read");
        return;
    };
    for Expected(prefix, records, seconds, torn) in CAPTURES {
        let mut reader = open(File::open(file(&captures, prefix)).unwrap()).unwrap();
        let (packets, warnings) = split(&mut reader);
        let statistics = reader.statistics();
        assert_eq!(
            statistics.records - statistics.malformed,
            *records,
            "{prefix}"
        );
        assert_eq!(statistics.packets, packets.len() as u64);
        assert_eq!(
            (statistics.shortened, statistics.unpaired),
            (0, 0),
            "{prefix}"
        );
        let harmless = |warning: &Warning| matches!(warning, Warning::TrailingBytes { .. });
        if *torn {
            let corrupt = |warning: &Warning| matches!(warning, Warning::Corrupt { .. });
            assert!(warnings.iter().any(corrupt), "{prefix}: {warnings:?}");
        } else {
            assert!(warnings.iter().all(harmless), "{prefix}: {warnings:?}");
        }
        if let Some(seconds) = seconds {
            let (first, last) = (packets[0].at, packets[packets.len() - 1].at);
            let span = last.since_secs(first);
            assert!((span - seconds).abs() < 0.06, "{prefix}: {span} s");
        }
    }
}

#[test]
fn a_real_capture_is_the_same_when_written_again() {
    let Some(captures) = captures() else {
        println!("SKIPPED (needs shared data): a_real_capture_is_the_same_when_written_again");
        return;
    };
    let path = file(&captures, "lighthouse/wand-wired-all-buttons.pcap.gz");
    let (packets, _) = split(&mut open(File::open(path).unwrap()).unwrap());
    for (gzip, submissions) in [(false, false), (true, true)] {
        let options = UsbmonOptions { gzip, submissions };
        let mut writer = UsbmonWriter::new(Vec::new(), options).unwrap();
        packets
            .iter()
            .for_each(|packet| writer.packet(packet).unwrap());
        assert!(read(&writer.finish().unwrap()) == (packets.clone(), Vec::new()));
    }
    let mut writer = HidRecorderWriter::new(Vec::new());
    packets
        .iter()
        .for_each(|packet| writer.packet(packet).unwrap());
    let (again, warnings) = read(&writer.finish().unwrap());
    assert_eq!((again.len(), warnings.len()), (packets.len(), 0));
    for (again, packet) in again.iter().zip(&packets) {
        // The text counts its time from the first packet.
        let at = posed_signal::HostTime(packet.at.0 - packets[0].at.0);
        assert!(
            *again
                == Packet {
                    at,
                    ..packet.clone()
                },
            "{again:?}"
        );
    }
}
