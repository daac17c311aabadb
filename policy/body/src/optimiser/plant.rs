//! Planting: a foot that stands stays where it was set down, in the reference already.
//!
//! Trackers that see no feet let standing ones slide. The no-sliding rows alone only delay such a
//! foot: the reference drags it along. So the reference's own leg is bent to keep the toe joint on
//! an anchor, and turned in the ankle to keep the heel on one while it is down; the anchor gives
//! way when the reference has gone too far; a foot that leaves the ground takes the offset along
//! and loses it smoothly on its way. Footskate clean-up of Kovar, Schreiner and Gleicher (SCA
//! 2002), causal.

use glam::{DQuat, DVec3};

use super::contact::{FEET, ramp};
use super::dynamics::Frames;
use super::smoother::{Target, difference};
use crate::skeleton::Joint;

/// Hip, knee, ankle and toe joint of each leg.
const LEGS: [[Joint; 4]; 2] = [
    [
        Joint::LeftHip,
        Joint::LeftKnee,
        Joint::LeftAnkle,
        Joint::LeftFoot,
    ],
    [
        Joint::RightHip,
        Joint::RightKnee,
        Joint::RightAnkle,
        Joint::RightFoot,
    ],
];
/// From this probability on a foot is planted; below the second it is let go.
const PLANTED: f64 = 0.5;
const LET_GO: f64 = 0.3;
/// As far as this the reference may wander from a planted foot, metres; beyond, the anchor follows
/// within [`FOLLOW`] seconds.
const LEASH: f64 = 0.04;
const FOLLOW: f64 = 0.2;
/// The same for the ankle joint of a foot whose heel is down, against the toe joint.
const HEEL_LEASH: f64 = 0.03;
/// A reference that is farther away than the leash by this factor has stepped: the foot is let go.
const STRAY: f64 = 1.75;
/// An ankle joint slower than the first speed can have its heel down, one faster than the second
/// cannot; m/s.
const HEEL_SPEEDS: [f64; 2] = [0.2, 0.5];
/// Axes along which a toe joint is held: the ground keeps it from sinking.
const LEVEL: DVec3 = DVec3::new(1.0, 0.0, 1.0);
/// How fast a foot in the air comes back to the reference: a critically damped spring, rad/s.
const RETURN: f64 = 20.0;
/// Time in which a foot that is set down comes to rest, seconds.
const STOP: f64 = 0.03;
/// Share of its full length beyond which a leg changes its length more and more reluctantly.
const SUPPLE: f64 = 0.97;
/// Share of its full length that a leg never exceeds.
const STRAIGHT: f64 = 0.999;

/// Sine of the bend up to which the knee's own hinge tells how it bends.
const STIFF: f64 = 0.1;

/// One joint of a foot: where it is held, and how far the reference's is shifted.
#[derive(Debug, Clone, Copy, Default)]
struct Hold {
    anchor: Option<DVec3>,
    /// Velocity of the anchor, m/s: what is left of the joint's when it was set down.
    glide: DVec3,
    offset: DVec3,
    rate: DVec3,
}

impl Hold {
    /// Moves on by a tick: the offset of the reference's joint. `held` has ones for the axes along
    /// which it is held.
    fn update(&mut self, joint: &Moving, held: DVec3, leash: f64, tick: f64) -> DVec3 {
        let stray = |anchor: DVec3| ((joint.place - anchor) * held).length() > STRAY * leash;
        match self.anchor {
            None if joint.stands > PLANTED && self.offset.length() < leash => {
                self.glide = joint.velocity * held + self.rate;
                self.anchor = Some(joint.place + self.offset - self.glide * tick);
            }
            Some(anchor) if joint.stands < LET_GO || stray(anchor) => self.anchor = None,
            _ => {}
        }
        if let Some(anchor) = &mut self.anchor {
            *anchor += self.glide * tick;
            self.glide *= (-tick / STOP).exp();
            let away = (joint.place - *anchor) * held;
            let excess = away.length() - leash;
            if excess > 0.0 {
                *anchor += away.normalize() * excess * (tick / FOLLOW).min(1.0);
            }
            let offset = (*anchor - joint.place) * held;
            self.rate = (offset - self.offset) / tick;
            self.offset = offset;
        } else {
            // The closed form, which any tick length keeps stable.
            let decay = (-RETURN * tick).exp();
            let slope = self.rate + RETURN * self.offset;
            self.offset = (self.offset + slope * tick) * decay;
            self.rate = (self.rate - RETURN * slope * tick) * decay;
        }
        self.offset
    }
}

/// A joint of the reference.
#[derive(Debug, Clone, Copy)]
struct Moving {
    place: DVec3,
    velocity: DVec3,
    /// Probability that it stands.
    stands: f64,
}

/// One foot: the toe joint is held level, and while the heel is down the ankle joint against it.
#[derive(Debug, Clone, Copy, Default)]
struct Foot {
    toe: Hold,
    ankle: Hold,
}

/// Both feet.
#[derive(Debug, Clone, Default)]
pub(super) struct Plant {
    feet: [Foot; 2],
    /// Local rotations of the legs one tick ago, as planted.
    last: Option<[[DQuat; 3]; 2]>,
}

