//! What a device has to be told before it streams, and how its configuration is asked for. The
//! reports are those that captures of SteamVR and of libsurvive show.

use posed_signal::{HostTime, time::MILLISECOND_NS};

use super::{
    Variant,
    output::{Output, get},
    pulses::FLASH_LENGTH,
    reader::Event,
    wire::id,
};
use crate::decode::Command;

/// Pieces of the configuration asked for at a tick; one holds 62 bytes.
const PIECES: usize = 24;
/// A read of the configuration without an answer for this long starts over.
const READ_PATIENCE_MS: u64 = 500;
/// So long a device by radio is listened to for flashes, before its light's mode is switched.
const LISTEN_MS: u64 = 500;
/// So many flashes show that the base stations are of generation 1.
const FLASHES_MIN: u32 = 16;
/// Between two attempts to switch the light's mode.
const SWITCH_INTERVAL_MS: u64 = 2_000;

/// The start of one device.
#[derive(Debug, Clone)]
pub(super) struct Startup {
    variant: Variant,
    configured: bool,
    /// The configuration's read goes on.
    reading: bool,
    /// Newest sign of life in the read, or its start.
    read_at: Option<HostTime>,
    /// When the configuration was there.
    configured_at: Option<HostTime>,
    /// The device waits for the light's mode switch, or shows no light at all.
    wants_switch: bool,
    /// Flashes of generation-1 base stations: there is no mode for them to be switched to.
    flashes: u32,
    switched_at: Option<HostTime>,
}

impl Startup {
    pub(super) fn new(variant: Variant) -> Self {
        Self {
            variant,
            configured: false,
            reading: false,
            read_at: None,
            configured_at: None,
            wants_switch: false,
            flashes: 0,
            switched_at: None,
        }
    }

    /// Takes note of what the device said.
    pub(super) fn event(&mut self, event: &Event, at: HostTime) {
        match event {
            Event::ConfigurationProgress => {
                self.reading = true;
                self.read_at = Some(at);
            }
            Event::Configuration(_) => {
                self.configured = true;
                self.reading = false;
                self.configured_at = Some(at);
                self.wants_switch |= self.variant == Variant::Watchman;
            }
            Event::RawBeams => self.wants_switch = true,
            Event::Sync { .. } => self.wants_switch = false,
            Event::Pulse { length, .. } if *length >= FLASH_LENGTH => {
                self.flashes = self.flashes.saturating_add(1);
            }
            // It may come back with its mode forgotten, or as another device.
            Event::Off => *self = Self::new(self.variant),
            _ => {}
        }
    }

    /// What to send now.
    pub(super) fn tick(&mut self, now: HostTime, commands: &mut Vec<Command>) {
        let since = |then: Option<HostTime>| then.map(|then| now.since_ns(then));
        let passed =
            |then, ms: u64| since(then).is_none_or(|ns| ns >= (ms * MILLISECOND_NS) as i64);
        if !self.configured {
            if self.reading {
                commands.extend((0..PIECES).map(|_| get(id::CONFIGURATION_READ)));
            }
            if passed(self.read_at, READ_PATIENCE_MS) {
                self.reading = false;
                self.read_at = Some(now);
                self.begin(commands);
            }
        } else if self.wants_switch
            && self.flashes < FLASHES_MIN
            && (self.variant != Variant::Watchman || passed(self.configured_at, LISTEN_MS))
            && passed(self.switched_at, SWITCH_INTERVAL_MS)
        {
            self.switched_at = Some(now);
            self.switch(commands);
        }
    }

    fn begin(&self, commands: &mut Vec<Command>) {
        let reports: &[Output] = match self.variant {
            Variant::Watchman => &[
                Output::RadioOn,
                Output::RadioLightRaw,
                Output::RadioProtocol,
            ],
            Variant::Wired(_) => &[Output::EnableLighthouse, Output::ReportAll],
            Variant::Mainboard => return,
        };
        commands.extend(reports.iter().map(|report| report.command()));
        commands.extend([get(id::INPUT), get(id::CONFIGURATION_START)]);
    }

    fn switch(&self, commands: &mut Vec<Command>) {
        let reports: &[Output] = match self.variant {
            Variant::Watchman => &[Output::RadioLightStream],
            Variant::Wired(_) => &[Output::LightStream, Output::ReportAll],
            Variant::Mainboard => return,
        };
        commands.extend(reports.iter().map(|report| report.command()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lighthouse::ImuClass;

    fn set(data: &[u8]) -> Command {
        Command::SetFeature {
            interface: 0,
            data: data.to_vec(),
        }
    }

    fn at(ms: u64) -> HostTime {
        HostTime(ms * MILLISECOND_NS)
    }

    fn sent(startup: &mut Startup, ms: u64) -> Vec<Command> {
        let mut commands = Vec::new();
        startup.tick(at(ms), &mut commands);
        commands
    }

    #[test]
    fn a_wired_device_is_asked_until_it_answers() {
        let mut startup = Startup::new(Variant::Wired(ImuClass::Headset));
        let first = sent(&mut startup, 0);
        assert_eq!(first[0], set(&[4, 0, 0, 0, 0]));
        assert_eq!(first.last(), Some(&get(0x10)));
        assert!(sent(&mut startup, 100).is_empty(), "patience");
        assert_eq!(sent(&mut startup, 600), first, "it was asleep");
        startup.event(&Event::ConfigurationProgress, at(610));
        assert_eq!(sent(&mut startup, 700), vec![get(0x11); PIECES]);
        startup.event(&Event::Configuration(String::new()), at(800));
        assert!(sent(&mut startup, 900).is_empty());
        startup.event(&Event::RawBeams, at(1_000));
        assert_eq!(
            sent(&mut startup, 1_000),
            [set(&[4, 1, 0, 0, 0]), set(&[7, 3, 0, 0, 0])]
        );
        assert!(sent(&mut startup, 1_100).is_empty());
        startup.event(
            &Event::Sync {
                channel: 1,
                ticks: 0.0,
                data: false,
            },
            at(1_200),
        );
        assert!(sent(&mut startup, 9_000).is_empty(), "it streams");
    }

    #[test]
    fn a_radio_device_is_switched_until_light_comes() {
        let mut startup = Startup::new(Variant::Watchman);
        assert_eq!(sent(&mut startup, 0).len(), 5);
        startup.event(&Event::Configuration(String::new()), at(10));
        assert!(sent(&mut startup, 20).is_empty(), "there may be flashes");
        assert_eq!(
            sent(&mut startup, 600),
            [Output::RadioLightStream.command()]
        );
        assert_eq!(
            sent(&mut startup, 3_000),
            [Output::RadioLightStream.command()],
            "it did not hear"
        );
        startup.event(
            &Event::Sync {
                channel: 1,
                ticks: 0.0,
                data: false,
            },
            at(3_100),
        );
        assert!(sent(&mut startup, 9_000).is_empty());
        startup.event(&Event::Off, at(9_100));
        assert_eq!(sent(&mut startup, 9_200).len(), 5, "from the start");
    }

    #[test]
    fn a_wand_that_sees_flashes_is_left_as_it_is() {
        let mut startup = Startup::new(Variant::Watchman);
        sent(&mut startup, 0);
        startup.event(&Event::Configuration(String::new()), at(10));
        for ticks in 0..20 {
            let flash = Event::Pulse {
                sensor: 1,
                length: 3_000,
                ticks,
            };
            startup.event(&flash, at(100));
        }
        assert!(sent(&mut startup, 9_000).is_empty());
    }
}
