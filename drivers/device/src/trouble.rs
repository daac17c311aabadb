//! What keeps a device from being tracked as well as it could be, and what its user can do about it.

use crate::lighthouse::base_station::Source;

/// Something that is wrong for a device now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Trouble {
    /// It sees no base station.
    Dark,
    /// No base station has a place yet.
    Unmeasured,
    /// It sees a single base station.
    Alone(Source),
    /// A base station that it sees has no place yet, others do.
    New(Source),
    /// A base station was seen to stand elsewhere, or to be another one.
    Moved(Source),
    /// Two base stations are set to one channel.
    Shared(Source),
    /// Base stations' places are given, and this one's is not among them.
    Unlisted(Source),
    /// Its light does not come from where it is given to stand.
    Misplaced(Source),
    /// Nothing fits the places that are given.
    Contradicted,
}

impl Trouble {
    /// The trouble's name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Unmeasured => "unmeasured",
            Self::Alone(_) => "alone",
            Self::New(_) => "new",
            Self::Moved(_) => "moved",
            Self::Shared(_) => "shared",
            Self::Unlisted(_) => "unlisted",
            Self::Misplaced(_) => "misplaced",
            Self::Contradicted => "contradicted",
        }
    }

    /// The base station that it is about.
    #[must_use]
    pub fn source(self) -> Option<Source> {
        match self {
            Self::Dark | Self::Unmeasured | Self::Contradicted => None,
            Self::Alone(source)
            | Self::New(source)
            | Self::Moved(source)
            | Self::Shared(source)
            | Self::Unlisted(source)
            | Self::Misplaced(source) => Some(source),
        }
    }

    /// Whether it does not come and go as people move about: worth a line in the log.
    #[must_use]
    pub fn is_of_the_room(self) -> bool {
        !matches!(
            self,
            Self::Dark | Self::Unmeasured | Self::Alone(_) | Self::New(_)
        )
    }
}

/// What is wrong, and what can be done.
impl std::fmt::Display for Trouble {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Dark => write!(
                f,
                "no base station is seen: see that they have power, and that nothing stands between"
            ),
            Self::Unmeasured => write!(
                f,
                "no base station has a place yet: hold the headset still for a moment where it sees \
                 one, better two"
            ),
            Self::Alone(source) => write!(
                f,
                "only the base station on {source} is seen: distance from it is less sure, and \
                 whoever stands in its light is lost"
            ),
            Self::New(source) => write!(
                f,
                "the base station on {source} has no place yet: hold a headset or controller still \
                 for a moment where it sees this one and another"
            ),
            Self::Moved(source) => write!(
                f,
                "the base station on {source} was moved, or is another one: its place is measured \
                 anew, as soon as a headset or controller is held still where it sees this one and \
                 another"
            ),
            Self::Shared(source) => write!(
                f,
                "two base stations are set to {source}: neither is used until one of them is set to \
                 another channel (the button on its back)"
            ),
            Self::Unlisted(source) => write!(
                f,
                "the base station on {source} is not among those given: it is not used until the \
                 file holds it, or no file is given"
            ),
            Self::Misplaced(source) => write!(
                f,
                "the base station on {source} does not stand where it is given to: its light is left \
                 out until the file is made anew, or no file is given"
            ),
            Self::Contradicted => write!(
                f,
                "the base stations do not stand where they are given to: make the file anew, or give \
                 none"
            ),
        }
    }
}
