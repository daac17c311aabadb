//! Damaged captures: whatever is in a file, it is read as far as it makes sense, in bounded memory.

use std::{fs, io::Write, path::Path};

use flate2::{Compression, write::GzEncoder};
use proptest::prelude::*;

use super::{
    super::{Item, PENDING_CONTROLS_MAX, RECORD_BYTES_MAX, Warning, fuzz_entry, open},
    build::{UsbPcap, Usbmon, enhanced, interface, pcap, section},
    read,
};

const SETUP: [u8; 8] = [0xa1, 1, 0x10, 3, 0, 0, 64, 0];

/// One capture of each kind, small enough to be damaged everywhere.
fn seeds() -> Vec<Vec<u8>> {
    let urbs = [
        Usbmon::control(b'S', 7, 0x80, Some(SETUP)),
        Usbmon::control(b'C', 7, 0x80, None).data(&[0x10; 64]),
        Usbmon::interrupt(&[0x20; 52]),
        Usbmon::control(b'S', 9, 0x00, Some(SETUP)).data(&[4, 1]),
    ];
    let stamped = |records: Vec<Vec<u8>>| (5_000_000..).zip(records).collect::<Vec<_>>();
    let long = pcap(220, &stamped(urbs.iter().map(Usbmon::long).collect()));
    let short = pcap(189, &stamped(urbs.iter().map(Usbmon::short).collect()));
    let irp = |completed, stage, data| {
        let (endpoint, transfer) = (0x80, if stage == Some(9) { 1 } else { 2 });
        UsbPcap {
            irp: 5,
            completed,
            endpoint,
            transfer,
            stage,
            data,
        }
        .bytes()
    };
    let irps = [
        irp(false, Some(0), &SETUP[..]),
        irp(true, Some(1), &[1; 64]),
    ];
    let blocks = irps
        .iter()
        .zip(1..)
        .map(|(irp, time)| enhanced(0, time, irp));
    let pcapng = [vec![section(), interface(249, Some(9))], blocks.collect()]
        .concat()
        .concat();
    let text = b"N: x\nI: 3 28de 2101\nE: 000000.000000 2 23 0a\nE: 000000.000001 2 23 0b\n";
    let gzip = |bytes: &[u8]| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let packed = [gzip(&long), gzip(&pcapng)];
    [
        vec![
            long,
            short,
            pcap(249, &stamped(irps.to_vec())),
            pcapng,
            text.to_vec(),
        ],
        packed.to_vec(),
    ]
    .concat()
}

#[derive(Debug, Clone)]
enum Damage {
    Cut(prop::sample::Index),
    Flip(prop::sample::Index, u8),
    /// An absurd length, or what looks like one.
    Word(prop::sample::Index, u32),
    Insert(prop::sample::Index, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    let words = prop_oneof![
        Just(u32::MAX),
        Just(u32::MAX - 4),
        Just(i32::MAX as u32),
        Just(RECORD_BYTES_MAX as u32),
        any::<u32>(),
    ];
    prop_oneof![
        at().prop_map(Damage::Cut),
        (at(), 0..8u8).prop_map(|(at, bit)| Damage::Flip(at, bit)),
        (at(), words).prop_map(|(at, word)| Damage::Word(at, word)),
        (at(), prop::collection::vec(any::<u8>(), 0..40)).prop_map(|(at, b)| Damage::Insert(at, b)),
    ]
}

impl Damage {
    fn apply(self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            return;
        }
        match self {
            Self::Cut(at) => bytes.truncate(at.index(bytes.len())),
            Self::Flip(at, bit) => {
                let at = at.index(bytes.len());
                bytes[at] ^= 1 << bit;
            }
            Self::Word(at, word) => {
                let at = at.index(bytes.len());
                bytes
                    .iter_mut()
                    .skip(at)
                    .zip(word.to_le_bytes())
                    .for_each(|(b, w)| *b = w);
            }
            Self::Insert(at, more) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, more);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    #[test]
    fn damaged_captures_are_read_to_an_end(
        seed in 0..seeds().len(),
        damages in prop::collection::vec(damage(), 1..6),
    ) {
        let mut bytes = seeds().swap_remove(seed);
        damages.into_iter().for_each(|damage| damage.apply(&mut bytes));
        fuzz_entry(&bytes);
    }

