//! Inertial sensors on a recorded motion, as PIP and TransPose synthesise them.

use glam::{DQuat, DVec3};
use posed_body::{Joint, Skeleton, motion::Trajectory};
use posed_signal::{HostTime, Orientation, Role};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Accelerations are second differences over this many frames of 1/60 s to either side (PIP §4,
/// after TransPose §3.3: smoothing 4): what is left of real sensors after their filters. The
/// motion goes on straight beyond its ends.
const SMOOTHING_S: f64 = 4.0 / 60.0;

/// How the six sensors sit on the wearer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Straps {
    /// Where PIP puts them, calibrated without error, and without noise of their own.
    #[default]
    Exact,
    /// As people wear trackers on straps: a few centimetres off, calibrated to a few degrees,
    /// headings that wander, accelerometers with bias and noise. The same for every run of a clip.
    Worn,
}

impl Straps {
    /// Every way.
    pub const ALL: [Self; 2] = [Self::Exact, Self::Worn];

    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Worn => "worn",
        }
    }

    /// The inverse of [`Straps::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|straps| straps.name() == name)
    }
}

/// Farthest that a worn sensor sits from its place, along each axis, metres.
const OFF_PLACE: f64 = 0.03;
/// Largest error of a worn sensor's calibration about each axis, radians (5 degrees: what a
/// T-pose struck by eye leaves).
const OFF_CALIBRATION: f64 = 0.087;
/// Fastest wander of a worn sensor's heading, rad/s: 2 degrees a minute, a good gyroscope without
/// a magnetometer.
const HEADING_DRIFT: f64 = 2.0 / 180.0 * std::f64::consts::PI / 60.0;
/// Largest bias of a worn accelerometer on each axis, m/s²: a BMI270 after calibration (20 mg).
const ACCEL_BIAS: f64 = 0.2;
/// Largest noise of a worn accelerometer on each axis, m/s².
const ACCEL_NOISE: f64 = 0.15;
/// Largest bias of a worn gyroscope on each axis, rad/s.
const GYRO_BIAS: f64 = 0.005;

/// Where a sensor is strapped on, and what is wrong with it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placement {
    /// The joint whose bone carries it, and whose frame is the sensor's.
    pub(super) joint: Joint,
    /// Its place in that frame, metres.
    offset: DVec3,
    faults: Option<Faults>,
}

#[derive(Debug, Clone, PartialEq)]
struct Faults {
    /// What calibration took for the bone's frame, in that frame.
    turn: DQuat,
    /// rad/s about the vertical.
    drift: f64,
    accel_bias: DVec3,
    gyro_bias: DVec3,
    noise: Pcg32,
}

/// A vector with components in ±`most`.
fn within(random: &mut impl Rng, most: f64) -> DVec3 {
    let mut one = || random.random_range(-most..=most);
    DVec3::new(one(), one(), one())
}

impl Placement {
    /// PIP's six: the forearms near the wrist, the shanks below the knee, the head and the pelvis.
    /// PIP names vertices of the SMPL mesh; these are the same places on the bones. `seed` tells
    /// one wearer's straps from another's.
    pub(super) fn of(role: Role, skeleton: &Skeleton, straps: Straps, seed: u64) -> Option<Self> {
        let bone = |joint: Joint| skeleton.offsets[joint as usize].as_dvec3();
        let forearm = |wrist| bone(wrist) * 0.8 + DVec3::Y * 0.03;
        let shank = |ankle| bone(ankle) * 0.2 - DVec3::Z * 0.05;
        let (joint, offset) = match role {
            Role::LeftWrist => (Joint::LeftElbow, forearm(Joint::LeftWrist)),
            Role::RightWrist => (Joint::RightElbow, forearm(Joint::RightWrist)),
            Role::LeftKnee => (Joint::LeftKnee, shank(Joint::LeftAnkle)),
            Role::RightKnee => (Joint::RightKnee, shank(Joint::RightAnkle)),
            Role::Head => (Joint::Head, DVec3::new(0.0, 0.1, 0.05)),
            Role::Waist => (Joint::Pelvis, DVec3::new(0.0, 0.05, 0.1)),
            _ => return None,
        };
        let exact = Self {
            joint,
            offset,
            faults: None,
        };
        Some(match straps {
            Straps::Exact => exact,
            Straps::Worn => exact.worn(Pcg32::seed_from_u64(seed ^ ((role as u64) << 32))),
        })
    }

    fn worn(self, mut noise: Pcg32) -> Self {
        let random = &mut noise;
        Self {
            offset: self.offset + within(random, OFF_PLACE),
            faults: Some(Faults {
                turn: DQuat::from_scaled_axis(within(random, OFF_CALIBRATION)),
                drift: random.random_range(-HEADING_DRIFT..=HEADING_DRIFT),
                accel_bias: within(random, ACCEL_BIAS),
                gyro_bias: within(random, GYRO_BIAS),
                noise,
            }),
            ..self
        }
    }

    /// What the calibrated tracker says at a time.
    pub(super) fn measure(
        &mut self,
        trajectory: &Trajectory,
        seconds: f64,
        at: HostTime,
    ) -> Orientation {
        let place = |seconds: f64| {
            let motion = trajectory.joint(self.joint, seconds);
            motion.position + motion.rotation * self.offset
        };
        let (before, now, after) = (
            place(seconds - SMOOTHING_S),
            place(seconds),
            place(seconds + SMOOTHING_S),
        );
        let mut accel = (before - 2.0 * now + after) / (SMOOTHING_S * SMOOTHING_S);
        let bone = trajectory.joint(self.joint, seconds);
        let (mut rotation, mut angular_velocity) = (bone.rotation, bone.angular_velocity);
        if let Some(faults) = &mut self.faults {
            // Its filter has the world wrong: what it measures rightly in its own frame is turned
            // into a world that wanders.
            let wander = DQuat::from_rotation_y(faults.drift * seconds);
            let sensor = wander * bone.rotation;
            let error = faults.accel_bias + within(&mut faults.noise, ACCEL_NOISE);
            accel = wander * accel + sensor * error;
            angular_velocity = wander * angular_velocity + sensor * faults.gyro_bias;
            rotation = sensor * faults.turn;
        }
        Orientation {
            at,
            rotation: rotation.as_quat().normalize(),
            accel: accel.as_vec3(),
            angular_velocity: angular_velocity.as_vec3(),
        }
    }
}
