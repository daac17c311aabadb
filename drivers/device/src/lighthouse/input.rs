//! Buttons, triggers and pads: from the bits of each kind of device to OpenXR's names.

use posed_signal::{Battery, Buttons, HostTime};

use super::{
    radio::RadioInput,
    wire::{Fields, id},
};
use crate::decode::DecodeError;

/// What hangs on the bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Controls {
    /// A Vive wand: trigger, pad, grip, menu, system.
    Wand,
    /// An Index controller: trigger, stick and pad, A, B, system, grip force.
    Index,
    /// A tracker, whose only button is the system's, or a headset.
    #[default]
    Other,
}

/// Input of a report 0x01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WiredInput {
    /// A controller's or tracker's buttons.
    Buttons {
        /// Bit set of pressed and touched buttons.
        buttons: u32,
        /// Trigger, 0 to 32767.
        trigger: u16,
        /// Pad, x and y.
        pad: [i16; 2],
    },
    /// An Index headset.
    Headset {
        /// Distance of the lenses, in units that are not known.
        ipd: u16,
        /// The proximity sensor's reading.
        proximity: u16,
        /// Whether the headset is worn.
        worn: bool,
    },
    /// Battery: bit 7 charging, the others per cent.
    Battery(u8),
}

/// Reads a report 0x01; `None` for kinds that hold nothing of use.
pub(super) fn wired(data: &[u8]) -> Result<Option<WiredInput>, DecodeError> {
    let mut fields = Fields::new(id::INPUT, data);
    let kind = fields.u16()?;
    let _counter = fields.bytes::<5>()?;
    Ok(match kind {
        0x0100 => {
            let buttons = fields.u32()?;
            let _coarse_trigger_and_battery = fields.bytes::<8>()?;
            let pad = [fields.i16()?, fields.i16()?];
            let _unknown = fields.u16()?;
            Some(WiredInput::Buttons {
                buttons,
                trigger: fields.u16()?,
                pad,
            })
        }
        0x0400 => {
            let _voltage = fields.bytes::<6>()?;
            Some(WiredInput::Battery(fields.u8()?))
        }
        0x0800 => {
            let _unknown = fields.u32()?;
            let (ipd, proximity) = (fields.u16()?, fields.u16()?);
            let _unknown = fields.u32()?;
            Some(WiredInput::Headset {
                ipd,
                proximity,
                worn: fields.u8()? != 0,
            })
        }
        _ => None,
    })
}

/// What a Vive's mainboard says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MainboardInput {
    /// Distance of the lenses, hundredths of a millimetre.
    pub ipd: u16,
    /// The proximity sensor's reading: libsurvive takes 80 and more for a face.
    pub proximity: u16,
    /// Whether the button on the headset is pressed.
    pub button: bool,
}

impl MainboardInput {
    /// Whether the headset is worn.
    #[must_use]
    pub fn is_worn(&self) -> bool {
        self.proximity >= 80
    }
}

/// Reads a mainboard's report 0x03.
pub(super) fn mainboard(data: &[u8]) -> Result<MainboardInput, DecodeError> {
    let mut fields = Fields::new(id::MAINBOARD, data);
    let _unknown = fields.bytes::<2>()?;
    let _lens_and_its_separation = fields.bytes::<3>()?;
    let _unknown = fields.bytes::<2>()?;
    let button = fields.u8()? != 0;
    let _unknown_and_change_of_proximity = fields.bytes::<5>()?;
    Ok(MainboardInput {
        proximity: fields.u16()?,
        ipd: fields.u16()?,
        button,
    })
}

/// A battery byte: bit 7 charging, the others per cent.
pub(super) fn battery(byte: u8, at: HostTime) -> Battery {
    let charge = f32::from(byte & 0x7f).min(100.0) / 100.0;
    Battery {
        at,
        charge,
        charging: byte & 0x80 != 0,
    }
}

/// (bit, button) in the order of bits.
type Map = &'static [(u8, u32)];

