//! Lines of Yamakaky's `joy`: what a Bluetooth relay between a controller and a console saw.
//! `> h:mm:ss.microseconds bytes` goes to the host, `<` to the controller; the bytes are HIDP: a1
//! before an input report, a2 before an output report, in hexadecimal without spaces.

use posed_signal::{HostTime, time::SECOND_NS};

use super::reader::Found;
use crate::usb::{Packet, Port, Transfer};

/// The controller's place: such a trace has one.
const PORT: Port = Port { bus: 0, address: 1 };
const INPUT: u8 = 0xa1;
const OUTPUT: u8 = 0xa2;

/// Whether a text begins with such a line.
pub(super) fn recognises(text: &[u8]) -> bool {
    matches!(text, [b'>' | b'<', b' ', digit, ..] if digit.is_ascii_digit())
}

/// The packet of a line; `None` where it is not what it should be.
pub(super) fn line(line: &str) -> Option<Found> {
    let (direction, rest) = line.split_once(' ')?;
    let (time, hex) = rest.trim_start().split_once(' ')?;
    let bytes = bytes(hex.trim())?;
    let (&kind, data) = bytes.split_first()?;
    let endpoint = match (direction, kind) {
        (">", INPUT) => 0x81,
        ("<", OUTPUT) => 0x01,
        _ => return None,
    };
    let packet = Packet {
        at: time_of_day(time)?,
        port: PORT,
        endpoint,
        transfer: Transfer::Interrupt,
        data: data.to_vec(),
    };
    Some(Found {
        device: None,
        packet: Some(packet),
    })
}

fn time_of_day(text: &str) -> Option<HostTime> {
    let (clock, micros) = text.split_once('.')?;
    let micros: u64 = (micros.len() == 6).then(|| micros.parse().ok())??;
    let mut seconds = 0u64;
    for word in clock.split(':') {
        let number = word.parse::<u32>().ok()?;
        seconds = seconds.checked_mul(60)?.checked_add(u64::from(number))?;
    }
    let ns = seconds.checked_mul(SECOND_NS)?;
    Some(HostTime(ns.checked_add(micros * 1_000)?))
}

fn bytes(hex: &str) -> Option<Vec<u8>> {
    let digits = hex.as_bytes();
    if digits.is_empty() || !digits.len().is_multiple_of(2) {
        return None;
    }
    let digit = |c: u8| char::from(c).to_digit(16).map(|value| value as u8);
    digits
        .chunks_exact(2)
        .map(|pair| Some(digit(pair[0])? << 4 | digit(pair[1])?))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_broken_ones_are_not() {
        let found = line("> 1:02:03.004005 a13007").and_then(|found| found.packet);
        let packet = found.unwrap();
        assert_eq!(packet.at, HostTime(3_723_004_005_000));
        assert_eq!((packet.endpoint, &packet.data[..]), (0x81, &[0x30, 7][..]));
        let output = line("< 0:00:00.000001 a201").and_then(|found| found.packet);
        assert!(!output.unwrap().is_input());
        for broken in [
            "> 0:00:00.00001 a101",
            "> 0:00:00.000001 a10",
            "< 0:00:00.000001 a101",
            "> 0:00:00.000001 b101",
            "> 0:00:00.000001",
            "> 99999999999999999999:00.000001 a101",
            "> 0:00:00.000001 a1\u{e9}",
        ] {
            assert!(line(broken).is_none(), "{broken}");
        }
    }
}
