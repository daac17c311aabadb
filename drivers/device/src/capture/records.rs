//! The records of a pcap or pcapng file.

use pcap_parser::{
    Block, PcapBlockOwned, PcapError,
    traits::{PcapNGPacketBlock, PcapReaderIterator},
};
use posed_signal::{HostTime, time::SECOND_NS};

use super::{
    CaptureError, Warning,
    source::{Fault, Progress, Source},
};

/// Records longer than this end the reading: lengths are not to be trusted.
pub const RECORD_BYTES_MAX: usize = 1 << 20;
/// Interfaces of one pcapng section that are told apart.
const INTERFACES_MAX: usize = 64;

/// The layouts of USB traffic that are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Link {
    /// `DLT_USB_LINUX`: usbmon with a 48-byte header.
    Usbmon48,
    /// `DLT_USB_LINUX_MMAPPED`: usbmon with a 64-byte header.
    Usbmon64,
    /// `DLT_USBPCAP`.
    UsbPcap,
}

impl Link {
    /// From a `LINKTYPE_` number. usbmon's headers are in the byte order of the machine that wrote
    /// them; those of big-endian machines are not read.
    fn new(number: i32, big_endian: bool) -> Option<Self> {
        match number {
            189 if !big_endian => Some(Self::Usbmon48),
            220 if !big_endian => Some(Self::Usbmon64),
            249 => Some(Self::UsbPcap),
            _ => None,
        }
    }
}

/// One record of the file.
#[derive(Debug)]
pub(super) struct Record<'r> {
    pub(super) at: HostTime,
    pub(super) link: Link,
    pub(super) data: &'r [u8],
}

/// What reading on came to.
#[derive(Debug)]
pub(super) enum Step<T> {
    /// A record, as the caller's function turned it round.
    Record(T),
    /// A block of the file that is no record.
    Other,
    /// Something is wrong; reading goes on.
    Warning(Warning),
    /// The file is over, or cannot be read any further.
    End(Option<Warning>),
}

#[derive(Debug, Clone, Copy)]
struct Interface {
    link: Option<Link>,
    ticks_per_second: u64,
    offset_s: i64,
}

impl Interface {
    fn time(&self, ticks: u64) -> HostTime {
        let ns = u128::from(ticks) * u128::from(SECOND_NS) / u128::from(self.ticks_per_second);
        let offset_ns = i128::from(self.offset_s) * i128::from(SECOND_NS);
        let sum = i128::try_from(ns)
            .unwrap_or(i128::MAX)
            .saturating_add(offset_ns);
        HostTime(u64::try_from(sum.max(0)).unwrap_or(u64::MAX))
    }
}

/// What the file has said so far about the records that follow.
struct Context {
    interfaces: Vec<Interface>,
    big_endian: bool,
    /// Time of the last record, for those that have none.
    last: HostTime,
}

/// Reads records one by one.
pub(super) struct Records<'a> {
    reader: Box<dyn PcapReaderIterator + Send + 'a>,
    context: Context,
    count: u64,
    progress: Progress,
    fault: Fault,
}

impl<'a> Records<'a> {
    /// # Errors
    /// The file's header is cut off, or of another link type.
    pub(super) fn new(source: Source<'a>) -> Result<Self, CaptureError> {
        let (progress, fault) = (source.progress(), source.fault());
        let reader = pcap_parser::create_reader(RECORD_BYTES_MAX, source)
            .map_err(|_| CaptureError::HeaderCutOff)?;
        let context = Context {
            interfaces: Vec::new(),
            big_endian: false,
            last: HostTime::default(),
        };
        let mut records = Self {
            reader,
            context,
            count: 0,
            progress,
            fault,
        };
        // The first block is the file's header; a classic one names the only link type there is.
        match records.step(|_| ()) {
            Step::Warning(Warning::LinkType { link }) => Err(CaptureError::LinkType { link }),
            _ => Ok(records),
        }
    }

