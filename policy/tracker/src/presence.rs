//! Headset and hands that come and go: what they say while they are tracked, where they are taken
//! to be while they are not, and a fade from one to the other.

use glam::{Quat, Vec3};
use posed_signal::{Lookup, Pose, PoseHow, history::EXTRAPOLATE_NS_MAX};

use crate::{
    fade::{Fade, Place},
    geometry::{gain, yaw_of},
    tracker::Quality,
};

/// A returning headset takes over in this time, seconds.
const RETURN_S: f32 = 0.3;
/// A lost head stays where it was this long, and then rises to standing, with this time constant.
const HOLD_S: f32 = 1.0;
const RISE_S: f32 = 1.5;
/// Farther out than this a position is an error, metres.
const FAR: f32 = 1e3;

/// What a sensor says of its body part now.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sensed {
    pub place: Place,
    /// Optically supported and not older than an extrapolation can bridge.
    pub solid: bool,
}

impl Sensed {
    /// `None` where the part is not tracked or the numbers make no sense.
    pub(crate) fn from_lookup(lookup: &Lookup<Pose>) -> Option<Self> {
        let pose = lookup.fresh()?;
        if pose.how == PoseHow::Lost || !pose.is_sound() || pose.position.abs().max_element() > FAR
        {
            return None;
        }
        let old = matches!(lookup,
            Lookup::Extrapolated { by_ns, .. } if by_ns.abs() > EXTRAPOLATE_NS_MAX);
        let place = Place {
            position: pose.position,
            rotation: pose.rotation.normalize(),
        };
        Some(Self {
            place,
            solid: pose.how == PoseHow::Optical && !old,
        })
    }
}

/// How the head is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeadState {
    /// As the headset says, exactly.
    Exact,
    /// Tracked, but old, inertial, or still fading in.
    Rough,
    /// Not tracked.
    Held,
}

/// How far a pose made from these parts can be trusted.
pub(crate) fn quality(head: HeadState, hands: [Option<Sensed>; 2]) -> Quality {
    match head {
        HeadState::Held => Quality::Held,
        HeadState::Rough => Quality::Degraded,
        HeadState::Exact if hands.iter().all(Option::is_some) => Quality::Full,
        HeadState::Exact => Quality::Partial,
    }
}

/// The headset's part.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Head {
    shown: Place,
    fade: Fade,
    lost_s: f32,
    seen: bool,
}

impl Head {
    pub(crate) const NEW: Self = Self {
        shown: Place {
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
        },
        fade: Fade::DONE,
        lost_s: 0.0,
        seen: false,
    };

    /// The head joint after `dt` seconds; `standing` is its height above the floor when upright.
    pub(crate) fn update(
        &mut self,
        sensed: Option<Sensed>,
        dt: f32,
        standing: f32,
    ) -> (Place, HeadState) {
        let Some(now) = sensed else {
            self.lost_s += dt;
            if !self.seen {
                self.shown.position.y = standing;
            } else if self.lost_s > HOLD_S {
                self.rise(dt, standing);
            }
            return (self.shown, HeadState::Held);
        };
        if self.seen && self.lost_s > 0.0 {
            self.fade = Fade::start(&self.shown, &now.place, RETURN_S);
        } else {
            self.fade.advance(dt);
        }
        self.lost_s = 0.0;
        self.seen = true;
        self.shown = self.fade.apply(&now.place);
        let exact = now.solid && self.fade.is_done();
        (
            self.shown,
            if exact {
                HeadState::Exact
            } else {
                HeadState::Rough
            },
        )
    }

    fn rise(&mut self, dt: f32, standing: f32) {
        let share = gain(dt, RISE_S);
        let upright = Quat::from_rotation_y(yaw_of(self.shown.rotation));
        self.shown.position.y += (standing - self.shown.position.y) * share;
        let near = if upright.dot(self.shown.rotation) < 0.0 {
            -upright
        } else {
            upright
        };
        self.shown.rotation = self.shown.rotation.slerp(near, share).normalize();
    }
}

/// A hand's part. Its fades happen in the frame of the shoulder, which moves with the body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hand {
    shown: Place,
    fade: Fade,
    tracked: bool,
    started: bool,
    leave_s: f32,
    return_s: f32,
}

impl Hand {
    /// `leave_s`: a lost hand is where it is taken to be after this time, seconds; `return_s`: one
    /// that returns is where it is measured.
    pub(crate) const fn new(leave_s: f32, return_s: f32) -> Self {
        Self {
            shown: Place {
                position: Vec3::ZERO,
                rotation: Quat::IDENTITY,
            },
            fade: Fade::DONE,
            tracked: false,
            started: false,
            leave_s,
            return_s,
        }
    }

