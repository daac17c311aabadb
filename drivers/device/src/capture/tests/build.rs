//! Captures put together byte by byte.

/// A classic pcap file of records with their times in microseconds.
pub(super) fn pcap(link: u32, records: &[(u64, Vec<u8>)]) -> Vec<u8> {
    let mut file = 0xa1b2_c3d4u32.to_le_bytes().to_vec();
    file.extend([2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    file.extend(262_144u32.to_le_bytes());
    file.extend(link.to_le_bytes());
    for (micros, data) in records {
        let (seconds, micros) = (micros / 1_000_000, micros % 1_000_000);
        for word in [
            seconds as u32,
            micros as u32,
            data.len() as u32,
            data.len() as u32,
        ] {
            file.extend(word.to_le_bytes());
        }
        file.extend(data);
    }
    file
}

/// A block of a pcapng file.
pub(super) fn block(kind: u32, body: &[u8]) -> Vec<u8> {
    let mut body = body.to_vec();
    body.resize(body.len().next_multiple_of(4), 0);
    let length = (body.len() as u32 + 12).to_le_bytes();
    [&kind.to_le_bytes()[..], &length, &body, &length].concat()
}

pub(super) fn section() -> Vec<u8> {
    let mut body = 0x1a2b_3c4du32.to_le_bytes().to_vec();
    body.extend([1, 0, 0, 0]);
    body.extend(u64::MAX.to_le_bytes());
    block(0x0a0d_0d0a, &body)
}

/// An interface description; `resolution` is the option `if_tsresol`.
pub(super) fn interface(link: u16, resolution: Option<u8>) -> Vec<u8> {
    let mut body = link.to_le_bytes().to_vec();
    body.extend([0, 0, 0, 0, 4, 0]);
    if let Some(resolution) = resolution {
        body.extend([9, 0, 1, 0, resolution, 0, 0, 0, 0, 0, 0, 0]);
    }
    block(1, &body)
}

/// An enhanced packet block.
pub(super) fn enhanced(interface: u32, ticks: u64, data: &[u8]) -> Vec<u8> {
    let length = data.len() as u32;
    let words = [
        interface,
        (ticks >> 32) as u32,
        ticks as u32,
        length,
        length,
    ];
    let mut body: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    body.extend(data);
    block(6, &body)
}

/// A usbmon record.
#[derive(Clone)]
pub(super) struct Usbmon {
    pub(super) id: u64,
    pub(super) event: u8,
    pub(super) transfer: u8,
    pub(super) endpoint: u8,
    pub(super) status: i32,
    pub(super) setup: Option<[u8; 8]>,
    pub(super) data: Vec<u8>,
}

impl Usbmon {
    pub(super) const BUS: u16 = 3;
    pub(super) const ADDRESS: u8 = 24;

    /// A completed interrupt read.
    pub(super) fn interrupt(data: &[u8]) -> Self {
        let data = data.to_vec();
        let (event, transfer, endpoint) = (b'C', 1, 0x81);
        Self {
            id: 1,
            event,
            transfer,
            endpoint,
            status: 0,
            setup: None,
            data,
        }
    }

    pub(super) fn control(event: u8, id: u64, endpoint: u8, setup: Option<[u8; 8]>) -> Self {
        Self {
            id,
            event,
            transfer: 2,
            endpoint,
            status: 0,
            setup,
            data: Vec::new(),
        }
    }

    pub(super) fn data(self, data: &[u8]) -> Self {
        Self {
            data: data.to_vec(),
            ..self
        }
    }

    pub(super) fn status(self, status: i32) -> Self {
        Self { status, ..self }
    }

    fn header(&self) -> Vec<u8> {
        let mut bytes = self.id.to_le_bytes().to_vec();
        bytes.extend([self.event, self.transfer, self.endpoint, Self::ADDRESS]);
        bytes.extend(Self::BUS.to_le_bytes());
        let no_data = if self.endpoint & 0x80 == 0 {
            b'>'
        } else {
            b'<'
        };
        bytes.push(if self.setup.is_some() { 0 } else { b'-' });
        bytes.push(if self.data.is_empty() { no_data } else { 0 });
        bytes.extend([0; 12]);
        bytes.extend(self.status.to_le_bytes());
        bytes.extend((self.data.len() as u32).to_le_bytes());
        bytes.extend((self.data.len() as u32).to_le_bytes());
        bytes.extend(self.setup.unwrap_or_default());
        bytes
    }

    fn mmapped_words(&self) -> Vec<u8> {
        let flags = if self.endpoint & 0x80 == 0 {
            0
        } else {
            0x200u32
        };
        [4, 0, flags, 0]
            .iter()
            .flat_map(|word: &u32| word.to_le_bytes())
            .collect()
    }

    /// As link type 189 has it.
    pub(super) fn short(&self) -> Vec<u8> {
        [self.header(), self.data.clone()].concat()
    }

    /// As link type 220 has it.
    pub(super) fn long(&self) -> Vec<u8> {
        [self.header(), self.mmapped_words(), self.data.clone()].concat()
    }
}

/// A USBPcap record; `stage` is that of a control transfer.
pub(super) struct UsbPcap<'a> {
    pub(super) irp: u64,
    pub(super) completed: bool,
    pub(super) endpoint: u8,
    pub(super) transfer: u8,
    pub(super) stage: Option<u8>,
    pub(super) data: &'a [u8],
}

impl UsbPcap<'_> {
    pub(super) fn bytes(&self) -> Vec<u8> {
        let header_bytes = 27 + u16::from(self.stage.is_some());
        let mut bytes = header_bytes.to_le_bytes().to_vec();
        bytes.extend(self.irp.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend([
            9,
            0,
            u8::from(self.completed),
            1,
            0,
            49,
            0,
            self.endpoint,
            self.transfer,
        ]);
        bytes.extend((self.data.len() as u32).to_le_bytes());
        bytes.extend(self.stage);
        bytes.extend(self.data);
        bytes
    }
}