    /// Records read so far.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Reads on to the next block, and hands it to `turn` if it is a record.
    pub(super) fn step<T>(&mut self, turn: impl FnOnce(Record<'_>) -> T) -> Step<T> {
        let mut turn = Some(turn);
        loop {
            match self.reader.next() {
                Ok((length, block)) => {
                    let step = self.context.interpret(block, &mut turn);
                    self.reader.consume(length);
                    self.count += u64::from(turn.is_none());
                    return step;
                }
                Err(PcapError::Incomplete(_)) => {
                    if self.reader.refill().is_err() {
                        return Step::End(self.cut_off());
                    }
                }
                Err(PcapError::Eof) => return Step::End(self.fault.warning()),
                Err(PcapError::UnexpectedEof) => return Step::End(self.cut_off()),
                Err(PcapError::BufferTooSmall) => {
                    return self.damaged(Warning::RecordTooLong { record: self.count });
                }
                Err(_) => return self.damaged(Warning::Damaged { record: self.count }),
            }
        }
    }

    /// Damage in the compressed stream is why records make no sense, if there is any.
    fn damaged<T>(&self, warning: Warning) -> Step<T> {
        Step::End(Some(self.fault.warning().unwrap_or(warning)))
    }

    /// The end came where it should not have, unless nothing had been begun.
    fn cut_off(&self) -> Option<Warning> {
        let begun = !self.reader.data().is_empty();
        let cut = begun.then(|| Warning::CutOff {
            at_byte: self.progress.bytes(),
        });
        self.fault.warning().or(cut)
    }
}

impl Context {
    fn interpret<T, F: FnOnce(Record<'_>) -> T>(
        &mut self,
        block: PcapBlockOwned<'_>,
        turn: &mut Option<F>,
    ) -> Step<T> {
        match block {
            PcapBlockOwned::LegacyHeader(header) => {
                let link = Link::new(header.network.0, header.is_bigendian());
                let nanoseconds = header.is_nanosecond_precision();
                let ticks_per_second = if nanoseconds { SECOND_NS } else { 1_000_000 };
                self.interfaces = vec![Interface {
                    link,
                    ticks_per_second,
                    offset_s: 0,
                }];
                if link.is_some() {
                    Step::Other
                } else {
                    unknown_link(header.network.0)
                }
            }
            PcapBlockOwned::Legacy(frame) => {
                let Some(interface) = self.interfaces.first() else {
                    return Step::Other;
                };
                let ticks = u64::from(frame.ts_sec) * interface.ticks_per_second;
                let at = interface.time(ticks + u64::from(frame.ts_usec));
                self.record(0, Some(at), frame.data, turn)
            }
            PcapBlockOwned::NG(Block::SectionHeader(header)) => {
                self.big_endian = header.big_endian();
                self.interfaces.clear();
                Step::Other
            }
            PcapBlockOwned::NG(Block::InterfaceDescription(description)) => {
                let link = Link::new(description.linktype.0, self.big_endian);
                let ticks_per_second = ticks_per_second(description.if_tsresol);
                let offset_s = description.if_tsoffset;
                if self.interfaces.len() < INTERFACES_MAX {
                    self.interfaces.push(Interface {
                        link,
                        ticks_per_second,
                        offset_s,
                    });
                }
                if link.is_some() {
                    Step::Other
                } else {
                    unknown_link(description.linktype.0)
                }
            }
            PcapBlockOwned::NG(Block::EnhancedPacket(packet)) => {
                let index = packet.if_id as usize;
                let ticks = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
                let at = self
                    .interfaces
                    .get(index)
                    .map(|interface| interface.time(ticks));
                self.record(index, at, packet.packet_data(), turn)
            }
            PcapBlockOwned::NG(Block::SimplePacket(packet)) => {
                self.record(0, None, packet.packet_data(), turn)
            }
            PcapBlockOwned::NG(_) => Step::Other,
        }
    }

    fn record<T, F: FnOnce(Record<'_>) -> T>(
        &mut self,
        interface: usize,
        at: Option<HostTime>,
        data: &[u8],
        turn: &mut Option<F>,
    ) -> Step<T> {
        let Some(interface) = self.interfaces.get(interface) else {
            return Step::Warning(Warning::NoInterface);
        };
        self.last = at.unwrap_or(self.last);
        let Some(link) = interface.link else {
            return Step::Other;
        };
        let Some(turn) = turn.take() else {
            return Step::Other;
        };
        Step::Record(turn(Record {
            at: self.last,
            link,
            data,
        }))
    }
}

/// From the option `if_tsresol`: a negative power of ten, or of two with the top bit set. One out
/// of range counts as absent, which means microseconds.
fn ticks_per_second(resolution: u8) -> u64 {
    let exponent = u32::from(resolution & 0x7f);
    let base: u64 = if resolution & 0x80 == 0 { 10 } else { 2 };
    base.checked_pow(exponent).unwrap_or(1_000_000)
}

fn unknown_link<T>(link: i32) -> Step<T> {
    Step::Warning(Warning::LinkType { link })
}
