//! The reference: a kinematic pose stream as smooth positions and velocities.
//!
//! Each channel (the pelvis's position, each joint's rotation) is an α-β filter whose gains
//! follow from how noisy the stream is: P. R. Kalata, "The tracking index: a generalized
//! parameter for α-β and α-β-γ target trackers", IEEE Trans. Aerospace and Electronic Systems
//! 20(2), 1984. The noise is measured as the stream runs, from its fifth differences, in which
//! white noise stands out and human motion does not. A clean stream passes through unchanged and
//! without delay.

use glam::{DQuat, DVec3};

use crate::skeleton::{BodyPose, JOINTS};

/// Over this time the noise is averaged, seconds.
const NOISE_TIME: f64 = 0.4;
/// Variance of the fifth difference of white noise of unit variance, over three axes.
const FIFTH_DIFFERENCE: f64 = 3.0 * 252.0;
/// The fifth difference of positions from their increments, oldest first.
const WEIGHTS: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
/// Noise never taken to be less than this, metres or radians: single precision.
const NOISE_MIN: f64 = 1e-6;

/// Gains of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Gains {
    alpha: f64,
    beta: f64,
}

impl Gains {
    /// For a manoeuvre of this acceleration, noise of this deviation and a tick.
    fn new(manoeuvre: f64, noise: f64, tick: f64) -> Self {
        let index = manoeuvre * tick * tick / noise.max(NOISE_MIN);
        let r = (4.0 + index - (8.0 * index + index * index).sqrt()) / 4.0;
        let alpha = 1.0 - r * r;
        // Beyond one the velocity would swing from tick to tick.
        let beta = (2.0 * (2.0 - alpha) - 4.0 * (1.0 - alpha).sqrt()).min(1.0);
        Self { alpha, beta }
    }
}

/// Running estimate of the noise of a channel from its increments.
#[derive(Debug, Clone, Copy, Default)]
struct Noise {
    increments: [DVec3; 5],
    seen: u8,
    variance: f64,
}

impl Noise {
    /// Takes the next increment and gives the deviation per axis.
    fn update(&mut self, increment: DVec3, tick: f64) -> f64 {
        self.increments.rotate_left(1);
        self.increments[4] = increment;
        self.seen = self.seen.saturating_add(1);
        let Some(samples @ 1..) = self.seen.checked_sub(4) else {
            return 0.0;
        };
        let fifth: DVec3 = WEIGHTS
            .iter()
            .zip(self.increments)
            .map(|(&w, i)| w * i)
            .sum();
        let sample = fifth.length_squared() / FIFTH_DIFFERENCE;
        // A plain mean over the first samples, so that the estimate is right from the start.
        let rate = (tick / NOISE_TIME).max(1.0 / f64::from(samples));
        self.variance += (sample - self.variance) * rate;
        self.variance.sqrt()
    }
}

/// One moment of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Position of the pelvis, metres.
    pub root: DVec3,
    /// Its velocity, m/s.
    pub root_velocity: DVec3,
    /// Local rotations.
    pub rotations: [DQuat; JOINTS],
    /// Angular velocities of the joints, each in its own frame, rad/s.
    pub angular: [DVec3; JOINTS],
}

/// The filter bank.
#[derive(Debug, Clone)]
pub struct Smoother {
    tick: f64,
    /// Accelerations expected of a person: pelvis m/s², joints rad/s².
    manoeuvre: [f64; 2],
    target: Option<Target>,
    last: BodyPose,
    root_noise: Noise,
    noises: [Noise; JOINTS],
}

/// `log(aᵀ b)`: the rotation from `a` to `b` in the frame of `a`.
pub(super) fn difference(a: DQuat, b: DQuat) -> DVec3 {
    let between = a.inverse() * b;
    let between = if between.w < 0.0 { -between } else { between };
    between.to_scaled_axis()
}

impl Smoother {
    /// A bank for a stream of one pose every `tick` seconds of somebody whose pelvis and joints
    /// may well accelerate this much, m/s² and rad/s².
    #[must_use]
    pub fn new(tick: f64, manoeuvre: [f64; 2]) -> Self {
        Self {
            tick,
            manoeuvre,
            target: None,
            last: BodyPose::rest(glam::Vec3::ZERO),
            root_noise: Noise::default(),
            noises: [Noise::default(); JOINTS],
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        *self = Self::new(self.tick, self.manoeuvre);
    }

    /// Takes the next pose, which must be sound.
    pub fn update(&mut self, pose: &BodyPose) -> Target {
        let tick = self.tick;
        let root = pose.root.as_dvec3();
        let rotations = pose.rotations.map(|q| q.as_dquat().normalize());
        let Some(mut target) = self.target else {
            let still = DVec3::ZERO;
            let first = Target {
                root,
                root_velocity: still,
                rotations,
                angular: [still; JOINTS],
            };
            (self.target, self.last) = (Some(first), *pose);
            return first;
        };
        let noise = self
            .root_noise
            .update(root - self.last.root.as_dvec3(), tick);
        let gains = Gains::new(self.manoeuvre[0], noise, tick);
        let predicted = target.root + target.root_velocity * tick;
        let innovation = root - predicted;
        target.root = predicted + gains.alpha * innovation;
        target.root_velocity += gains.beta / tick * innovation;
        for joint in 0..JOINTS {
            let before = self.last.rotations[joint].as_dquat().normalize();
            let noise = self.noises[joint].update(difference(before, rotations[joint]), tick);
            let gains = Gains::new(self.manoeuvre[1], noise, tick);
            let turn = DQuat::from_scaled_axis(target.angular[joint] * tick);
            let predicted = (target.rotations[joint] * turn).normalize();
            let innovation = difference(predicted, rotations[joint]);
            let correction = DQuat::from_scaled_axis(gains.alpha * innovation);
            target.rotations[joint] = (predicted * correction).normalize();
            target.angular[joint] += gains.beta / tick * innovation;
        }
        (self.target, self.last) = (Some(target), *pose);
        target
    }
}
