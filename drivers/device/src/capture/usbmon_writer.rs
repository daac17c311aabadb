//! Writes packets as a usbmon pcap, link type 220, as Wireshark and libsurvive read it.

use std::io::{self, Write};

use flate2::{Compression, write::GzEncoder};
use posed_signal::HostTime;

use crate::usb::{Packet, Port, Setup, Transfer, UsbId};

/// `LINKTYPE_USB_LINUX_MMAPPED`.
const LINK_TYPE: u32 = 220;
const PCAP_MAGIC: u32 = 0xa1b2_c3d4;
/// The snapshot length that libpcap writes for usbmon.
const SNAPSHOT_BYTES: u32 = 1 << 18;
const HEADER_BYTES: usize = 64;
/// `-EINPROGRESS`: the status of every submission.
const IN_PROGRESS: i32 = -115;
/// `URB_DIR_IN`.
const URB_DIR_IN: u32 = 0x200;
/// Polling interval of an interrupt endpoint, as high-speed devices have it.
const INTERVAL: u32 = 4;

/// Set-up flag: there is no set-up packet.
const NO_SETUP: u8 = b'-';
/// Data flags: there is data; it is still to be read; it has been written.
const DATA: u8 = 0;
const DATA_TO_COME: u8 = b'<';
const DATA_GONE: u8 = b'>';

/// How a capture is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UsbmonOptions {
    /// Whether the file is gzip'd.
    pub gzip: bool,
    /// Whether interrupt, bulk and isochronous reads get a submission record as well, which
    /// doubles the number of records and which few readers need. Control transfers always have
    /// both records.
    pub submissions: bool,
}

impl Default for UsbmonOptions {
    fn default() -> Self {
        Self {
            gzip: true,
            submissions: false,
        }
    }
}

enum Output<W: Write> {
    Plain(W),
    Gzip(GzEncoder<W>),
}

/// Writes a usbmon capture; time stamps are kept to the microsecond, as usbmon has them.
pub struct UsbmonWriter<W: Write> {
    output: Output<W>,
    options: UsbmonOptions,
}

/// The two records of a transfer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Submission,
    Completion,
}

impl<W: Write> UsbmonWriter<W> {
    /// Starts a capture in `output`, which should be buffered.
    ///
    /// # Errors
    /// `output` cannot be written to.
    pub fn new(output: W, options: UsbmonOptions) -> io::Result<Self> {
        let output = if options.gzip {
            Output::Gzip(GzEncoder::new(output, Compression::best()))
        } else {
            Output::Plain(output)
        };
        let mut writer = Self { output, options };
        let mut header = PCAP_MAGIC.to_le_bytes().to_vec();
        header.extend([2, 0, 4, 0]);
        header.extend([0; 8]);
        header.extend(SNAPSHOT_BYTES.to_le_bytes());
        header.extend(LINK_TYPE.to_le_bytes());
        writer.write(&header)?;
        Ok(writer)
    }

    /// Writes the transfer that told the host what sits on `port` (its device descriptor), so that
    /// readers need no list beside the capture.
    ///
    /// # Errors
    /// The output cannot be written to.
    pub fn device(&mut self, at: HostTime, port: Port, id: UsbId) -> io::Result<()> {
        let ([v0, v1], [p0, p1]) = (id.vendor.to_le_bytes(), id.product.to_le_bytes());
        // USB 2.0, class per interface, 64-byte endpoint 0, one configuration.
        let data = vec![18, 1, 0, 2, 0, 0, 0, 64, v0, v1, p0, p1, 0, 1, 1, 2, 3, 1];
        let setup = Setup {
            request_type: 0x80,
            request: Setup::GET_DESCRIPTOR,
            value: u16::from(Setup::DESCRIPTOR_DEVICE) << 8,
            index: 0,
            length: data.len() as u16,
        };
        let transfer = Transfer::Control(setup);
        self.packet(&Packet {
            at,
            port,
            endpoint: 0x80,
            transfer,
            data,
        })
    }

    /// Writes one finished transfer.
    ///
    /// # Errors
    /// The output cannot be written to.
    pub fn packet(&mut self, packet: &Packet) -> io::Result<()> {
        let control = matches!(packet.transfer, Transfer::Control(_));
        if control || self.options.submissions || !packet.is_input() {
            self.write(&record(packet, Stage::Submission))?;
        }
        if control || self.options.submissions || packet.is_input() {
            self.write(&record(packet, Stage::Completion))?;
        }
        Ok(())
    }

    /// Ends the capture and hands the output back, flushed.
    ///
    /// # Errors
    /// The output cannot be written to.
    pub fn finish(self) -> io::Result<W> {
        let mut output = match self.output {
            Output::Plain(output) => output,
            Output::Gzip(encoder) => encoder.finish()?,
        };
        output.flush()?;
        Ok(output)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.output {
            Output::Plain(output) => output.write_all(bytes),
            Output::Gzip(encoder) => encoder.write_all(bytes),
        }
    }
}

