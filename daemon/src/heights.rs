//! How tall the wearer is, and how tall the body that is shown.

use posed_tracker::{Mounts, Wearer};

use crate::config::HEIGHT_M;

/// The heights of the wearer and of the body shown, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heights {
    /// The wearer, crown of the head above the floor.
    pub wearer: f32,
    /// The body shown, where it is not as tall as the wearer.
    pub avatar: Option<f32>,
}

/// What becomes of the avatar's height when the wearer's is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Avatar {
    /// It stays as it is.
    Keep,
    /// It is as tall as the wearer.
    Own,
    /// It is so tall, metres.
    Metres(f32),
}

impl Heights {
    /// A wearer who is shown as tall as they are.
    #[must_use]
    pub fn of(wearer: f32) -> Self {
        Self {
            wearer,
            avatar: None,
        }
    }

    /// With the wearer's height told, and maybe the avatar's.
    #[must_use]
    pub fn told(self, wearer: f32, avatar: Avatar) -> Self {
        let avatar = match avatar {
            Avatar::Keep => self.avatar,
            Avatar::Own => None,
            Avatar::Metres(metres) => Some(metres),
        };
        Self { wearer, avatar }
    }

    /// The body shown: what trackers, skeletons and poses are of.
    #[must_use]
    pub fn body(&self) -> Wearer {
        Wearer::of_height(self.avatar.unwrap_or(self.wearer))
    }

    /// The avatar's height over the wearer's.
    #[must_use]
    pub fn scale(&self) -> f32 {
        self.avatar.map_or(1.0, |avatar| avatar / self.wearer)
    }

    /// Where the wearer's devices sit on the joints of a body: `body` is [`Heights::body`], or one
    /// of the wearer's own height with other bones.
    #[must_use]
    pub fn mounts(&self, body: &Wearer) -> Mounts {
        match self.avatar {
            None => Mounts::index(body),
            Some(_) => Mounts::index(&Wearer::of_height(self.wearer)),
        }
    }

    /// The first of the two that nobody has, metres.
    #[must_use]
    pub fn wrong(&self) -> Option<f32> {
        let mut all = [self.wearer].into_iter().chain(self.avatar);
        all.find(|height| !HEIGHT_M.contains(height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_avatar_stays_until_it_is_told_otherwise() {
        let own = Heights::of(1.6);
        assert_eq!((own.scale(), own.body().height), (1.0, 1.6));
        let tall = own.told(1.6, Avatar::Metres(2.0));
        assert_eq!((tall.scale(), tall.body().height), (1.25, 2.0));
        assert_eq!(tall.told(1.8, Avatar::Keep).avatar, Some(2.0));
        assert_eq!(tall.told(1.8, Avatar::Own), Heights::of(1.8));
        assert_eq!(tall.wrong(), None);
        assert_eq!(own.told(1.6, Avatar::Metres(3.0)).wrong(), Some(3.0));
        let nobody = own.told(f32::NAN, Avatar::Keep).wrong();
        assert!(nobody.is_some_and(f32::is_nan));
    }
}