const WAND_WIRED: Map = &[
    (0, Buttons::TRIGGER),
    (2, Buttons::SQUEEZE),
    (12, Buttons::MENU),
    (13, Buttons::SYSTEM),
    (18, Buttons::TRACKPAD),
];
const WAND_WIRED_TOUCHED: Map = &[(20, Buttons::TRACKPAD)];
const TRACKER_WIRED: Map = &[(13, Buttons::SYSTEM)];
const WAND_RADIO: Map = &[
    (0, Buttons::TRIGGER),
    (2, Buttons::TRACKPAD),
    (3, Buttons::SYSTEM),
    (4, Buttons::SQUEEZE),
    (5, Buttons::MENU),
];
const INDEX_RADIO: Map = &[
    (0, Buttons::TRIGGER),
    (2, Buttons::THUMBSTICK),
    (3, Buttons::SYSTEM),
    (4, Buttons::A),
    (5, Buttons::B),
    (6, Buttons::MENU),
];
/// In both radio maps the pad's touch travels with the pressed buttons.
const PAD_TOUCHED: Map = &[(1, Buttons::TRACKPAD)];
const INDEX_TOUCHED: Map = &[
    (0, Buttons::TRIGGER),
    (3, Buttons::SYSTEM),
    (4, Buttons::A),
    (5, Buttons::B),
    (6, Buttons::THUMBSTICK),
];

fn mapped(bits: u32, map: Map) -> u32 {
    map.iter()
        .filter(|(bit, _)| bits >> bit & 1 != 0)
        .fold(0, |set, (_, button)| set | button)
}

/// Keeps a device's state, since radio packets hold changes only.
#[derive(Debug, Clone)]
pub(super) struct InputState {
    controls: Controls,
    state: Buttons,
    pad_touched: u32,
    touched: u32,
}

impl InputState {
    pub(super) fn new(controls: Controls) -> Self {
        let state = Buttons::released(HostTime(0));
        Self {
            controls,
            state,
            pad_touched: 0,
            touched: 0,
        }
    }

    /// The state after a radio packet.
    pub(super) fn radio(&mut self, input: &RadioInput, at: HostTime) -> Buttons {
        if let Some(bits) = input.buttons {
            let map = match self.controls {
                Controls::Index => INDEX_RADIO,
                Controls::Wand => WAND_RADIO,
                Controls::Other => &[(0, Buttons::SYSTEM), (3, Buttons::SYSTEM)],
            };
            self.state.pressed = mapped(bits.into(), map);
            self.pad_touched = mapped(bits.into(), PAD_TOUCHED);
        }
        if let Some(bits) = input.touched {
            self.touched = mapped(bits.into(), INDEX_TOUCHED);
        }
        if let Some(trigger) = input.trigger {
            self.state.trigger = f32::from(trigger) / 255.0;
        }
        if let Some(grip) = input.grip {
            self.state.squeeze = f32::from(grip) / 255.0;
        }
        if let Some(pad) = input.pad {
            self.state.stick = pad.map(axis);
        }
        self.finish(at)
    }

    /// The state after a report 0x01; `None` where that held no buttons.
    pub(super) fn wired(&mut self, input: &WiredInput, at: HostTime) -> Option<Buttons> {
        match *input {
            WiredInput::Buttons {
                buttons,
                trigger,
                pad,
            } => {
                let wand = self.controls == Controls::Wand;
                let map = if wand { WAND_WIRED } else { TRACKER_WIRED };
                self.state.pressed = mapped(buttons, map);
                self.touched = mapped(buttons, WAND_WIRED_TOUCHED);
                self.state.trigger = f32::from(trigger.min(32_767)) / 32_767.0;
                self.state.stick = pad.map(axis);
            }
            WiredInput::Headset { worn, .. } => {
                self.state.pressed = if worn { Buttons::PROXIMITY } else { 0 };
            }
            WiredInput::Battery(_) => return None,
        }
        Some(self.finish(at))
    }

    fn finish(&mut self, at: HostTime) -> Buttons {
        self.state.at = at;
        self.state.touched = self.touched | self.pad_touched;
        if self.controls == Controls::Wand {
            // A wand's grip is a switch.
            let held = self.state.pressed & Buttons::SQUEEZE != 0;
            self.state.squeeze = if held { 1.0 } else { 0.0 };
        }
        self.state
    }
}

