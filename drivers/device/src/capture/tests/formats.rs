//! Each format's own ways, on captures made by hand.

use posed_signal::HostTime;

use super::{
    super::{CaptureError, Item, LINE_BYTES_MAX, Warning, open},
    build::{UsbPcap, Usbmon, enhanced, interface, pcap, section},
    read, split,
};
use crate::usb::{Packet, Port, Setup, Transfer, UsbId};

const GET_FEATURE: [u8; 8] = [0xa1, 1, 0x10, 3, 0, 0, 64, 0];
const SET_FEATURE: [u8; 8] = [0x21, 9, 0x04, 3, 0, 0, 2, 0];

fn stamped(records: Vec<Vec<u8>>) -> Vec<(u64, Vec<u8>)> {
    (1_000_000..).zip(records).collect()
}

fn transfers(packets: &[Packet]) -> Vec<(Transfer, u8, &[u8])> {
    packets
        .iter()
        .map(|p| (p.transfer, p.endpoint, &p.data[..]))
        .collect()
}

#[test]
fn usbmon_joins_the_halves_of_control_transfers() {
    let records = [
        Usbmon::control(b'S', 7, 0x80, Some(GET_FEATURE)),
        Usbmon::interrupt(&[0x20, 1]),
        Usbmon::control(b'S', 8, 0x00, Some(SET_FEATURE)).data(&[4, 1]),
        Usbmon::control(b'C', 8, 0x00, None),
        Usbmon::control(b'C', 7, 0x80, None).data(&[0x10, 2, 3]),
        // Refused, failed to be submitted, and begun before the capture.
        Usbmon::control(b'S', 9, 0x80, Some(GET_FEATURE)),
        Usbmon::control(b'C', 9, 0x80, None).status(-32),
        Usbmon::control(b'S', 10, 0x80, Some(GET_FEATURE)),
        Usbmon::control(b'E', 10, 0x80, None).status(-19),
        Usbmon::control(b'C', 11, 0x80, None).data(&[1]),
    ];
    let [get, set] = [GET_FEATURE, SET_FEATURE].map(|s| Transfer::Control(Setup::from_bytes(s)));
    let expected: [(Transfer, u8, &[u8]); 3] = [
        (Transfer::Interrupt, 0x81, &[0x20, 1]),
        (set, 0x00, &[4, 1]),
        (get, 0x80, &[0x10, 2, 3]),
    ];
    for (link, layout) in [
        (189, Usbmon::short as fn(&Usbmon) -> _),
        (220, Usbmon::long),
    ] {
        let file = pcap(link, &stamped(records.iter().map(layout).collect()));
        let mut reader = open(&file[..]).unwrap();
        let (packets, warnings) = split(&mut reader);
        assert_eq!(transfers(&packets), expected, "link type {link}");
        assert_eq!(warnings, []);
        assert_eq!(packets[0].at, HostTime(1_000_001_000));
        let port = Port {
            bus: Usbmon::BUS,
            address: u16::from(Usbmon::ADDRESS),
        };
        assert!(packets.iter().all(|packet| packet.port == port));
        let statistics = reader.statistics();
        assert_eq!((statistics.records, statistics.packets), (10, 3));
        assert_eq!((statistics.failed, statistics.unpaired), (2, 1));
    }
}

#[test]
fn usbmon_with_the_wrong_header_gives_what_is_left_of_the_data() {
    let data: Vec<u8> = (0..52).collect();
    let mut record = Usbmon::interrupt(&data).long();
    record.truncate(48 + data.len());
    let (packets, warnings) = read(&pcap(189, &stamped(vec![record; 2])));
    assert_eq!(packets.len(), 2);
    assert!(packets.iter().all(|packet| packet.data == data[..36]));
    assert_eq!(warnings, [Warning::WrongHeader]);
    let honest = Usbmon::interrupt(&data).short();
    let (packets, warnings) = read(&pcap(189, &stamped(vec![honest])));
    assert_eq!((packets[0].data.len(), warnings.len()), (52, 0));
}

#[test]
fn records_shorter_than_they_say_are_given_as_they_are() {
    let mut cut = Usbmon::interrupt(&[1, 2, 3, 4]).long();
    cut.truncate(cut.len() - 1);
    let (packets, warnings) = read(&pcap(220, &stamped(vec![cut, vec![0; 10]])));
    assert_eq!(packets[0].data, [1, 2, 3]);
    assert_eq!(warnings, [Warning::Shortened, Warning::Malformed]);
}

fn usbpcap(irp: u64, completed: bool, endpoint: u8, stage: Option<u8>, data: &[u8]) -> Vec<u8> {
    let transfer = if stage.is_some() { 2 } else { 1 };
    UsbPcap {
        irp,
        completed,
        endpoint,
        transfer,
        stage,
        data,
    }
    .bytes()
}

