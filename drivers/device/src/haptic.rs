//! Buzzes that a controller can be asked for.

use posed_signal::DeviceId;

/// A buzz: a square wave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Haptic {
    seconds: f32,
    hertz: f32,
    strength: f32,
}

/// A buzz cannot be had.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum HapticError {
    /// A number makes no sense.
    #[error("a buzz lasts over 0 and up to 10 s, at 20 to 1000 Hz, with a strength of 0 to 1")]
    Range,
    /// Nothing is there.
    #[error("there is no device {}", .0.0)]
    NoDevice(DeviceId),
    /// It has nothing that could buzz.
    #[error("device {} has nothing that could buzz", .0.0)]
    NoMotor(DeviceId),
}

impl Haptic {
    /// A buzz of `seconds` at `hertz`, with a `strength` of 0 to 1.
    ///
    /// # Errors
    /// A number is out of its range.
    pub fn new(seconds: f32, hertz: f32, strength: f32) -> Result<Self, HapticError> {
        // NaN is in no range.
        let sensible = seconds > 0.0
            && seconds <= 10.0
            && (20.0..=1000.0).contains(&hertz)
            && (0.0..=1.0).contains(&strength);
        let haptic = Self {
            seconds,
            hertz,
            strength,
        };
        sensible.then_some(haptic).ok_or(HapticError::Range)
    }

    /// How long a period takes, microseconds.
    #[must_use]
    pub fn period_us(&self) -> f32 {
        1e6 / self.hertz
    }

    /// How many periods there are, at least one.
    #[must_use]
    pub fn periods(&self) -> u16 {
        (self.seconds * self.hertz).round().max(1.0) as u16
    }

    /// 0 to 1.
    #[must_use]
    pub fn strength(&self) -> f32 {
        self.strength
    }
}
