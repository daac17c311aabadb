//! From the packets of one USB device to events: the part of decoding that needs no configuration,
//! shared by the decoder and the inspector.

use posed_signal::TickUnwrap;

use super::{
    blob::BlobReader,
    input::{self, MainboardInput, WiredInput},
    radio::{PACKET_BYTES, Part, RadioInput, RadioPacket, Version},
    radio_pulses,
    wire::{self, Fields, ImuRing, Light, RawImu, id},
};
use crate::{
    decode::DecodeError,
    usb::{Packet, Transfer},
};

/// What a packet said.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Inertial sample, device time extended beyond its wrap.
    Imu {
        /// Device time.
        ticks: u64,
        /// The sample; its own time still wraps.
        raw: RawImu,
    },
    /// A rotor passed its zero.
    Sync {
        /// The base station's channel.
        channel: u8,
        /// Device time, ticks.
        ticks: f64,
        /// The bit of the base station's slow data stream.
        data: bool,
    },
    /// A light plane passed a sensor.
    Sweep {
        /// The base station's channel.
        channel: u8,
        /// The sensor's hardware channel.
        sensor: u8,
        /// Device time, ticks.
        ticks: f64,
    },
    /// A light pulse under base stations of generation 1.
    Pulse {
        /// The sensor's hardware channel.
        sensor: u8,
        /// Ticks.
        length: u16,
        /// Device time of its beginning, ticks.
        ticks: u64,
    },
    /// The device sends undecoded beams of generation 2: it waits for the mode switch.
    RawBeams,
    /// Input of a wired device.
    Wired(WiredInput),
    /// A Vive's mainboard.
    Mainboard(MainboardInput),
    /// Input by radio.
    Radio(RadioInput),
    /// Battery by radio: bit 7 charging, the others per cent.
    Battery(u8),
    /// The device behind the dongle was switched off.
    Off,
    /// A radio packet came.
    RadioPacket,
    /// The configuration is complete: its JSON.
    Configuration(String),
    /// Codes of the IMU's full scales: gyroscope, accelerometer.
    Ranges(u8, u8),
    /// A piece of the configuration, or the start of its read, was answered.
    ConfigurationProgress,
}

/// Light that a packet held while the mode switch was on its way is garbage until this many
/// packets without light have passed (libsurvive's figure).
const PACKETS_AFTER_SWITCH: u8 = 20;
/// But after this many packets light is believed in any case: a device that sees much light sends
/// no packets without.
const PACKETS_UNTIL_BELIEVED: u8 = 200;
/// Packets of the other protocol's look in a row of such packets that change the protocol.
const VERSION_VOTES: u8 = 3;

/// The state of one USB device's stream.
#[derive(Debug, Clone, Default)]
pub struct Reader {
    ring: ImuRing,
    unwrap: TickUnwrap,
    /// Newest device time seen, from which times of 24 bits are extended.
    now: Option<u64>,
    blob: BlobReader,
    version: Option<Version>,
    /// A packet has told the protocol; until then it is a guess.
    told: bool,
    votes: u8,
    /// Packets without light, and of any kind, still to pass before light is believed.
    settling: (u8, u8),
}

impl Reader {
    /// Inertial samples so far, had a wired device's reports been read slot by slot.
    #[must_use]
    pub fn imu_in_slot_order(&self) -> u64 {
        self.ring.in_slot_order()
    }

    /// Appends to `events` what a packet said; events before an error are valid.
    ///
    /// # Errors
    /// The packet is not what the protocol says.
    pub fn packet(&mut self, packet: &Packet, events: &mut Vec<Event>) -> Result<(), DecodeError> {
        match packet.transfer {
            Transfer::Control(setup) => {
                if let Some(id) = setup.feature_read().filter(|_| packet.is_input()) {
                    self.feature(id, &packet.data, events)
                } else {
                    if setup.feature_write().is_some() {
                        self.written(&packet.data);
                    }
                    Ok(())
                }
            }
            Transfer::Interrupt if packet.is_input() => self.input(&packet.data, events),
            _ => Ok(()),
        }
    }

