//! Poses that come and go without a jump.
//!
//! When a source changes, the difference to what was shown before is kept and decays to nothing
//! in a fixed time; from then on the new source is passed on exactly (Bollo 2016,
//! "Inertialization").

use glam::{Quat, Vec3};

use crate::geometry::min_jerk;

/// Where something is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Metres.
    pub position: Vec3,
    /// Unit.
    pub rotation: Quat,
}

impl Place {
    /// `self`, given in the frame of `base`, in the world.
    pub(crate) fn out_of(&self, base: &Self) -> Self {
        Self {
            position: base.position + base.rotation * self.position,
            rotation: (base.rotation * self.rotation).normalize(),
        }
    }

    /// `self`, given in the world, in the frame of `base`.
    pub(crate) fn into_frame(self, base: &Self) -> Self {
        let back = base.rotation.inverse();
        Self {
            position: back * (self.position - base.position),
            rotation: (back * self.rotation).normalize(),
        }
    }
}

/// A difference that decays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fade {
    shift: Vec3,
    turn: Quat,
    left: f32,
    span: f32,
}

impl Fade {
    /// Nothing to fade.
    pub(crate) const DONE: Self = Self {
        shift: Vec3::ZERO,
        turn: Quat::IDENTITY,
        left: 0.0,
        span: 1.0,
    };

    /// From `shown` over to `source` in `span` seconds.
    pub(crate) fn start(shown: &Place, source: &Place, span: f32) -> Self {
        let turn = (shown.rotation * source.rotation.inverse()).normalize();
        // The short way round.
        let turn = if turn.w < 0.0 { -turn } else { turn };
        Self {
            shift: shown.position - source.position,
            turn,
            left: span,
            span,
        }
    }

    /// Lets time pass.
    pub(crate) fn advance(&mut self, dt: f32) {
        self.left = (self.left - dt).max(0.0);
    }

    /// Whether the source is passed on as it is.
    pub(crate) fn is_done(&self) -> bool {
        self.left <= 0.0
    }

    /// The source with what is left of the difference.
    pub(crate) fn apply(&self, source: &Place) -> Place {
        if self.is_done() {
            return *source;
        }
        let share = min_jerk(self.left / self.span);
        let turn = Quat::IDENTITY.slerp(self.turn, share);
        Place {
            position: source.position + self.shift * share,
            rotation: (turn * source.rotation).normalize(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_where_it_was_and_ends_exactly_on_the_source() {
        let shown = Place {
            position: Vec3::X,
            rotation: Quat::from_rotation_z(2.0),
        };
        let source = Place {
            position: Vec3::Y,
            rotation: Quat::from_rotation_x(1.0),
        };
        let mut fade = Fade::start(&shown, &source, 0.3);
        let first = fade.apply(&source);
        assert!(first.position.distance(Vec3::X) < 1e-6);
        assert!(first.rotation.angle_between(shown.rotation) < 1e-3);
        let mut last = first;
        for _ in 0..30 {
            fade.advance(0.0101);
            let next = fade.apply(&source);
            assert!(
                next.position.distance(last.position) < 0.1,
                "no jump on the way"
            );
            last = next;
        }
        assert!(fade.is_done());
        assert_eq!(fade.apply(&source), source);
        let base = Place {
            position: Vec3::ONE,
            rotation: Quat::from_rotation_y(0.3),
        };
        let there = source.into_frame(&base).out_of(&base);
        assert!(there.position.distance(source.position) < 1e-6);
    }
}