fn axis(value: i16) -> f32 {
    (f32::from(value) / 32_767.0).max(-1.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn report(bytes: &str) -> Vec<u8> {
        let digit = |at| u8::from_str_radix(&bytes[at..at + 2], 16).unwrap();
        let mut data: Vec<u8> = (2..bytes.len()).step_by(2).map(digit).collect();
        data.resize(63, 0);
        data
    }

    /// The beginnings of reports in a capture of a wired wand (libsurvive-extras-data,
    /// wand-wired-all-buttons): trigger pulled with a thumb on the pad, grip, menu.
    #[test]
    fn a_wired_wand_is_read() {
        let mut state = InputState::new(Controls::Wand);
        let at = HostTime(5);
        let mut next = |bytes| {
            state
                .wired(&wired(&report(bytes)).unwrap().unwrap(), at)
                .unwrap()
        };
        let pulled = "0100013cb206000001001400ff00000045f9efffa017d24b0000ff7f";
        let buttons = next(pulled);
        assert_eq!(buttons.pressed, Buttons::TRIGGER | Buttons::TRACKPAD);
        assert_eq!((buttons.touched, buttons.trigger), (Buttons::TRACKPAD, 1.0));
        assert!((buttons.stick[0] - 0.184).abs() < 1e-3 && (buttons.stick[1] - 0.592).abs() < 1e-3);
        let grip = next("0100013c60060000040000000000000045f9efff");
        assert_eq!((grip.pressed, grip.squeeze), (Buttons::SQUEEZE, 1.0));
        assert_eq!(
            next("0100013c69060000001000000000000045f9efff").pressed,
            Buttons::MENU
        );
        assert_eq!(
            next("0100013c83060000002000000000000045f9efff").pressed,
            Buttons::SYSTEM
        );
    }

    /// From the same capture, and from an Index headset's (vive-index-cal).
    #[test]
    fn battery_and_headset_are_read() {
        let found = wired(&report("0100040b2006000000000000fa0f9700")).unwrap();
        assert_eq!(found, Some(WiredInput::Battery(0x97)));
        let found = battery(0x97, HostTime(1));
        assert_eq!((found.charge, found.charging), (0.23, true));
        let idle = "01000816000000000000000061a84200000000000001c124b401";
        let expected = WiredInput::Headset {
            ipd: 0xa861,
            proximity: 0x42,
            worn: false,
        };
        assert_eq!(wired(&report(idle)).unwrap(), Some(expected));
        assert_eq!(wired(&report("0100073cf600")).unwrap(), None, "of no use");
    }

    /// A Vive's mainboard while a hand is before its proximity sensor (LighthouseRedox, System/05).
    #[test]
    fn a_mainboard_is_read() {
        let found = mainboard(&report("03d02c3c270600000000000002004300441b00")).unwrap();
        let expected = MainboardInput {
            ipd: 6_980,
            proximity: 67,
            button: false,
        };
        assert_eq!((found, found.is_worn()), (expected, false));
        assert!(mainboard(&[0; 16]).is_err());
    }

    #[test]
    fn radio_input_adds_up() {
        let mut state = InputState::new(Controls::Index);
        let pressed = RadioInput {
            buttons: Some(0x11),
            ..RadioInput::default()
        };
        let touched = RadioInput {
            touched: Some(0x50),
            grip: Some(255),
            ..RadioInput::default()
        };
        assert_eq!(
            state.radio(&pressed, HostTime(1)).pressed,
            Buttons::TRIGGER | Buttons::A
        );
        let both = state.radio(&touched, HostTime(2));
        assert_eq!(
            both.pressed,
            Buttons::TRIGGER | Buttons::A,
            "what did not change stays"
        );
        assert_eq!(
            (both.touched, both.squeeze),
            (Buttons::A | Buttons::THUMBSTICK, 1.0)
        );
    }

    proptest! {
        #[test]
        fn any_report_gives_sound_input(
            data in prop::collection::vec(any::<u8>(), 0..70),
            buttons: u8, trigger: u8, pad: [i16; 2],
        ) {
            for controls in [Controls::Wand, Controls::Index, Controls::Other] {
                let mut state = InputState::new(controls);
                let input = RadioInput {
                    buttons: Some(buttons), trigger: Some(trigger), pad: Some(pad),
                    touched: Some(buttons), grip: Some(trigger),
                };
                let mut found = vec![state.radio(&input, HostTime(0))];
                if let Ok(Some(input)) = wired(&data) {
                    found.extend(state.wired(&input, HostTime(0)));
                }
                for state in found {
                    prop_assert!((0.0..=1.0).contains(&state.trigger));
                    prop_assert!((0.0..=1.0).contains(&state.squeeze));
                    prop_assert!(state.stick.iter().all(|axis| (-1.0..=1.0).contains(axis)));
                }
            }
        }
    }
}
