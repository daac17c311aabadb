//! Planting: a foot that stands stays where it was set down, in the reference already.
//!
//! Trackers that see no feet let standing ones slide. The no-sliding rows alone only delay such a
//! foot: the reference drags it along. So the reference's own leg is bent to keep the toe joint on
//! an anchor; the anchor gives way when the reference has gone too far; a foot that leaves the
//! ground takes the offset along and loses it smoothly on its way. Footskate clean-up of Kovar,
//! Schreiner and Gleicher (SCA 2002), causal.

use glam::{DQuat, DVec3};

use super::contact::FEET;
use super::dynamics::Frames;
use super::smoother::{Target, difference};
use crate::skeleton::Joint;

/// Hip, knee and ankle of each leg.
const LEGS: [[Joint; 3]; 2] = [
    [Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle],
    [Joint::RightHip, Joint::RightKnee, Joint::RightAnkle],
];
/// From this probability on a foot is planted; below the second it is let go.
const PLANTED: f64 = 0.5;
const LET_GO: f64 = 0.3;
/// As far as this the reference may wander from a planted foot, metres; beyond, the anchor follows
/// within [`FOLLOW`] seconds.
const LEASH: f64 = 0.05;
const FOLLOW: f64 = 0.4;
/// How fast a foot in the air comes back to the reference: a critically damped spring, rad/s.
const RETURN: f64 = 15.0;
/// Time in which a foot that is set down comes to rest, seconds.
const STOP: f64 = 0.03;
/// Share of its full length beyond which a leg changes its length more and more reluctantly.
const SUPPLE: f64 = 0.97;
/// Share of its full length that a leg never exceeds.
const STRAIGHT: f64 = 0.999;

/// Sine of the bend up to which the knee's own hinge tells how it bends.
const STIFF: f64 = 0.1;

/// One foot: where it is planted, and how far the reference's is shifted.
#[derive(Debug, Clone, Copy, Default)]
struct Foot {
    anchor: Option<DVec3>,
    /// Level velocity of the anchor, m/s: what is left of the foot's when it was set down.
    glide: DVec3,
    offset: DVec3,
    rate: DVec3,
}

impl Foot {
    /// Moves on by a tick: the offset of the reference's foot, level.
    fn update(&mut self, toe: DVec3, velocity: DVec3, probability: f64, tick: f64) -> DVec3 {
        match self.anchor {
            None if probability > PLANTED => {
                self.glide = DVec3::new(velocity.x, 0.0, velocity.z) + self.rate;
                self.anchor = Some(toe + self.offset - self.glide * tick);
            }
            Some(_) if probability < LET_GO => self.anchor = None,
            _ => {}
        }
        if let Some(anchor) = &mut self.anchor {
            *anchor += self.glide * tick;
            self.glide *= (-tick / STOP).exp();
            let away = DVec3::new(toe.x - anchor.x, 0.0, toe.z - anchor.z);
            let excess = away.length() - LEASH;
            if excess > 0.0 {
                *anchor += away.normalize() * excess * (tick / FOLLOW).min(1.0);
            }
            let offset = DVec3::new(anchor.x - toe.x, 0.0, anchor.z - toe.z);
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
            let toe = FEET[side].1 as usize;
            let (place, velocity) = (wanted.positions[toe], wanted.velocities[toe]);
            let offset = self.feet[side].update(place, velocity, probabilities[side], tick);
            bend(target, wanted, leg, offset);
            for (index, joint) in leg.into_iter().enumerate() {
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

/// Moves the ankle by `offset`, knee plane and the foot's orientation kept.
fn bend(target: &mut Target, frames: &Frames, leg: [Joint; 3], offset: DVec3) {
    if offset.length_squared() < 1e-10 {
        return;
    }
    let [hip, knee, ankle] = leg.map(|joint| joint as usize);
    let place = |joint: usize| frames.positions[joint];
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
    let new_hip = swing * turn(hip);
    let new_knee = swing * more * turn(knee);
    target.rotations[hip] = (pelvis.inverse() * new_hip).normalize();
    target.rotations[knee] = (new_hip.inverse() * new_knee).normalize();
    target.rotations[ankle] = (new_knee.inverse() * turn(ankle)).normalize();
}