    fn input(&mut self, data: &[u8], events: &mut Vec<Event>) -> Result<(), DecodeError> {
        let Some((&id, data)) = data.split_first() else {
            return Ok(());
        };
        match id {
            id::IMU => {
                for raw in self.ring.samples(data)? {
                    let ticks = self.extend(raw.ticks);
                    events.push(Event::Imu { ticks, raw });
                }
                Ok(())
            }
            id::LIGHT => self.light(id, wire::light_report(data)?, events),
            id::PULSES_TRACKER | id::PULSES_HEADSET => wire::pulses(id, data, |pulse| {
                let ticks = self.near(pulse.ticks);
                let (sensor, length) = (pulse.sensor, pulse.length);
                events.push(Event::Pulse {
                    sensor,
                    length,
                    ticks,
                });
            }),
            id::RAW_BEAMS => {
                events.push(Event::RawBeams);
                Ok(())
            }
            id::INPUT => {
                events.extend(input::wired(data)?.map(Event::Wired));
                Ok(())
            }
            id::RADIO => self.radio(id, data, events),
            id::RADIO_TWO => {
                let (first, second) = data.split_at(data.len().min(PACKET_BYTES));
                self.radio(id, first, events)
                    .and(self.radio(id, second, events))
            }
            id::RADIO_OFF => {
                events.push(Event::Off);
                Ok(())
            }
            id::MAINBOARD => {
                events.push(Event::Mainboard(input::mainboard(data)?));
                Ok(())
            }
            // Some devices send an empty report at the start.
            0 => Ok(()),
            _ => Err(DecodeError::Malformed {
                id,
                what: "no report of this device has this id",
            }),
        }
    }

    fn feature(&mut self, id: u8, data: &[u8], events: &mut Vec<Event>) -> Result<(), DecodeError> {
        match id {
            id::CONFIGURATION_START => {
                self.blob.start(data);
                if !data.is_empty() {
                    events.push(Event::ConfigurationProgress);
                }
            }
            id::CONFIGURATION_READ => {
                if !data.is_empty() {
                    events.push(Event::ConfigurationProgress);
                }
                events.extend(self.blob.piece(data)?.map(Event::Configuration));
            }
            id::INPUT => {
                let [_, rest @ ..] = data else { return Ok(()) };
                let mut fields = Fields::new(id, rest);
                events.push(Event::Ranges(fields.u8()?, fields.u8()?));
            }
            _ => {}
        }
        Ok(())
    }

    /// The host wrote a feature report: a radio command `06 01 m` switches the light's mode.
    fn written(&mut self, data: &[u8]) {
        if let [id::RADIO_COMMAND, 0x87, 0x06, 0x01, ..] = data {
            self.settling = (PACKETS_AFTER_SWITCH, PACKETS_UNTIL_BELIEVED);
        }
    }

    fn light(&mut self, id: u8, stream: &[u8], events: &mut Vec<Event>) -> Result<(), DecodeError> {
        // Without any other time the light's 24 bits cannot be placed.
        let Some(now) = self.now else { return Ok(()) };
        wire::light_stream(id, stream, |light| {
            events.push(match light {
                Light::Sync {
                    channel,
                    time,
                    data,
                } => Event::Sync {
                    channel,
                    ticks: place(now, 2 * u64::from(time)),
                    data,
                },
                Light::Sweep {
                    channel,
                    sensor,
                    time,
                } => Event::Sweep {
                    channel,
                    sensor,
                    ticks: place(now, time.into()),
                },
            });
        })
    }

    fn radio(&mut self, id: u8, data: &[u8], events: &mut Vec<Event>) -> Result<(), DecodeError> {
        let packet = RadioPacket::new(id, data)?;
        events.push(Event::RadioPacket);
        let told = packet.version();
        let version = self.vote(told);
        let settled = self.settle(packet.has_light());
        let sent = self.near(packet.ticks());
        self.now = Some(self.now.map_or(sent, |now| now.max(sent)));
        let mut light = None;
        let parsed = packet.parts(version, |part| match part {
            Part::Imu(raw) => {
                let ticks = self.extend(raw.ticks);
                events.push(Event::Imu { ticks, raw });
            }
            Part::Battery(byte) => events.push(Event::Battery(byte)),
            Part::Input(input) => events.push(Event::Radio(input)),
            Part::Light(stream) => light = Some(stream),
        });
        match (version, light) {
            // What looks like light before the protocol is known, or while it changes, may be anything.
            (Version::V1, Some(bytes))
                if self.told && self.votes == 0 && settled && told.is_none() =>
            {
                self.radio_pulses(id, bytes, events)?;
            }
            (Version::V2, Some(stream)) if settled => self.light(id, stream, events)?,
            _ => {}
        }
        parsed
    }

