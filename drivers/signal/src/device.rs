//! Which device, and where on the body it is worn.

use std::fmt;

/// At most this many devices are tracked at once; ids are indices below it.
pub const DEVICES_MAX: usize = 32;

/// A device's index for this run of the daemon; stable while the daemon runs, also over a re-plug.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceId(pub u8);

/// A device's serial number, for example `LHR-DFCF00EE`; at most [`Serial::BYTES_MAX`] bytes of
/// printable ASCII, anything else replaced by `?`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Serial {
    bytes: [u8; Self::BYTES_MAX],
    len: u8,
}

impl Serial {
    /// Longer serials are cut.
    pub const BYTES_MAX: usize = 31;

    /// Takes the first [`Serial::BYTES_MAX`] characters.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut bytes = [0; Self::BYTES_MAX];
        let mut len = 0;
        for (slot, c) in bytes.iter_mut().zip(text.chars()) {
            *slot = if c.is_ascii_graphic() { c as u8 } else { b'?' };
            len += 1;
        }
        Self { bytes, len }
    }

    /// The serial as text; empty while it is not known.
    #[must_use]
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or("")
    }
}

impl Default for Serial {
    fn default() -> Self {
        Self::new("")
    }
}

impl fmt::Display for Serial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for Serial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// What a device stands for on the wearer's body. Names follow the OpenXR tracker roles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[repr(u8)]
pub enum Role {
    /// Not assigned to a body part.
    #[default]
    None,
    /// The headset.
    Head,
    /// The left controller or hand.
    LeftHand,
    /// The right controller or hand.
    RightHand,
    /// Tracker on the pelvis.
    Waist,
    /// Tracker on the chest.
    Chest,
    /// Tracker on the left foot.
    LeftFoot,
    /// Tracker on the right foot.
    RightFoot,
    /// Tracker on the left shank.
    LeftKnee,
    /// Tracker on the right shank.
    RightKnee,
    /// Tracker on the left upper arm.
    LeftElbow,
    /// Tracker on the right upper arm.
    RightElbow,
    /// Tracker on the left forearm.
    LeftWrist,
    /// Tracker on the right forearm.
    RightWrist,
}

impl Role {
    /// Number of roles, [`Role::None`] included; `role as usize` is below it.
    pub const COUNT: usize = 14;
    /// Every role, in the order of their numbers.
    pub const ALL: [Self; Self::COUNT] = [
        Self::None,
        Self::Head,
        Self::LeftHand,
        Self::RightHand,
        Self::Waist,
        Self::Chest,
        Self::LeftFoot,
        Self::RightFoot,
        Self::LeftKnee,
        Self::RightKnee,
        Self::LeftElbow,
        Self::RightElbow,
        Self::LeftWrist,
        Self::RightWrist,
    ];

    /// The role's name in configuration files, JSON and on the terminal.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Head => "head",
            Self::LeftHand => "left_hand",
            Self::RightHand => "right_hand",
            Self::Waist => "waist",
            Self::Chest => "chest",
            Self::LeftFoot => "left_foot",
            Self::RightFoot => "right_foot",
            Self::LeftKnee => "left_knee",
            Self::RightKnee => "right_knee",
            Self::LeftElbow => "left_elbow",
            Self::RightElbow => "right_elbow",
            Self::LeftWrist => "left_wrist",
            Self::RightWrist => "right_wrist",
        }
    }

    /// The inverse of [`Role::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_count_and_names_agree() {
        for (index, role) in Role::ALL.into_iter().enumerate() {
            assert_eq!(role as usize, index);
            assert_eq!(Role::from_name(role.name()), Some(role));
        }
        assert_eq!(Role::from_name("tail"), None);
    }

    #[test]
    fn serials_are_cut_and_printable() {
        assert_eq!(Serial::new("LHR-DFCF00EE").as_str(), "LHR-DFCF00EE");
        assert_eq!(Serial::new("a\nb\u{e9}").as_str(), "a?b?");
        assert_eq!(
            Serial::new(&"x".repeat(99)).as_str().len(),
            Serial::BYTES_MAX
        );
    }
}
