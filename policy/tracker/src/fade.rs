//! Poses that come and go without a jump.
//!
//! When a source changes, the difference to what was shown before is kept and decays to nothing
//! in a fixed time; from then on the new source is passed on exactly (Bollo 2016,
//! "Inertialization").

use glam::{Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Skeleton};

use crate::{geometry::min_jerk, tracker::TrackerKind};

/// Trackers take over from each other in this time, seconds.
const TAKE_OVER_S: f32 = 0.4;

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

/// A whole pose that changes its source: the rotations' differences decay, and the body stays hung
/// from the new source's head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PoseFade {
    turns: [Quat; JOINTS],
    left: f32,
    span: f32,
}

impl PoseFade {
    /// Nothing to fade.
    pub(crate) const DONE: Self = Self {
        turns: [Quat::IDENTITY; JOINTS],
        left: 0.0,
        span: 1.0,
    };

    /// From `shown` over to `source` in `span` seconds.
    pub(crate) fn start(shown: &BodyPose, source: &BodyPose, span: f32) -> Self {
        let mut turns = [Quat::IDENTITY; JOINTS];
        for (index, turn) in turns.iter_mut().enumerate() {
            let between = shown.rotations[index] * source.rotations[index].inverse();
            *turn = (if between.w < 0.0 { -between } else { between }).normalize();
        }
        Self {
            turns,
            left: span,
            span,
        }
    }

    /// Lets time pass.
    pub(crate) fn advance(&mut self, dt: f32) {
        self.left = (self.left - dt).max(0.0);
    }

    /// The source with what is left of the difference, its head joint where the source has it.
    pub(crate) fn apply(&self, source: &BodyPose, skeleton: &Skeleton) -> BodyPose {
        if self.left <= 0.0 {
            return *source;
        }
        let share = min_jerk(self.left / self.span);
        let mut pose = *source;
        for (rotation, turn) in pose.rotations.iter_mut().zip(&self.turns) {
            *rotation = (Quat::IDENTITY.slerp(*turn, share) * *rotation).normalize();
        }
        let (wanted, joints) = (skeleton.forward(source), skeleton.forward(&pose));
        let neck = joints.rotation(Joint::Neck);
        let head = neck.inverse() * wanted.rotation(Joint::Head);
        pose.rotations[Joint::Head as usize] = head.normalize();
        pose.root += wanted.position(Joint::Head) - joints.position(Joint::Head);
        pose
    }
}

/// A pose that two trackers make by turns: each fades over from what the other showed last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TakeOver {
    /// The pose shown last, and who made it.
    shown: Option<(BodyPose, TrackerKind)>,
    fade: PoseFade,
}

impl TakeOver {
    /// Nothing shown yet.
    pub(crate) const NONE: Self = Self {
        shown: None,
        fade: PoseFade::DONE,
    };

    /// Who made the pose shown last.
    pub(crate) fn by(&self) -> Option<TrackerKind> {
        self.shown.map(|(_, by)| by)
    }

    /// Shows `source`, or what leads over to it from another tracker's pose.
    pub(crate) fn show(
        &mut self,
        source: &BodyPose,
        kind: TrackerKind,
        skeleton: &Skeleton,
        dt: f32,
    ) -> BodyPose {
        match self.shown {
            Some((shown, by)) if by != kind => {
                self.fade = PoseFade::start(&shown, source, TAKE_OVER_S);
            }
            _ => self.fade.advance(dt),
        }
        let pose = self.fade.apply(source, skeleton);
        self.shown = Some((pose, kind));
        pose
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

    #[test]
    fn a_pose_fades_with_its_head_in_place() {
        let skeleton = Skeleton::of_height(1.7);
        let mut shown = BodyPose::rest(Vec3::Y);
        shown.rotations = shown.rotations.map(|_| Quat::from_rotation_x(0.1));
        let source = BodyPose::rest(Vec3::new(0.2, 1.0, 0.0));
        let mut fade = PoseFade::start(&shown, &source, 0.2);
        let first = fade.apply(&source, &skeleton);
        let elbow = Joint::LeftElbow as usize;
        assert!(first.rotations[elbow].angle_between(shown.rotations[elbow]) < 1e-3);
        let head = |pose: &BodyPose| skeleton.forward(pose).position(Joint::Head);
        assert!(head(&first).distance(head(&source)) < 1e-5);
        fade.advance(0.3);
        assert_eq!(fade.apply(&source, &skeleton), source);
    }
}
