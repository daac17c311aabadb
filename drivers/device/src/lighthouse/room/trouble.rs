//! What can be wrong with a room, for whoever wears what is tracked in it.

use crate::lighthouse::base_station::Source;

/// Something that is wrong with the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// A base station does not stand where it stood, or is another one.
    Moved(Source),
    /// Two base stations are set to one channel.
    Shared(Source),
}

impl std::fmt::Display for Trouble {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Moved(source) => write!(
                f,
                "the base station on {source} was moved, or is another one: its place is measured \
                 anew"
            ),
            Self::Shared(source) => write!(
                f,
                "two base stations are set to {source}: neither is used until one of them is set to \
                 another channel"
            ),
        }
    }
}

/// Troubles that have not been told yet. What never gets better is told once.
#[derive(Debug, Clone, Default)]
pub(super) struct Troubles {
    untold: Vec<Trouble>,
    shared: [bool; Source::COUNT],
}

impl Troubles {
    /// As many wait to be told; what comes on top of that is not.
    const UNTOLD_MAX: usize = 32;

    pub(super) fn add(&mut self, trouble: Trouble) {
        if let Trouble::Shared(source) = trouble
            && std::mem::replace(&mut self.shared[source.index()], true)
        {
            return;
        }
        if self.untold.len() < Self::UNTOLD_MAX {
            self.untold.push(trouble);
        }
    }

    pub(super) fn take(&mut self) -> Vec<Trouble> {
        std::mem::take(&mut self.untold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trouble_is_told_once() {
        let mut troubles = Troubles::default();
        let (shared, moved) = (
            Trouble::Shared(Source::Channel(3)),
            Trouble::Moved(Source::Channel(3)),
        );
        for _ in 0..3 {
            troubles.add(shared);
        }
        troubles.add(moved);
        assert_eq!(troubles.take(), [shared, moved]);
        troubles.add(shared);
        troubles.add(moved);
        assert_eq!(troubles.take(), [moved]);
        assert!(shared.to_string().contains("channel 3"));
    }
}
