//! What the network sees: five 6-DoF streams with velocities, free of heading and position.
//! policy/training/FEATURES.md is the exact layout.

use glam::{Mat3, Quat, Vec3};

use crate::{fade::Place, geometry::yaw_of};

/// Streams: head, both hands in the head's heading frame, both hands in the head joint's frame.
pub(super) const STREAMS: usize = 5;
/// Numbers of a stream: rotation (6), position, angular velocity, velocity (3 each).
pub(super) const STREAM: usize = 15;

/// The body parts at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    pub head: Place,
    /// Left and right; `None` while not tracked.
    pub hands: [Option<Place>; 2],
}

impl Seen {
    /// Between `self` (at 0) and `later` (at 1). A hand is there when it is at both ends.
    pub(super) fn interpolate(&self, later: &Self, fraction: f32) -> Self {
        let between = |a: &Place, b: &Place| Place {
            position: a.position.lerp(b.position, fraction),
            rotation: a.rotation.slerp(b.rotation, fraction).normalize(),
        };
        let hand = |side: usize| match (&self.hands[side], &later.hands[side]) {
            (Some(a), Some(b)) => Some(between(a, b)),
            _ => None,
        };
        Self {
            head: between(&self.head, &later.head),
            hands: [hand(0), hand(1)],
        }
    }
}

/// Builds features in place.
pub(super) struct Builder<'a> {
    now: &'a Seen,
    /// Without one all velocities are zero.
    before: Option<&'a Seen>,
    /// Seconds between the two.
    dt: f32,
    /// Head height, the unit of length, metres.
    height: f32,
}

impl<'a> Builder<'a> {
    pub(super) fn new(now: &'a Seen, before: Option<&'a Seen>, dt: f32, height: f32) -> Self {
        Self {
            now,
            before: before.filter(|_| dt > 0.0),
            dt,
            height,
        }
    }

    /// The head's heading, radians: outputs are in its frame.
    pub(super) fn yaw(&self) -> f32 {
        yaw_of(self.now.head.rotation)
    }

    /// The unit of length, metres.
    pub(super) fn height(&self) -> f32 {
        self.height
    }

    /// Writes all streams; those of hands that are not seen are zero.
    pub(super) fn write(&self, out: &mut [f32]) {
        out.fill(0.0);
        let head = &self.now.head;
        let level = Quat::from_rotation_y(-self.yaw());
        let origin = Vec3::new(head.position.x, 0.0, head.position.z);
        let mut streams = out.chunks_exact_mut(STREAM);
        let mut next = || streams.next().unwrap_or_default();
        let heading = |place: &Place| Place {
            position: level * (place.position - origin),
            rotation: level * place.rotation,
        };
        let before = self.before.map(|seen| &seen.head);
        self.stream(next(), &heading(head), head, before, level);
        for side in 0..2 {
            let out = next();
            let Some(hand) = &self.now.hands[side] else {
                continue;
            };
            let before = self.before.and_then(|seen| seen.hands[side].as_ref());
            self.stream(out, &heading(hand), hand, before, level);
        }
        for side in 0..2 {
            let out = next();
            let Some(hand) = &self.now.hands[side] else {
                continue;
            };
            let in_head = hand.into_frame(head);
            let before = self
                .before
                .and_then(|seen| seen.hands[side].map(|hand| hand.into_frame(&seen.head)));
            self.stream(out, &in_head, &in_head, before.as_ref(), Quat::IDENTITY);
        }
    }

    /// One stream: `shown` as pose; velocities from `before` to `now`, turned by `turn`.
    fn stream(
        &self,
        out: &mut [f32],
        shown: &Place,
        now: &Place,
        before: Option<&Place>,
        turn: Quat,
    ) {
        let Some((pose, velocities)) = out.split_at_mut_checked(9) else {
            return;
        };
        let axes = Mat3::from_quat(shown.rotation);
        pose[0..3].copy_from_slice(&axes.x_axis.to_array());
        pose[3..6].copy_from_slice(&axes.y_axis.to_array());
        pose[6..9].copy_from_slice(&(shown.position / self.height).to_array());
        let Some(before) = before else { return };
        let change = now.rotation * before.rotation.inverse();
        let change = if change.w < 0.0 { -change } else { change };
        let spin = turn * change.to_scaled_axis() / self.dt;
        let speed = turn * (now.position - before.position) / (self.dt * self.height);
        velocities[0..3].copy_from_slice(&spin.to_array());
        velocities[3..6].copy_from_slice(&speed.to_array());
    }
}