    /// The wrist in the world after `dt` seconds. `base` is the shoulder with the chest's heading,
    /// `otherwise` where the wrist is in that frame while it is not tracked.
    pub(crate) fn update(
        &mut self,
        sensed: Option<Sensed>,
        base: &Place,
        otherwise: &Place,
        dt: f32,
    ) -> Place {
        let source = sensed.map_or(*otherwise, |now| now.place.into_frame(base));
        let tracked = sensed.is_some();
        if self.started && tracked != self.tracked {
            let span = if tracked { self.return_s } else { self.leave_s };
            self.fade = Fade::start(&self.shown, &source, span);
        } else {
            self.fade.advance(dt);
        }
        (self.tracked, self.started) = (tracked, true);
        self.shown = self.fade.apply(&source);
        match sensed {
            // Not through the shoulder's frame and back: what was measured is passed on exactly.
            Some(now) if self.fade.is_done() => now.place,
            _ => self.shown.out_of(base),
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::HostTime;

    use super::*;

    fn at(x: f32) -> Option<Sensed> {
        let place = Place {
            position: Vec3::new(x, 1.4, 0.0),
            rotation: Quat::IDENTITY,
        };
        Some(Sensed { place, solid: true })
    }

    #[test]
    fn unsound_lost_and_stale_poses_are_not_sensed() {
        let mut pose = Pose::unknown(HostTime(0));
        assert!(Sensed::from_lookup(&Lookup::Exact(pose)).is_none(), "lost");
        pose.how = PoseHow::Optical;
        assert!(Sensed::from_lookup(&Lookup::Exact(pose)).is_some());
        assert!(
            Sensed::from_lookup(&Lookup::Stale {
                value: pose,
                age_ns: 1
            })
            .is_none()
        );
        let late = Lookup::Extrapolated {
            value: pose,
            by_ns: 2 * EXTRAPOLATE_NS_MAX,
        };
        assert!(!Sensed::from_lookup(&late).unwrap().solid);
        pose.position.x = f32::NAN;
        assert!(Sensed::from_lookup(&Lookup::Exact(pose)).is_none());
        pose.position.x = 1e9;
        assert!(Sensed::from_lookup(&Lookup::Exact(pose)).is_none());
    }

    #[test]
    fn a_lost_head_is_held_then_stands_up_and_returns_without_a_jump() {
        let mut head = Head::NEW;
        let crouched = Sensed {
            place: Place {
                position: Vec3::new(0.0, 0.8, 0.0),
                rotation: Quat::from_rotation_x(-1.0),
            },
            solid: true,
        };
        assert_eq!(head.update(Some(crouched), 0.01, 1.4).1, HeadState::Exact);
        let (held, state) = head.update(None, 0.5, 1.4);
        assert_eq!((held, state), (crouched.place, HeadState::Held));
        let mut place = held;
        for _ in 0..1_000 {
            place = head.update(None, 0.01, 1.4).0;
        }
        assert!((place.position.y - 1.4).abs() < 0.01);
        for n in 0..40 {
            let (next, state) = head.update(at(1.0), 0.01, 1.4);
            assert!(next.position.distance(place.position) < 0.1);
            assert_eq!(state == HeadState::Exact, n > 30, "tick {n}");
            place = next;
        }
        assert_eq!(place, at(1.0).unwrap().place);
    }

    #[test]
    fn a_lost_hand_sinks_to_its_rest_and_returns_exactly() {
        let (mut hand, base) = (
            Hand::new(0.9, 0.3),
            Place {
                position: Vec3::Y,
                rotation: Quat::IDENTITY,
            },
        );
        let rest = Place {
            position: Vec3::new(-0.1, -0.5, 0.0),
            rotation: Quat::IDENTITY,
        };
        assert_eq!(
            hand.update(at(-0.5), &base, &rest, 0.01),
            at(-0.5).unwrap().place
        );
        let mut last = at(-0.5).unwrap().place;
        for _ in 0..100 {
            let next = hand.update(None, &base, &rest, 0.01);
            assert!(next.position.distance(last.position) < 0.03);
            last = next;
        }
        assert!(last.position.distance(Vec3::new(-0.1, 0.5, 0.0)) < 1e-6);
        for _ in 0..40 {
            let next = hand.update(at(0.3), &base, &rest, 0.01);
            assert!(next.position.distance(last.position) < 0.08);
            last = next;
        }
        assert_eq!(last, at(0.3).unwrap().place);
    }
}