    fn radio_pulses(
        &self,
        id: u8,
        bytes: &[u8],
        events: &mut Vec<Event>,
    ) -> Result<(), DecodeError> {
        let Some(now) = self.now else { return Ok(()) };
        events.extend(radio_pulses::pulses(id, bytes)?.map(|pulse| Event::Pulse {
            sensor: pulse.sensor,
            length: pulse.length,
            ticks: place(now, 2 * u64::from(pulse.ticks)) as u64,
        }));
        Ok(())
    }

    /// Counts a packet after a mode switch. Whether light may be believed again.
    fn settle(&mut self, has_light: bool) -> bool {
        let (dark, any) = self.settling;
        if dark == 0 || any == 0 {
            return true;
        }
        let dark = if has_light {
            PACKETS_AFTER_SWITCH
        } else {
            dark - 1
        };
        self.settling = (dark, any - 1);
        false
    }

    /// Which protocol is spoken: the packets themselves tell.
    fn vote(&mut self, seen: Option<Version>) -> Version {
        if seen.is_some() && !self.told {
            // The first that tells is believed against the guess.
            (self.version, self.told) = (seen, true);
        }
        let current = *self.version.get_or_insert(Version::V1);
        match seen {
            Some(seen) if seen != current => {
                self.votes += 1;
                if self.votes >= VERSION_VOTES {
                    self.version = Some(seen);
                    self.votes = 0;
                }
            }
            Some(_) => self.votes = 0,
            None => {}
        }
        self.version.unwrap_or(current)
    }

    /// Extends a sample's time, which then counts as the present.
    fn extend(&mut self, ticks: u32) -> u64 {
        let extended = self.unwrap.extend(ticks);
        self.now = Some(extended);
        extended
    }

    /// Extends a time without taking it for the present.
    fn near(&mut self, ticks: u32) -> u64 {
        match self.now {
            Some(now) => {
                let step = ticks.wrapping_sub(now as u32).cast_signed();
                now.saturating_add_signed(step.into())
            }
            None => self.unwrap.extend(ticks),
        }
    }
}

