//! Captures as a transport.

use std::collections::VecDeque;

use posed_signal::HostTime;

use super::{Event, Transport, TransportError, Warning};
use crate::{
    capture::{CaptureReader, Item},
    decode::Command,
    usb::{Packet, Port, UsbId},
};

/// Ports of captures that run side by side are this many buses apart.
const BUSES: u16 = 1_000;

/// A capture to be replayed.
pub struct Recording {
    /// Its name, for warnings.
    pub name: String,
    /// Its content.
    pub reader: CaptureReader<'static>,
    /// Devices known from beside it, see [`crate::capture::identity::parse_usbdevs`].
    pub devices: Vec<(Port, UsbId)>,
}

/// How several captures become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Merge {
    /// Parts of one session: time stamps and ports are taken as they are.
    #[default]
    OneSession,
    /// Sessions of their own: all start together at the first one's first time stamp, and ports
    /// are kept apart.
    SideBySide,
}

/// A capture being replayed.
struct Track {
    recording: Recording,
    /// Added to its bus numbers.
    bus_offset: u16,
    /// Added to its times, once the first one is known.
    shift_ns: Option<i64>,
    /// Its next packet.
    head: Option<Packet>,
}

/// Replays one or more captures, merged by time. Commands go nowhere: what the devices answered
/// is in the captures.
pub struct Replay {
    tracks: Vec<Track>,
    /// When the first capture starts, once that is known.
    start: Option<HostTime>,
    /// Events that come before the next packet.
    queue: VecDeque<Event>,
    started: bool,
}

impl Replay {
    /// A replay of `recordings`.
    #[must_use]
    pub fn new(recordings: Vec<Recording>, merge: Merge) -> Self {
        let side_by_side = merge == Merge::SideBySide;
        let track = |(index, recording)| Track {
            recording,
            bus_offset: if side_by_side {
                BUSES.wrapping_mul(index as u16)
            } else {
                0
            },
            shift_ns: (!side_by_side).then_some(0),
            head: None,
        };
        let tracks = recordings.into_iter().enumerate().map(track).collect();
        Self {
            tracks,
            start: None,
            queue: VecDeque::new(),
            started: false,
        }
    }

    fn begin(&mut self) {
        self.started = true;
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            for &(port, id) in &track.recording.devices {
                self.queue.push_back(Event::Attached {
                    port: track.port(port),
                    id,
                });
            }
            self.read_on(index);
        }
    }

    /// Reads a capture up to its next packet.
    fn read_on(&mut self, index: usize) {
        let track = &mut self.tracks[index];
        track.head = None;
        while let Some(item) = track.recording.reader.next() {
            match item {
                Item::Packet(mut packet) => {
                    let start = *self.start.get_or_insert(packet.at);
                    let first = packet.at;
                    let shift = *track.shift_ns.get_or_insert_with(|| start.since_ns(first));
                    packet.at = packet.at.plus_ns(shift);
                    packet.port = track.port(packet.port);
                    track.head = Some(packet);
                    return;
                }
                Item::Device(port, id) => {
                    self.queue.push_back(Event::Attached {
                        port: track.port(port),
                        id,
                    });
                }
                Item::Warning(warning) => {
                    let name = track.recording.name.clone();
                    self.queue
                        .push_back(Event::Warning(Warning::Capture { name, warning }));
                }
            }
        }
    }
}

impl Track {
    fn port(&self, port: Port) -> Port {
        Port {
            bus: port.bus.wrapping_add(self.bus_offset),
            ..port
        }
    }
}

impl Transport for Replay {
    fn next(&mut self, _wait_ns: u64) -> Event {
        if !self.started {
            self.begin();
        }
        if let Some(event) = self.queue.pop_front() {
            return event;
        }
        let heads = self.tracks.iter().enumerate();
        let earliest = heads
            .filter_map(|(index, track)| Some((track.head.as_ref()?.at, index)))
            .min();
        let Some((_, index)) = earliest else {
            return Event::End;
        };
        let packet = self.tracks[index].head.take();
        self.read_on(index);
        packet.map_or(Event::End, Event::Packet)
    }

    fn send(&mut self, _port: Port, _command: &Command) -> Result<(), TransportError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        capture::{UsbmonOptions, UsbmonWriter, open},
        usb::Transfer,
    };

    const ID: UsbId = UsbId::new(0x28de, 0x2300);

    fn recording(start_us: u64, address: u16, torn: bool) -> Recording {
        let port = Port { bus: 1, address };
        let options = UsbmonOptions {
            gzip: false,
            submissions: false,
        };
        let mut writer = UsbmonWriter::new(Vec::new(), options).unwrap();
        for n in 0..4 {
            let at = HostTime((start_us + n * 10) * 1_000);
            let (transfer, data) = (Transfer::Interrupt, vec![address as u8, n as u8]);
            writer
                .packet(&Packet {
                    at,
                    port,
                    endpoint: 0x81,
                    transfer,
                    data,
                })
                .unwrap();
        }
        let mut bytes = writer.finish().unwrap();
        if torn {
            bytes.truncate(bytes.len() - 1);
        }
        Recording {
            name: format!("capture {address}"),
            reader: open(std::io::Cursor::new(bytes)).unwrap(),
            devices: vec![(port, ID)],
        }
    }

    fn events(mut replay: Replay) -> Vec<Event> {
        let mut events = Vec::new();
        loop {
            match replay.next(0) {
                Event::End => return events,
                event => events.push(event),
            }
        }
    }

    fn packets(events: &[Event]) -> Vec<(u64, u16, Vec<u8>)> {
        let packet = |event: &Event| match event {
            Event::Packet(packet) => {
                Some((packet.at.0 / 1_000, packet.port.bus, packet.data.clone()))
            }
            _ => None,
        };
        events.iter().filter_map(packet).collect()
    }

    #[test]
    fn parts_of_one_session_are_merged_by_time() {
        let recordings = vec![recording(105, 1, false), recording(100, 2, true)];
        let events = events(Replay::new(recordings, Merge::OneSession));
        let [port_1, port_2] = [1, 2].map(|address| Port { bus: 1, address });
        assert_eq!(
            events[0],
            Event::Attached {
                port: port_1,
                id: ID
            }
        );
        assert_eq!(
            events[1],
            Event::Attached {
                port: port_2,
                id: ID
            }
        );
        let torn = |event: &Event| {
            matches!(event, Event::Warning(Warning::Capture { name, .. })
            if name == "capture 2")
        };
        assert_eq!(events.iter().filter(|event| torn(event)).count(), 1);
        let packets = packets(&events);
        let times: Vec<_> = packets.iter().map(|packet| packet.0).collect();
        assert_eq!(times, [100, 105, 110, 115, 120, 125, 135]);
        assert!(packets.iter().all(|packet| packet.1 == 1));
    }

    #[test]
    fn sessions_side_by_side_start_together_on_ports_of_their_own() {
        let recordings = vec![recording(100, 1, false), recording(99_000, 1, false)];
        let packets = packets(&events(Replay::new(recordings, Merge::SideBySide)));
        let times: Vec<_> = packets.iter().map(|packet| (packet.0, packet.1)).collect();
        let (a, b) = (1, 1 + BUSES);
        let together = [100, 110, 120, 130].map(|at| [(at, a), (at, b)]).concat();
        assert_eq!(times, together);
    }

    #[test]
    fn nothing_to_replay_ends_at_once() {
        assert_eq!(
            Replay::new(Vec::new(), Merge::OneSession).next(1_000),
            Event::End
        );
    }
}
