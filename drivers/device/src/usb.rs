//! USB as every transport presents it: which device, which endpoint, which bytes, when.

use std::fmt;

use posed_signal::HostTime;

/// Vendor and product id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct UsbId {
    /// `idVendor`.
    pub vendor: u16,
    /// `idProduct`.
    pub product: u16,
}

impl UsbId {
    /// From `idVendor` and `idProduct`.
    #[must_use]
    pub const fn new(vendor: u16, product: u16) -> Self {
        Self { vendor, product }
    }
}

impl fmt::Display for UsbId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:04x}", self.vendor, self.product)
    }
}

/// Where a device is plugged in: bus and device address, as usbmon and USBPcap number them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Port {
    /// Bus number.
    pub bus: u16,
    /// Device address on the bus.
    pub address: u16,
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.bus, self.address)
    }
}

/// The eight bytes that start a control transfer (USB 2.0, 9.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Setup {
    /// `bmRequestType`: bit 7 device to host, bits 5-6 type, bits 0-4 recipient.
    pub request_type: u8,
    /// `bRequest`.
    pub request: u8,
    /// `wValue`.
    pub value: u16,
    /// `wIndex`.
    pub index: u16,
    /// `wLength`.
    pub length: u16,
}

impl Setup {
    /// `GET_DESCRIPTOR`.
    pub const GET_DESCRIPTOR: u8 = 0x06;
    /// HID `GET_REPORT`.
    pub const HID_GET_REPORT: u8 = 0x01;
    /// HID `SET_REPORT`.
    pub const HID_SET_REPORT: u8 = 0x09;
    /// Device descriptor, in the high byte of `wValue`.
    pub const DESCRIPTOR_DEVICE: u8 = 1;
    /// HID output report, in the high byte of `wValue`.
    pub const REPORT_OUTPUT: u8 = 2;
    /// HID feature report, in the high byte of `wValue`.
    pub const REPORT_FEATURE: u8 = 3;

    /// From the bytes on the wire.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 8]) -> Self {
        let [request_type, request, v0, v1, i0, i1, l0, l1] = bytes;
        Self {
            request_type,
            request,
            value: u16::from_le_bytes([v0, v1]),
            index: u16::from_le_bytes([i0, i1]),
            length: u16::from_le_bytes([l0, l1]),
        }
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 8] {
        let ([v0, v1], [i0, i1], [l0, l1]) = (
            self.value.to_le_bytes(),
            self.index.to_le_bytes(),
            self.length.to_le_bytes(),
        );
        [self.request_type, self.request, v0, v1, i0, i1, l0, l1]
    }

    /// Whether this asks for the device descriptor.
    #[must_use]
    pub fn is_get_device_descriptor(&self) -> bool {
        self.request_type == 0x80
            && self.request == Self::GET_DESCRIPTOR
            && self.value >> 8 == u16::from(Self::DESCRIPTOR_DEVICE)
    }

    /// The report id, if this reads a HID feature report.
    #[must_use]
    pub fn feature_read(&self) -> Option<u8> {
        let hit = self.request_type == 0xa1
            && self.request == Self::HID_GET_REPORT
            && self.value >> 8 == u16::from(Self::REPORT_FEATURE);
        hit.then_some(self.value as u8)
    }

    /// The report id, if this writes a HID feature report.
    #[must_use]
    pub fn feature_write(&self) -> Option<u8> {
        let hit = self.request_type == 0x21
            && self.request == Self::HID_SET_REPORT
            && self.value >> 8 == u16::from(Self::REPORT_FEATURE);
        hit.then_some(self.value as u8)
    }
}

/// What kind of transfer carried the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transfer {
    /// Interrupt transfer: HID input (or output) reports.
    Interrupt,
    /// Control transfer, with the set-up packet it belongs to.
    Control(Setup),
    /// Bulk transfer.
    Bulk,
    /// Isochronous transfer.
    Isochronous,
}

/// One finished transfer with its data: the unit that transports deliver and captures hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// When the host saw it: live, stamped as soon as it was read; in a capture, its time stamp.
    pub at: HostTime,
    /// The device.
    pub port: Port,
    /// Endpoint address; bit 7 is set for device to host.
    pub endpoint: u8,
    /// Kind of transfer.
    pub transfer: Transfer,
    /// The data stage, without any capture header.
    pub data: Vec<u8>,
}

impl Packet {
    /// Whether the data went from the device to the host.
    #[must_use]
    pub fn is_input(&self) -> bool {
        self.endpoint & 0x80 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_up_packets_are_recognised() {
        let read = Setup::from_bytes([0xa1, 0x01, 0x10, 0x03, 0, 0, 64, 0]);
        assert_eq!(
            (read.feature_read(), read.feature_write()),
            (Some(0x10), None)
        );
        let write = Setup::from_bytes([0x21, 0x09, 0x04, 0x03, 0, 0, 64, 0]);
        assert_eq!(
            (write.feature_read(), write.feature_write()),
            (None, Some(0x04))
        );
        assert!(Setup::from_bytes([0x80, 6, 0, 1, 0, 0, 18, 0]).is_get_device_descriptor());
        assert_eq!(read.to_bytes(), [0xa1, 0x01, 0x10, 0x03, 0, 0, 64, 0]);
    }
}