/// A pcap record: its header, usbmon's, and the data that belongs to the stage.
fn record(packet: &Packet, stage: Stage) -> Vec<u8> {
    let input = packet.is_input();
    let carries_data = input == (stage == Stage::Completion);
    let data: &[u8] = if carries_data { &packet.data } else { &[] };
    let micros = packet.at.0 / 1_000;
    let (seconds, micros) = (micros / 1_000_000, (micros % 1_000_000) as u32);
    let length = (HEADER_BYTES + data.len()) as u32;
    let data_flag = match (carries_data, input) {
        (true, _) => DATA,
        (false, true) => DATA_TO_COME,
        (false, false) => DATA_GONE,
    };
    let (setup, setup_flag) = match packet.transfer {
        Transfer::Control(setup) if stage == Stage::Submission => (setup.to_bytes(), 0),
        _ => ([0; 8], NO_SETUP),
    };
    let asked_for = match packet.transfer {
        Transfer::Control(setup) if stage == Stage::Submission => u32::from(setup.length),
        _ => packet.data.len() as u32,
    };
    let (code, status) = match stage {
        Stage::Submission => (b'S', IN_PROGRESS),
        Stage::Completion => (b'C', 0),
    };
    let transfer_type = match packet.transfer {
        Transfer::Isochronous => 0,
        Transfer::Interrupt => 1,
        Transfer::Control(_) => 2,
        Transfer::Bulk => 3,
    };
    let interval = if packet.transfer == Transfer::Interrupt {
        INTERVAL
    } else {
        0
    };
    let flags = if input { URB_DIR_IN } else { 0 };

    let mut bytes = Vec::with_capacity(16 + HEADER_BYTES + data.len());
    for word in [seconds as u32, micros, length, length] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(urb_id(packet).to_le_bytes());
    bytes.extend([
        code,
        transfer_type,
        packet.endpoint,
        packet.port.address as u8,
    ]);
    bytes.extend(packet.port.bus.to_le_bytes());
    bytes.extend([setup_flag, data_flag]);
    bytes.extend(seconds.to_le_bytes());
    for word in [micros, status.cast_unsigned(), asked_for, data.len() as u32] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(setup);
    for word in [interval, 0, flags, 0] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(data);
    bytes
}

/// usbmon's ids are kernel addresses; drivers keep one transfer per endpoint and use it again.
fn urb_id(packet: &Packet) -> u64 {
    let Port { bus, address } = packet.port;
    let [b1, b0] = bus.to_be_bytes();
    u64::from_be_bytes([0xff, 0xff, 0x88, b1, b0, address as u8, packet.endpoint, 0])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::capture::{Item, open};

    fn transfers() -> impl Strategy<Value = (Transfer, u8)> {
        let setup = any::<[u8; 8]>().prop_map(Setup::from_bytes);
        let control = setup.prop_map(|setup| {
            let direction = setup.request_type & 0x80;
            (Transfer::Control(setup), direction)
        });
        prop_oneof![
            control,
            any::<u8>().prop_map(|endpoint| (Transfer::Interrupt, endpoint)),
            any::<u8>().prop_map(|endpoint| (Transfer::Bulk, endpoint)),
        ]
    }

    prop_compose! {
        fn packets()(
            micros in 0..4_000_000_000_000_000u64,
            bus in any::<u16>(),
            address in any::<u8>(),
            (transfer, endpoint) in transfers(),
            data in prop::collection::vec(any::<u8>(), 1..300),
        ) -> Packet {
            let port = Port { bus, address: u16::from(address) };
            Packet { at: HostTime(micros * 1_000), port, endpoint, transfer, data }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            packets in prop::collection::vec(packets(), 0..20),
            gzip in any::<bool>(),
            submissions in any::<bool>(),
        ) {
            let options = UsbmonOptions { gzip, submissions };
            let mut writer = UsbmonWriter::new(Vec::new(), options).unwrap();
            for packet in &packets {
                writer.packet(packet).unwrap();
            }
            let bytes = writer.finish().unwrap();
            let mut reader = open(&bytes[..]).unwrap();
            let mut read = Vec::new();
            for item in reader.by_ref() {
                match item {
                    Item::Packet(packet) => read.push(packet),
                    Item::Device(..) => {}
                    Item::Warning(warning) => prop_assert!(false, "{}", warning),
                }
            }
            prop_assert_eq!(&read, &packets);
            let records = reader.statistics().records;
            prop_assert!(!submissions || records == 2 * packets.len() as u64);
        }
    }

    #[test]
    fn a_capture_says_what_its_devices_are() {
        let (port, id) = (
            Port {
                bus: 1,
                address: 19,
            },
            UsbId::new(0x28de, 0x2300),
        );
        let mut writer = UsbmonWriter::new(Vec::new(), UsbmonOptions::default()).unwrap();
        writer.device(HostTime(5_000), port, id).unwrap();
        let bytes = writer.finish().unwrap();
        let mut reader = open(&bytes[..]).unwrap();
        assert_eq!(reader.next(), Some(Item::Device(port, id)));
        assert!(matches!(reader.next(), Some(Item::Packet(_))));
        assert_eq!(reader.next(), None);
    }
}