impl Plant {
    /// Forgets the past.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Bends the legs of `target`, whose frames are `wanted`, so that standing feet stay.
    pub(super) fn apply(
        &mut self,
        target: &mut Target,
        wanted: &Frames,
        probabilities: [f64; 2],
        tick: f64,
    ) {
        let last = self.last;
        let mut now = [[DQuat::IDENTITY; 3]; 2];
        for (side, leg) in LEGS.into_iter().enumerate() {
            let moving = |joint: Joint, stands: f64| Moving {
                place: wanted.positions[joint as usize],
                velocity: wanted.velocities[joint as usize],
                stands,
            };
            let (ankle, toe) = FEET[side];
            let foot = &mut self.feet[side];
            let toe = moving(toe, probabilities[side]);
            let offset = foot.toe.update(&toe, LEVEL, LEASH, tick);
            let mut ankle = moving(ankle, probabilities[side]);
            let sole = toe.place - ankle.place;
            ankle.stands *= ramp(ankle.velocity.length(), HEEL_SPEEDS);
            // The toe joint takes the whole foot along.
            ankle.place += offset;
            ankle.velocity += foot.toe.rate;
            let back = foot.ankle.update(&ankle, DVec3::ONE, HEEL_LEASH, tick);
            // Both together only as far as the foot's length allows; the toe joint goes first.
            let aim = (sole - back).normalize_or_zero() * sole.length();
            bend(target, wanted, leg, offset + sole - aim, aim);
            for (index, joint) in leg[..3].iter().copied().enumerate() {
                let rotation = target.rotations[joint as usize];
                now[side][index] = rotation;
                if let Some(last) = last {
                    let turned = difference(last[side][index], rotation);
                    target.angular[joint as usize] = turned / tick;
                }
            }
        }
        self.last = Some(now);
    }
}

/// Length that a leg takes when it should be `wanted` long and the reference's is `given`. The
/// straighter the reference has it, the less that changes: where a leg is nearly straight the
/// knee would have to turn far for next to nothing.
fn reach(wanted: f64, given: f64, full: f64) -> f64 {
    let supple = SUPPLE * full;
    let rest = full - supple;
    let free = ((full - given) / rest).clamp(0.0, 1.0);
    let length = given + (wanted - given) * free;
    if length < supple {
        return length;
    }
    let soft = supple + rest * (1.0 - (-(length - supple) / rest).exp());
    soft.max(given.min(length)).min(STRAIGHT * full)
}

/// Moves the ankle by `offset` and turns the foot so that its toe joint is `aim` from there; the
/// knee plane is kept.
fn bend(target: &mut Target, frames: &Frames, leg: [Joint; 4], offset: DVec3, aim: DVec3) {
    let [hip, knee, ankle, toe] = leg.map(|joint| joint as usize);
    let place = |joint: usize| frames.positions[joint];
    let sole = place(toe) - place(ankle);
    if offset.length_squared().max(sole.distance_squared(aim)) < 1e-10 {
        return;
    }
    let turn = |joint: usize| DQuat::from_mat3(&frames.turns[joint]);
    let (thigh, shank) = (place(knee) - place(hip), place(ankle) - place(knee));
    let (upper, lower) = (thigh.length(), shank.length());
    let given = (place(ankle) - place(hip)).length();
    let wanted = place(ankle) + offset - place(hip);
    let shortest = (upper - lower).abs() + 0.05 * (upper + lower);
    let length = reach(wanted.length(), given, upper + lower).max(shortest);
    let angle = |length: f64| {
        let cosine = (upper * upper + lower * lower - length * length) / (2.0 * upper * lower);
        cosine.clamp(-1.0, 1.0).acos()
    };
    // A knee bends backwards about its own -X; where the leg is bent, about what it is bent by.
    let hinge = frames.turns[knee] * DVec3::NEG_X;
    let bent = thigh.cross(shank) / (upper * lower);
    let axis = (bent + hinge * STIFF).normalize_or(hinge);
    let more = DQuat::from_axis_angle(axis, angle(given) - angle(length));
    let reached = thigh + more * shank;
    let swing = DQuat::from_rotation_arc(reached.normalize_or(DVec3::NEG_Y), wanted.normalize());
    let pelvis = turn(Joint::Pelvis as usize);
    // Where the leg does not reach, the toe joint stays rather than the foot's direction.
    let short = wanted - wanted.normalize() * length;
    let foot = match (sole.try_normalize(), (aim + short).try_normalize()) {
        (Some(sole), Some(aim)) => DQuat::from_rotation_arc(sole, aim),
        _ => DQuat::IDENTITY,
    };
    let new_hip = swing * turn(hip);
    let new_knee = swing * more * turn(knee);
    target.rotations[hip] = (pelvis.inverse() * new_hip).normalize();
    target.rotations[knee] = (new_hip.inverse() * new_knee).normalize();
    target.rotations[ankle] = (new_knee.inverse() * foot * turn(ankle)).normalize();
}
