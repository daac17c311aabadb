//! hid-recorder's text (hid-tools, `hid-recorder(1)`): `I: bus vendor product` names the device,
//! each `E: seconds.microseconds length bytes...` is a report, `D: n` says whose lines follow.
//!
//! Lines of [`joy_trace`] are taken for what they are wherever they stand.
//!
//! The text has no place for ports, endpoints and control transfers. posed's own recordings put
//! port and endpoint into the `P:` line, as the kernel does with a path of its own, and control
//! transfers into comments, which other readers skip: see [`super::HidRecorderWriter`].

use std::collections::BTreeMap;

use posed_signal::{HostTime, time::SECOND_NS};

use super::{
    joy_trace,
    lines::{BadLine, Lines},
    pairing::Pairing,
    reader::Found,
    records::Step,
    source::Source,
};
use crate::usb::{Packet, Port, Setup, Transfer, UsbId};

/// Devices in one recording.
const DEVICES_MAX: usize = 256;
/// Where the path of a `P:` line of posed's own begins.
pub(super) const PHYS_PREFIX: &str = "posed/";
/// How a control transfer's line begins.
pub(super) const CONTROL_PREFIX: &str = "# posed control:";

#[derive(Debug, Clone, Copy, Default)]
struct Node {
    id: Option<UsbId>,
    place: Option<(Port, u8)>,
}

/// Reads the text line by line.
pub(super) struct HidRecorder<'a> {
    lines: Lines<'a>,
    nodes: Nodes,
}

impl<'a> HidRecorder<'a> {
    /// Whether a text begins like this.
    pub(super) fn recognises(text: &[u8]) -> bool {
        let start = text
            .iter()
            .take_while(|byte| byte.is_ascii_whitespace())
            .count();
        match text[start..] {
            ref line if joy_trace::recognises(line) => true,
            [b'#', ..] => !text[start..].contains(&0),
            [b'D' | b'R' | b'N' | b'P' | b'I' | b'E', b':', next, ..] => next.is_ascii_whitespace(),
            _ => false,
        }
    }

    pub(super) fn new(source: Source<'a>) -> Self {
        Self {
            lines: Lines::new(source),
            nodes: Nodes::default(),
        }
    }

    /// Reads on to the next line.
    pub(super) fn step(&mut self, pairing: &mut Pairing) -> Step<Found> {
        let Self { lines, nodes } = self;
        lines.step(pairing, |line| nodes.parse(line))
    }
}

/// The devices so far.
#[derive(Default)]
struct Nodes {
    /// The device that lines belong to.
    index: u16,
    nodes: BTreeMap<u16, Node>,
}

impl Nodes {
    fn parse(&mut self, line: &str) -> Result<Found, BadLine> {
        if let Some(rest) = line.strip_prefix(CONTROL_PREFIX) {
            return control(rest).ok_or(BadLine);
        }
        if joy_trace::recognises(line.as_bytes()) {
            return joy_trace::line(line).ok_or(BadLine);
        }
        let Some((prefix, rest)) = line.split_once(':') else {
            return Ok(Found::default());
        };
        match prefix {
            "D" => {
                self.index = rest.trim().parse().map_err(|_| BadLine)?;
                Ok(Found::default())
            }
            "I" => {
                let id = device_id(rest).ok_or(BadLine)?;
                self.node()?.id = Some(id);
                Ok(Found::default())
            }
            "P" => {
                let place = place(rest.trim());
                self.node()?.place = place;
                Ok(Found::default())
            }
            "E" => self.report(rest).ok_or(BadLine),
            _ => Ok(Found::default()),
        }
    }

    fn node(&mut self) -> Result<&mut Node, BadLine> {
        if self.nodes.len() >= DEVICES_MAX && !self.nodes.contains_key(&self.index) {
            return Err(BadLine);
        }
        Ok(self.nodes.entry(self.index).or_default())
    }

    fn report(&mut self, rest: &str) -> Option<Found> {
        let (time, rest) = rest.trim_start().split_once(' ')?;
        let (length, hex) = rest.trim_start().split_once(' ')?;
        let data = bytes(hex)?;
        if data.is_empty() || data.len() != length.parse::<usize>().ok()? {
            return None;
        }
        let node = self.nodes.get(&self.index).copied().unwrap_or_default();
        let address = self.index.saturating_add(1);
        let (port, endpoint) = node.place.unwrap_or((Port { bus: 0, address }, 0x81));
        let (at, transfer) = (parse_time(time)?, Transfer::Interrupt);
        Some(Found {
            device: node.id.map(|id| (port, id)),
            packet: Some(Packet {
                at,
                port,
                endpoint,
                transfer,
                data,
            }),
        })
    }
}

/// `bus vendor product`, hexadecimal.
fn device_id(text: &str) -> Option<UsbId> {
    let mut words = text.split_ascii_whitespace();
    let _bus = words.next()?;
    let mut number = || u16::from_str_radix(words.next()?, 16).ok();
    Some(UsbId::new(number()?, number()?))
}

/// `posed/bus-address/endpoint`, the endpoint hexadecimal; other paths say nothing about ports.
fn place(text: &str) -> Option<(Port, u8)> {
    let (port, endpoint) = text.strip_prefix(PHYS_PREFIX)?.split_once('/')?;
    Some((parse_port(port)?, u8::from_str_radix(endpoint, 16).ok()?))
}

fn parse_port(text: &str) -> Option<Port> {
    let (bus, address) = text.split_once('-')?;
    Some(Port {
        bus: bus.parse().ok()?,
        address: address.parse().ok()?,
    })
}

/// `bus-address seconds.microseconds set-up packet, data`.
fn control(text: &str) -> Option<Found> {
    let mut words = text.trim_start().splitn(3, ' ');
    let (port, at) = (parse_port(words.next()?)?, parse_time(words.next()?)?);
    let bytes = bytes(words.next()?)?;
    let (setup, data) = bytes.split_first_chunk()?;
    let (setup, data) = (Setup::from_bytes(*setup), data.to_vec());
    let endpoint = setup.request_type & 0x80;
    let packet = Packet {
        at,
        port,
        endpoint,
        transfer: Transfer::Control(setup),
        data,
    };
    Some(Found {
        device: None,
        packet: Some(packet),
    })
}

/// `seconds.microseconds`, six digits behind the point.
fn parse_time(text: &str) -> Option<HostTime> {
    let (seconds, micros) = text.split_once('.')?;
    let micros: u64 = if micros.len() == 6 {
        micros.parse().ok()?
    } else {
        return None;
    };
    let ns = seconds
        .parse::<u64>()
        .ok()?
        .checked_mul(SECOND_NS)?
        .checked_add(micros * 1_000)?;
    Some(HostTime(ns))
}

/// Two digits a byte: fewer show that the line is cut off.
fn bytes(hex: &str) -> Option<Vec<u8>> {
    let pair = |word: &str| match word.len() {
        2 => u8::from_str_radix(word, 16).ok(),
        _ => None,
    };
    hex.split_ascii_whitespace().map(pair).collect()
}