#[test]
fn usbpcap_joins_the_stages_of_control_transfers() {
    let old = [
        usbpcap(1, false, 0x00, Some(0), &GET_FEATURE),
        usbpcap(1, true, 0x80, Some(1), &[0x10, 5]),
        usbpcap(1, true, 0x80, Some(2), &[]),
        usbpcap(2, false, 0x00, Some(0), &SET_FEATURE),
        usbpcap(2, true, 0x00, Some(1), &[4, 1]),
        usbpcap(2, true, 0x00, Some(2), &[]),
        // A submission of an interrupt read, then its completion.
        usbpcap(3, false, 0x81, None, &[]),
        usbpcap(3, true, 0x81, None, &[0x20, 9]),
    ];
    let new = [
        usbpcap(1, false, 0x80, Some(0), &GET_FEATURE),
        usbpcap(1, true, 0x80, Some(3), &[0x10, 5]),
        usbpcap(
            2,
            false,
            0x00,
            Some(0),
            &[&SET_FEATURE[..], &[4, 1]].concat(),
        ),
        usbpcap(2, true, 0x00, Some(3), &[]),
        usbpcap(3, true, 0x81, None, &[0x20, 9]),
    ];
    let [get, set] = [GET_FEATURE, SET_FEATURE].map(|s| Transfer::Control(Setup::from_bytes(s)));
    let expected: [(Transfer, u8, &[u8]); 3] = [
        (get, 0x80, &[0x10, 5]),
        (set, 0x00, &[4, 1]),
        (Transfer::Interrupt, 0x81, &[0x20, 9]),
    ];
    for records in [&old[..], &new[..]] {
        let (packets, warnings) = read(&pcap(249, &stamped(records.to_vec())));
        assert_eq!(transfers(&packets), expected);
        assert_eq!(warnings, []);
        assert_eq!(
            packets[0].port,
            Port {
                bus: 1,
                address: 49
            }
        );
    }
}

#[test]
fn pcapng_times_follow_the_interfaces_resolution() {
    let record = Usbmon::interrupt(&[1]).long();
    let file = [
        section(),
        interface(220, None),
        interface(1, None),
        interface(220, Some(9)),
        interface(220, Some(0x80 | 10)),
        enhanced(0, 5_000_000, &record),
        enhanced(1, 0, &[0; 60]),
        enhanced(2, 5_000_000_001, &record),
        enhanced(3, 5 * 1_024 + 512, &record),
        enhanced(9, 0, &record),
        // A new section begins anew.
        section(),
        interface(220, None),
        enhanced(0, 7_000_000, &record),
    ]
    .concat();
    let mut reader = open(&file[..]).unwrap();
    let (packets, warnings) = split(&mut reader);
    let times: Vec<_> = packets.iter().map(|packet| packet.at.0).collect();
    assert_eq!(
        times,
        [5_000_000_000, 5_000_000_001, 5_500_000_000, 7_000_000_000]
    );
    assert_eq!(
        warnings,
        [Warning::LinkType { link: 1 }, Warning::NoInterface]
    );
    assert_eq!(reader.statistics().records, 4);
}

#[test]
fn what_is_no_capture_of_usb_is_refused_with_a_reason() {
    let error = |bytes: &[u8]| open(bytes).err().map(|error| error.to_string()).unwrap();
    assert!(error(b"").contains("empty"));
    assert!(error(&pcap(1, &[])).contains("link type 1 is not USB"));
    assert!(error(b"\x7fELF\x02\x01\x01\0\0").contains("7f454c4602010100"));
    assert!(error(&pcap(220, &[])[..10]).contains("header"));
    let big_endian = [
        0xa1, 0xb2, 0xc3, 0xd4, 0, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0,
    ];
    let usbmon = [&big_endian[..], &[0, 0, 0, 220]].concat();
    assert!(matches!(
        open(&usbmon[..]).err(),
        Some(CaptureError::LinkType { link: 220 })
    ));
    assert!(error(b"once upon a time\r\n").contains("no capture format begins with"));
}

#[test]
fn hid_recorder_text_of_other_tools_is_read() {
    let text = "# Valve Software\r\n\
        R: 4 06 00 ff 09\r\n\
        N: Valve Software Watchman\n\
        P: usb-0000:00:14.0-1/input0\n\
        I: 3 28de 2101\n\
        Q: something new\n\
        E: 000000.000000 2 23 0a\n\
        D: 1\n\
        I: 3 28de 2000\n\
        E: 000001.000250 3 20 ff 07\n\
        E: 1.5 1 00\n\
        E: 000002.000000 9 20\n\
        D: 0\n\
        E: 000003.000000 1 24";
    let mut reader = open(text.as_bytes()).unwrap();
    let items: Vec<_> = reader.by_ref().collect();
    let packet = |micros: u64, address, data: &[u8]| {
        Item::Packet(Packet {
            at: HostTime(micros * 1_000),
            port: Port { bus: 0, address },
            endpoint: 0x81,
            transfer: Transfer::Interrupt,
            data: data.to_vec(),
        })
    };
    let device =
        |address, product| Item::Device(Port { bus: 0, address }, UsbId::new(0x28de, product));
    let expected = [
        device(1, 0x2101),
        packet(0, 1, &[0x23, 0x0a]),
        device(2, 0x2000),
        packet(1_000_250, 2, &[0x20, 0xff, 7]),
        Item::Warning(Warning::Line { line: 11 }),
        packet(3_000_000, 1, &[0x24]),
    ];
    assert_eq!(items, expected);
    assert_eq!(reader.statistics().malformed, 2);
}

#[test]
fn absurdly_long_lines_are_skipped() {
    let text = format!(
        "# {}\nE: 000000.000001 1 05\n",
        "x".repeat(3 * LINE_BYTES_MAX)
    );
    let (packets, warnings) = read(text.as_bytes());
    assert_eq!(packets.len(), 1);
    assert_eq!(warnings, [Warning::LineTooLong { line: 1 }]);
}
