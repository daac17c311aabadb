//! What can be said to a Lighthouse device: every feature report that posed writes, typed. The
//! bytes are those that captures of SteamVR and of libsurvive show.

use super::wire::id;
use crate::{decode::Command, haptic::Haptic};

/// Interface that takes the feature reports.
const INTERFACE: u8 = 0;
/// A feature report's length, report id included.
const FEATURE_BYTES: u16 = 64;

/// How a device is reached, where that changes the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// By its cable.
    Wired,
    /// Through its dongle.
    Radio,
}

/// A feature report for a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Light is reported as pulses (generation 1), or undecoded (generation 2).
    EnableLighthouse,
    /// Light of generation 2 is decoded by the device.
    LightStream,
    /// Everything is reported.
    ReportAll,
    /// The dongle's radio is switched on.
    RadioOn,
    /// As [`Output::EnableLighthouse`], by radio.
    RadioLightRaw,
    /// The device by radio speaks version 2 of its protocol.
    RadioProtocol,
    /// As [`Output::LightStream`], by radio; trackers and wands change to version 2 with it.
    RadioLightStream,
    /// A Vive's mainboard switches display and sensors on, or off.
    Power(bool),
    /// The device by radio is switched off.
    RadioPowerOff,
    /// A buzz: `pulses` times `on_us` on and `off_us` off, microseconds.
    Haptic {
        /// Cable or radio.
        reach: Reach,
        /// Microseconds on.
        on_us: u16,
        /// Microseconds off.
        off_us: u16,
        /// How often.
        pulses: u16,
    },
}

impl Output {
    /// The report, its id first.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        const RADIO: u8 = id::RADIO_COMMAND;
        match self {
            Self::EnableLighthouse => vec![id::MODE, 0, 0, 0, 0],
            Self::LightStream => vec![id::MODE, 1, 0, 0, 0],
            Self::ReportAll => vec![id::VERBOSITY, 3, 0, 0, 0],
            Self::RadioOn => vec![
                RADIO, 0x96, 0x10, 0xbe, 0x5b, 0x32, 0x54, 0x11, 0xcf, 0x83, 0x75, 0x53, 0x8a,
                0x08, 0x6a, 0x53, 0x58, 0xd0, 0xb1,
            ],
            Self::RadioLightRaw => vec![RADIO, 0x87, 6, 1, 0, 0, 2, 0, 0],
            Self::RadioProtocol => vec![RADIO, 0x87, 3, 0, 1, 0],
            Self::RadioLightStream => vec![RADIO, 0x87, 6, 1, 1, 0, 2, 0, 0],
            Self::Power(on) => {
                let on = u8::from(on);
                let mut data = vec![id::MODE, 0x78, 0x29, 0x38, on, 0, 0, 0, 0, 0, 2, 0, on];
                data.resize(usize::from(FEATURE_BYTES), 0);
                data
            }
            Self::RadioPowerOff => [&[RADIO, 0x9f, 4][..], b"off!"].concat(),
            Self::Haptic {
                reach,
                on_us,
                off_us,
                pulses,
            } => {
                let mut data = match reach {
                    Reach::Wired => vec![id::HAPTIC, 7, 0],
                    Reach::Radio => vec![RADIO, id::HAPTIC, 7, 0],
                };
                for value in [on_us, off_us, pulses] {
                    data.extend(value.to_le_bytes());
                }
                data
            }
        }
    }

    /// As a request to the device.
    #[must_use]
    pub fn command(self) -> Command {
        Command::SetFeature {
            interface: INTERFACE,
            data: self.bytes(),
        }
    }
}

/// A controller's coil is under current for no longer than this at a time, microseconds; OpenVR's
/// limit of a pulse.
const ON_MAX_US: f32 = 3_999.0;

/// A buzz: at full strength the coil is under current for half of the time.
pub(super) fn haptic(reach: Reach, haptic: &Haptic) -> Output {
    let period = haptic.period_us();
    let on = (0.5 * period * haptic.strength()).min(ON_MAX_US);
    Output::Haptic {
        reach,
        on_us: on as u16,
        off_us: (period - on) as u16,
        pulses: haptic.periods(),
    }
}

/// A request for a feature report.
pub(super) fn get(id: u8) -> Command {
    Command::GetFeature {
        interface: INTERFACE,
        id,
        length: FEATURE_BYTES,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buzz_is_a_square_wave() {
        let bytes = |seconds, hertz, strength| {
            let wave = Haptic::new(seconds, hertz, strength).unwrap();
            haptic(Reach::Radio, &wave).bytes()
        };
        // 200 Hz: 2,500 us on and as many off, 60 times.
        assert_eq!(
            bytes(0.3, 200.0, 1.0),
            [0xff, 0x8f, 7, 0, 0xc4, 9, 0xc4, 9, 60, 0]
        );
        // A fifth of that strength: 500 us on, 4,500 off.
        assert_eq!(
            bytes(0.3, 200.0, 0.2),
            [0xff, 0x8f, 7, 0, 0xf4, 1, 0x94, 0x11, 60, 0]
        );
        // Slow ones are on for no longer than a coil can bear, and there is one at least.
        assert_eq!(
            bytes(0.001, 20.0, 1.0),
            [0xff, 0x8f, 7, 0, 0x9f, 0x0f, 0xb1, 0xb3, 1, 0]
        );
        for (seconds, hertz, strength) in [
            (0.0, 200.0, 1.0),
            (11.0, 200.0, 1.0),
            (1.0, 1e9, 1.0),
            (1.0, 200.0, 1.1),
            (f32::NAN, 200.0, 1.0),
            (1.0, f32::NAN, 1.0),
        ] {
            assert!(Haptic::new(seconds, hertz, strength).is_err());
        }
    }

    /// From captures of SteamVR's "identify controller", on a cable and by radio (LighthouseRedox,
    /// "klicking identify controller"), of a remote switch-off ("turning wireless controller off
    /// remotely"), and of a headset on standby and awake ("System/05", "System/03"). What follows
    /// these bytes there is rubbish from the host's memory.
    #[test]
    fn reports_are_those_of_captures() {
        let haptic = |reach, off_us| Output::Haptic {
            reach,
            on_us: 500,
            off_us,
            pulses: 1,
        };
        let wired = haptic(Reach::Wired, 0xd400).bytes();
        assert_eq!(wired, [0x8f, 7, 0, 0xf4, 1, 0, 0xd4, 1, 0]);
        let radio = haptic(Reach::Radio, 0xa2b5).bytes();
        assert_eq!(radio, [0xff, 0x8f, 7, 0, 0xf4, 1, 0xb5, 0xa2, 1, 0]);
        let off = Output::RadioPowerOff.bytes();
        assert_eq!(off, [0xff, 0x9f, 4, 0x6f, 0x66, 0x66, 0x21]);
        let standby = Output::Power(false).bytes();
        assert_eq!(
            standby[..13],
            [4, 0x78, 0x29, 0x38, 0, 0, 0, 0, 0, 0, 2, 0, 0]
        );
        let awake = Output::Power(true).bytes();
        assert_eq!(
            awake[..13],
            [4, 0x78, 0x29, 0x38, 1, 0, 0, 0, 0, 0, 2, 0, 1]
        );
    }
}
