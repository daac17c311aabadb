//! Which device sat on which port: from descriptors in a capture, or a list beside it.

use crate::usb::{Packet, Port, Transfer, UsbId};

/// `bLength` of a device descriptor.
const DEVICE_DESCRIPTOR_BYTES: usize = 18;

/// The ids in a device descriptor, if `packet` is the answer to a request for one (USB 2.0,
/// 9.6.1). Address 0, where every device answers before it has one of its own, does not count.
#[must_use]
pub fn device_descriptor(packet: &Packet) -> Option<UsbId> {
    let Transfer::Control(setup) = packet.transfer else {
        return None;
    };
    let descriptor: &[u8; DEVICE_DESCRIPTOR_BYTES] = packet.data.first_chunk()?;
    let is_one = setup.is_get_device_descriptor()
        && packet.port.address != 0
        && usize::from(descriptor[0]) == DEVICE_DESCRIPTOR_BYTES
        && descriptor[1] == crate::usb::Setup::DESCRIPTOR_DEVICE;
    let word = |at: usize| u16::from_le_bytes([descriptor[at], descriptor[at + 1]]);
    is_one.then(|| UsbId::new(word(8), word(10)))
}

/// Reads a `.usbdevs` list, as libsurvive keeps them beside its captures: one `vendor product bus
/// address NAME` a line, numbers decimal. Lines that are something else are skipped.
#[must_use]
pub fn parse_usbdevs(text: &str) -> Vec<(Port, UsbId)> {
    text.lines().filter_map(usbdevs_line).collect()
}

fn usbdevs_line(line: &str) -> Option<(Port, UsbId)> {
    let mut words = line.split_ascii_whitespace();
    let mut number = || words.next()?.parse().ok();
    let id = UsbId::new(number()?, number()?);
    Some((
        Port {
            bus: number()?,
            address: number()?,
        },
        id,
    ))
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;

    use super::*;
    use crate::usb::Setup;

    #[test]
    fn usbdevs_lines_are_read_and_others_skipped() {
        let text = "10462 8960 1 19 T2\r\n\n# a note\n10462 8449 1\n10462 99999 1 2 X\n3 4 5 6";
        let expected = [
            (
                Port {
                    bus: 1,
                    address: 19,
                },
                UsbId::new(0x28de, 0x2300),
            ),
            (Port { bus: 5, address: 6 }, UsbId::new(3, 4)),
        ];
        assert_eq!(parse_usbdevs(text), expected);
    }

    #[test]
    fn a_device_descriptor_names_its_device() {
        let mut data = vec![
            18, 1, 0x10, 1, 0, 0, 0, 64, 0xde, 0x28, 0x12, 0x20, 1, 1, 1, 2, 6, 1,
        ];
        let setup = Setup::from_bytes([0x80, 6, 0, 1, 0, 0, 18, 0]);
        let packet = |address, data: &[u8]| Packet {
            at: HostTime(0),
            port: Port { bus: 1, address },
            endpoint: 0x80,
            transfer: Transfer::Control(setup),
            data: data.to_vec(),
        };
        assert_eq!(
            device_descriptor(&packet(7, &data)),
            Some(UsbId::new(0x28de, 0x2012))
        );
        assert_eq!(device_descriptor(&packet(0, &data)), None);
        assert_eq!(device_descriptor(&packet(7, &data[..8])), None);
        data[1] = 2;
        assert_eq!(device_descriptor(&packet(7, &data)), None);
    }
}
