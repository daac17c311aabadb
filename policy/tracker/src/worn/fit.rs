//! From postures to how a tracker sits and where its world points.
//!
//! In a posture of known bone rotation B (for a wearer who faces -Z), a tracker that says q gives
//! R(h) q = R(f) B M, with R a turn about the vertical, h the heading that its world lacks, f where
//! the wearer faces, and M the tracker's frame in its bone's. One posture leaves open how much of
//! the turn is h and how much M: the axis about which the bone turns between two postures, which
//! is known in the wearer's world and measured in the tracker's, gives h. Where only one posture
//! is known, the tracker counts as strapped on the way it is meant to be.

use std::f32::consts::FRAC_PI_2;

use glam::{Mat3, Quat, Vec3};
use posed_signal::{Orientation, Role};

use crate::geometry::{wrap, yaw_of};

/// A posture that the wearer holds for calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Stance {
    /// Upright, arms hanging, palms to the thighs.
    Straight,
    /// Upright, arms stretched out sideways, palms down.
    TPose,
    /// From the straight stance, knees bent and trunk leaned forward, as on skis.
    Crouch,
}

impl Stance {
    /// Number of postures.
    pub const COUNT: usize = 3;
    /// Every posture.
    pub const ALL: [Self; Self::COUNT] = [Self::Straight, Self::TPose, Self::Crouch];

    /// The name on the command line and in the API.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::TPose => "t-pose",
            Self::Crouch => "crouch",
        }
    }

    /// The inverse of [`Stance::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|posture| posture.name() == name)
    }

    /// The rotation of a role's bone for a wearer who faces -Z; `None` where the posture leaves it
    /// open how far the bone turns.
    #[must_use]
    pub fn bone(self, role: Role) -> Option<Quat> {
        match (self, role) {
            (Self::Straight, Role::LeftWrist | Role::LeftElbow) => {
                Some(Quat::from_rotation_z(FRAC_PI_2))
            }
            (Self::Straight, Role::RightWrist | Role::RightElbow) => {
                Some(Quat::from_rotation_z(-FRAC_PI_2))
            }
            (Self::Straight | Self::TPose, _) => Some(Quat::IDENTITY),
            (Self::Crouch, _) => None,
        }
    }
}

/// How a tracker is strapped on where nothing else is known: its frame (x to its right, y to its
/// top, z out of its face) in its bone's. On trunk, head and shanks it sits in front and looks
/// forward; on arms it looks away from the hanging arm's outer side, its top to the shoulder; on
/// feet it looks up, its top to the heel.
#[must_use]
pub fn conventional(role: Role) -> Quat {
    let frame =
        |top: Vec3, face: Vec3| Quat::from_mat3(&Mat3::from_cols(top.cross(face), top, face));
    match role {
        Role::LeftWrist | Role::LeftElbow => frame(Vec3::X, Vec3::Y),
        Role::RightWrist | Role::RightElbow => frame(Vec3::NEG_X, Vec3::Y),
        Role::LeftFoot | Role::RightFoot => frame(Vec3::Z, Vec3::Y),
        _ => frame(Vec3::Y, Vec3::NEG_Z),
    }
}

/// How a tracker sits, and where its world points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The tracker's frame in its bone's.
    pub device_in_bone: Quat,
    /// Turns the tracker's world about the vertical into posed's, radians.
    pub heading: f32,
}

impl Fit {
    /// What the tracker says, said of its bone in posed's world.
    #[must_use]
    pub fn bone(&self, device: &Orientation) -> Orientation {
        let world = device.turned(Quat::from_rotation_y(self.heading));
        Orientation {
            rotation: (world.rotation * self.device_in_bone.inverse()).normalize(),
            ..world
        }
    }
}

/// What one tracker said in each posture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stances([Option<Quat>; Stance::COUNT]);

/// Turns between two postures of less than this tell no axis, radians (10 degrees).
const TURN_MIN: f32 = 0.17;
/// Axes that stand up more than this are not those of the posture: sine of the elevation.
const AXIS_RISE_MAX: f32 = 0.6;

impl Stances {
    /// The tracker's orientation, in its own world, while the posture was held.
    pub fn set(&mut self, posture: Stance, device: Quat) {
        self.0[posture as usize] = Some(device);
    }

    /// How the tracker sits, for a wearer who faced `facing` (radians about the vertical, 0 is
    /// -Z); `None` before a posture that fixes the role's bone.
    #[must_use]
    pub fn fit(&self, role: Role, facing: f32) -> Option<Fit> {
        let fixed = |posture: Stance| Some((posture.bone(role)?, self.0[posture as usize]?));
        // The arms hang by themselves; to stretch them out level takes attention.
        let (bone, device) = fixed(Stance::Straight).or_else(|| fixed(Stance::TPose))?;
        let level = self
            .heading_of_a_turn(role)
            .unwrap_or_else(|| yaw_of(bone * conventional(role) * device.inverse()));
        let device_in_bone = bone.inverse() * Quat::from_rotation_y(level) * device;
        Some(Fit {
            device_in_bone: device_in_bone.normalize(),
            heading: wrap(level + facing),
        })
    }

    /// The heading that turns the measured axis between two postures into the known one.
    fn heading_of_a_turn(&self, role: Role) -> Option<f32> {
        let held = |posture: Stance| self.0[posture as usize];
        let arm = || {
            let (from, to) = (Stance::Straight.bone(role)?, Stance::TPose.bone(role)?);
            let known = (to * from.inverse()).to_scaled_axis();
            axis_heading(held(Stance::Straight)?, held(Stance::TPose)?, known)
        };
        let leaned = || {
            let leans = matches!(
                role,
                Role::Waist | Role::Chest | Role::LeftKnee | Role::RightKnee
            );
            let upright = held(Stance::Straight).or(held(Stance::TPose))?;
            // The upper end goes forward.
            leans.then(|| axis_heading(upright, held(Stance::Crouch)?, Vec3::NEG_X))?
        };
        arm().or_else(leaned)
    }
}

/// The turn about the vertical from the axis of `from` to `to` to the axis `known`.
fn axis_heading(from: Quat, to: Quat, known: Vec3) -> Option<f32> {
    let turn = to * from.inverse();
    let short = if turn.w < 0.0 { -turn } else { turn };
    let axis = short.to_scaled_axis();
    let known = known.try_normalize()?;
    let direction = axis.try_normalize()?;
    let clear = axis.length() > TURN_MIN && direction.y.abs() < AXIS_RISE_MAX;
    let bearing = |v: Vec3| v.x.atan2(v.z);
    clear.then(|| wrap(bearing(known) - bearing(direction)))
}