    #[test]
    fn random_bytes_behind_any_magic_are_read_to_an_end(
        seed in 0..seeds().len(),
        kept in 0..64usize,
        bytes in prop::collection::vec(any::<u8>(), 0..600),
    ) {
        let seed = seeds().swap_remove(seed);
        fuzz_entry(&[&seed[..kept.min(seed.len())], &bytes].concat());
    }

    #[test]
    fn cutting_costs_only_what_comes_after(
        seed in 0..seeds().len(),
        cut in any::<prop::sample::Index>(),
    ) {
        let whole = seeds().swap_remove(seed);
        let cut = &whole[..cut.index(whole.len())];
        let (all, _) = read(&whole);
        let Ok(reader) = open(cut) else { return Ok(()) };
        let mut packets = Vec::new();
        for item in reader {
            if let Item::Packet(packet) = item {
                packets.push(packet);
            }
        }
        prop_assert_eq!(&packets[..], &all[..packets.len()]);
    }
}

#[test]
fn a_cut_file_says_where() {
    let records: Vec<_> = (0..4)
        .map(|n| (n, Usbmon::interrupt(&[0x20; 52]).long()))
        .collect();
    let whole = pcap(220, &records);
    let cut = &whole[..whole.len() - 1];
    let (packets, warnings) = read(cut);
    assert_eq!(packets.len(), 3);
    assert_eq!(
        warnings,
        [Warning::CutOff {
            at_byte: cut.len() as u64
        }]
    );
    let between = &whole[..whole.len() - 16 - 64 - 52];
    assert_eq!(
        read(between).1,
        [],
        "nothing shows that a file lacks whole records"
    );
}

#[test]
fn an_absurd_length_ends_the_reading_there() {
    let mut file = pcap(220, &[(0, Usbmon::interrupt(&[1]).long())]);
    file.extend([0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 0xff, 0x7f, 1, 0, 0, 0]);
    file.extend(vec![0; 2 * RECORD_BYTES_MAX]);
    let (packets, warnings) = read(&file);
    assert_eq!(packets.len(), 1);
    assert_eq!(warnings, [Warning::RecordTooLong { record: 1 }]);
}

#[test]
fn controls_that_never_end_are_forgotten() {
    let begin = |id| (0, Usbmon::control(b'S', id, 0x80, Some(SETUP)).long());
    let mut records: Vec<_> = (0..PENDING_CONTROLS_MAX as u64 + 9).map(begin).collect();
    records.push((0, Usbmon::control(b'C', 3, 0x80, None).data(&[1]).long()));
    let last = PENDING_CONTROLS_MAX as u64 + 8;
    records.push((0, Usbmon::control(b'C', last, 0x80, None).data(&[2]).long()));
    let (packets, warnings) = read(&pcap(220, &records));
    let data: Vec<_> = packets.into_iter().map(|packet| packet.data).collect();
    assert_eq!((data, warnings), (vec![vec![2]], vec![Warning::Unfinished]));
}

/// What a fuzzer once found worth keeping stays worth reading.
#[test]
fn the_fuzzers_corpus_is_read_to_an_end() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/capture");
    let files: Vec<_> = fs::read_dir(&corpus)
        .unwrap()
        .map(|file| file.unwrap().path())
        .collect();
    assert!(
        files.len() >= 20,
        "{} holds {} files",
        corpus.display(),
        files.len()
    );
    for path in files {
        let bytes = fs::read(path).unwrap();
        fuzz_entry(&bytes);
        crate::rig::fuzz_entry(&bytes);
    }
}