/// The time nearest to `now` (ticks) that agrees with the low 25 bits, counted in half ticks.
fn place(now: u64, half_ticks: u64) -> f64 {
    const RANGE: u64 = 1 << 25;
    let now = 2 * now;
    let ahead = half_ticks.wrapping_sub(now) % RANGE;
    let placed = if ahead < RANGE / 2 {
        now + ahead
    } else {
        (now + ahead).saturating_sub(RANGE)
    };
    placed as f64 / 2.0
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;
    use proptest::prelude::*;

    use super::*;
    use crate::usb::{Port, Setup};

    fn packet(transfer: Transfer, endpoint: u8, data: &[u8]) -> Packet {
        let port = Port { bus: 1, address: 2 };
        Packet {
            at: HostTime(0),
            port,
            endpoint,
            transfer,
            data: data.to_vec(),
        }
    }

    fn events(reader: &mut Reader, data: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        reader
            .packet(&packet(Transfer::Interrupt, 0x81, data), &mut events)
            .unwrap();
        events
    }

    /// A radio packet in its report; time bits 31 to 16 are 0x1234.
    fn radio(payload: &[u8]) -> Vec<u8> {
        let mut data = vec![0x23, 0x12, payload.len() as u8 + 1, 0x34];
        data.extend(payload);
        data.resize(30, 0);
        data
    }

    #[test]
    fn times_of_24_bits_are_placed_near_the_present() {
        assert_eq!(place(0x1_00ff_fff0, 2 * 0x10 + 1), 4_311_744_528.5);
        assert_eq!(place(0x1_0100_0010, 2 * 0xff_fff0), 4_311_744_496.0);
        assert_eq!(place(1000, 2 * 900 + 1), 900.5);
    }

    #[test]
    fn light_after_a_switch_has_to_settle() {
        let mut reader = Reader::default();
        let imu = radio(&[&[0x80][..], &[7; 13]].concat());
        let lit = radio(&[0x10, 0x61, 0x00, 0x00, 0x00, 0x01]);
        let is_light = |events: &[Event]| events.iter().any(|e| matches!(e, Event::Sync { .. }));
        events(&mut reader, &imu);
        assert!(is_light(&events(&mut reader, &lit)));
        let setup = Setup::from_bytes([0x21, 9, 0xff, 3, 0, 0, 9, 0]);
        let switch = [0xff, 0x87, 0x06, 0x01, 0x01, 0, 2, 0, 0];
        reader
            .packet(
                &packet(Transfer::Control(setup), 0, &switch),
                &mut Vec::new(),
            )
            .unwrap();
        for _ in 0..19 {
            events(&mut reader, &imu);
        }
        assert!(
            !is_light(&events(&mut reader, &lit)),
            "light starts the count again"
        );
        for _ in 0..20 {
            events(&mut reader, &imu);
        }
        assert!(is_light(&events(&mut reader, &lit)));
        reader
            .packet(
                &packet(Transfer::Control(setup), 0, &switch),
                &mut Vec::new(),
            )
            .unwrap();
        for _ in 0..200 {
            assert!(!is_light(&events(&mut reader, &lit)));
        }
        assert!(
            is_light(&events(&mut reader, &lit)),
            "light without end is light"
        );
    }

    #[test]
    fn the_packets_tell_the_protocol() {
        let mut reader = Reader::default();
        let first = radio(&[&[0xe8][..], &[7; 13]].concat());
        let second = radio(&[&[0x80][..], &[7; 13]].concat());
        let samples = |events: Vec<Event>| {
            events
                .iter()
                .filter(|event| matches!(event, Event::Imu { .. }))
                .count()
        };
        assert_eq!(samples(events(&mut reader, &first)), 1);
        let counts: Vec<_> = (0..4)
            .map(|_| samples(events(&mut reader, &second)))
            .collect();
        assert_eq!(counts, [0, 0, 1, 1]);
    }

    #[test]
    fn unknown_reports_are_errors_and_lose_nothing_else() {
        let mut reader = Reader::default();
        let mut events = Vec::new();
        let unknown = packet(Transfer::Interrupt, 0x81, &[0x77, 1, 2]);
        assert!(reader.packet(&unknown, &mut events).is_err());
        let torn = packet(Transfer::Interrupt, 0x81, &[0x20; 20]);
        assert!(reader.packet(&torn, &mut events).is_err());
        assert!(events.is_empty());
        let whole = packet(Transfer::Interrupt, 0x81, &[0x20; 52]);
        reader.packet(&whole, &mut events).unwrap();
        assert_eq!(events.len(), 1);
    }

    proptest! {
        #[test]
        fn any_packets_are_survived(
            packets in prop::collection::vec(
                (any::<[u8; 8]>(), 0u8..4, prop::collection::vec(any::<u8>(), 0..66)), 0..40)
        ) {
            let (mut reader, mut events) = (Reader::default(), Vec::new());
            for (setup, kind, mut data) in packets {
                let known = [0x01, 0x03, 0x20, 0x21, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28];
                if let Some(first) = data.first_mut() {
                    *first = known.get(usize::from(*first) % 16).copied().unwrap_or(*first);
                }
                let transfer = if kind == 0 {
                    let value = [0x01, 0x10, 0x11, 0xff][usize::from(setup[0] % 4)];
                    Transfer::Control(Setup::from_bytes([0xa1, 1, value, 3, 0, 0, 64, 0]))
                } else {
                    Transfer::Interrupt
                };
                let _ = reader.packet(&packet(transfer, 0x81, &data), &mut events);
            }
            for event in events {
                if let Event::Sync { ticks, .. } | Event::Sweep { ticks, .. } = event {
                    prop_assert!(ticks.is_finite());
                }
            }
        }
    }
}
