//! The answers of steps that do not come at the ticks, as one smooth motion.
//!
//! With every step the shown motion is led over within one step's time, from where it is and with
//! the velocity that it has, to what the step says, so that it has no kinks. That makes it lag by a
//! step; led over to where the last two steps *lead* it would not, but what the network is unsure of
//! would then show twice (measured: half the jitter for 0.5 mm more error).

use std::ops::{Add, Mul, Sub};

use glam::Quat;
use posed_body::JOINTS;

/// Rotations, or their change within one step; one for each joint.
pub(crate) type Turns = [Quat; JOINTS];

/// A cubic curve over one step's time, carried on straight from there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Curve<T> {
    from: T,
    from_rate: T,
    to: T,
    to_rate: T,
}

impl<T> Curve<T>
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f32, Output = T>,
{
    /// Leads over to the motion through `before` and, one step later, `last`: at the curve's end
    /// it will be `ahead` steps beyond `last`. `shown` is the value so far and its change a step.
    pub(crate) fn new(shown: Option<(T, T)>, before: T, last: T, ahead: f32) -> Self {
        let rate = last - before;
        let (from, from_rate) = shown.unwrap_or((last + rate * (ahead - 1.0), rate));
        Self {
            from,
            from_rate,
            to: last + rate * ahead,
            to_rate: rate,
        }
    }

    /// The value at `at` steps after the curve's start.
    pub(crate) fn at(&self, at: f32) -> T {
        let s = at.clamp(0.0, 1.0);
        let (s2, s3) = (s * s, s * s * s);
        let beyond = (at - 1.0).max(0.0);
        self.from * (2.0 * s3 - 3.0 * s2 + 1.0)
            + self.from_rate * (s3 - 2.0 * s2 + s)
            + self.to * (3.0 * s2 - 2.0 * s3)
            + self.to_rate * (s3 - s2 + beyond)
    }

    /// Change of the value a step.
    pub(crate) fn rate(&self, at: f32) -> T {
        let s = at.clamp(0.0, 1.0);
        let s2 = s * s;
        (self.from - self.to) * (6.0 * s2 - 6.0 * s)
            + self.from_rate * (3.0 * s2 - 4.0 * s + 1.0)
            + self.to_rate * (3.0 * s2 - 2.0 * s)
    }
}

/// A curve for each joint's rotation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carry([Curve<Quat>; JOINTS]);

impl Carry {
    /// As [`Curve::new`]; `shown` is the curve so far and the time on it.
    pub(crate) fn new(
        shown: Option<(&Self, f32)>,
        before: &Turns,
        last: &Turns,
        ahead: f32,
    ) -> Self {
        Self(std::array::from_fn(|joint| {
            let last = last[joint];
            let shown = shown.map(|(carry, at)| {
                let curve = &carry.0[joint];
                let (value, rate) = (curve.at(at), curve.rate(at));
                if value.dot(last) < 0.0 {
                    (-value, -rate)
                } else {
                    (value, rate)
                }
            });
            Curve::new(shown, toward(before[joint], last), last, ahead)
        }))
    }

    /// The rotations at `at` steps after the curve's start.
    pub(crate) fn at(&self, at: f32) -> Turns {
        std::array::from_fn(|joint| self.0[joint].at(at).normalize())
    }
}

/// The same rotation with its quaternion on the side of `other`.
fn toward(rotation: Quat, other: Quat) -> Quat {
    if rotation.dot(other) < 0.0 {
        -rotation
    } else {
        rotation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A joint that swings, sampled at a number of steps.
    fn swing(steps: f32) -> Turns {
        [Quat::from_rotation_x((0.15 * steps).sin()); JOINTS]
    }

    #[test]
    fn a_carried_swing_is_smooth_and_on_time() {
        let (mut curve, mut angles): (Option<Carry>, Vec<f32>) = (None, Vec::new());
        // Eight pictures a step.
        for step in 1..60u8 {
            let last = f32::from(step);
            let shown = curve.as_ref().map(|curve| (curve, 1.0));
            curve = Some(Carry::new(shown, &swing(last - 1.0), &swing(last), 1.0));
            for picture in 0..8u8 {
                let at = f32::from(picture) / 8.0;
                let rotation = curve.as_ref().unwrap().at(at)[3];
                let truth = swing(last + at)[3];
                assert!(rotation.angle_between(truth) < 0.04, "step {step} + {at}");
                angles.push(2.0 * rotation.x.atan2(rotation.w));
            }
        }
        let bend = |window: &[f32]| (window[2] - 2.0 * window[1] + window[0]).abs();
        let kink = angles[16..].windows(3).map(bend).fold(0.0, f32::max);
        // The swing itself bends by 0.15 squared over 64 a picture.
        assert!(kink < 0.003, "{kink}");
    }

    #[test]
    fn signs_of_quaternions_do_not_matter() {
        let (a, b) = (swing(1.0), swing(2.0));
        let plain = Carry::new(None, &a, &b, 1.0);
        let flipped = Carry::new(Some((&plain, 0.4)), &b.map(|q| -q), &swing(3.0), 1.0);
        let same = Carry::new(Some((&plain, 0.4)), &b, &swing(3.0), 1.0);
        for at in [0.0, 0.5, 1.0, 1.3] {
            assert!(flipped.at(at)[0].dot(same.at(at)[0]).abs() > 1.0 - 1e-6);
        }
    }
}
