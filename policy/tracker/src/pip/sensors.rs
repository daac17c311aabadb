//! What the six sensors say at a tick, and what stands in for one that says nothing.

use glam::{Quat, Vec3};
use posed_body::Joint;
use posed_signal::{HostTime, Lookup, PoseHow, Role};

use crate::{geometry::yaw_of, tracker::Input};

/// Sensors that PIP has.
pub(super) const SENSORS: usize = 6;
/// Their roles, in the order of the features.
const ROLES: [Role; SENSORS] = [
    Role::LeftWrist,
    Role::RightWrist,
    Role::LeftKnee,
    Role::RightKnee,
    Role::Head,
    Role::Waist,
];
/// The joints whose bones carry them.
pub(super) const JOINTS_OF: [Joint; SENSORS] = [
    Joint::LeftElbow,
    Joint::RightElbow,
    Joint::LeftKnee,
    Joint::RightKnee,
    Joint::Head,
    Joint::Pelvis,
];
pub(super) const HEAD: usize = 4;
pub(super) const PELVIS: usize = 5;

/// An acceleration that is carried on longer than this is worth nothing, ns.
const ACCEL_NS_MAX: i64 = 40_000_000;
/// A rotation that is carried on longer than this counts as lost, ns.
const TURN_NS_MAX: i64 = 250_000_000;
/// Accelerations beyond this are taken for faults, m/s²: the most that wrists reach in sports.
const ACCEL_MAX: f32 = 300.0;

/// What one sensor says of the bone that carries it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// Bone to world.
    pub turn: Quat,
    /// Acceleration of the sensor in the world, without gravity, m/s².
    pub accel: Vec3,
}

/// What all of them say at one time; `None` where nothing is heard.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Seen(pub [Option<Reading>; SENSORS]);

impl Seen {
    /// Between `self` (at 0) and `later` (at 1). A sensor is there when it is at both ends.
    pub(super) fn interpolate(&self, later: &Self, fraction: f32) -> Self {
        Self(std::array::from_fn(|sensor| {
            let (a, b) = (self.0[sensor]?, later.0[sensor]?);
            Some(Reading {
                turn: a.turn.slerp(b.turn, fraction).normalize(),
                accel: a.accel.lerp(b.accel, fraction),
            })
        }))
    }

    /// The pelvis's rotation; the identity where it is not known.
    pub(super) fn pelvis(&self) -> Quat {
        self.0[PELVIS].map_or(Quat::IDENTITY, |reading| reading.turn)
    }
}

/// How much is heard, apart from what is bridged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Heard {
    /// Sensors that speak.
    pub count: usize,
    /// Whether the pelvis's rotation is known or can be bridged.
    pub pelvis: bool,
}

/// Listens tick by tick.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ears {
    /// The last velocity of each role that is tracked with a position: its change is what an
    /// accelerometer would say.
    velocities: [Option<(HostTime, Vec3)>; SENSORS],
    /// The pelvis's last rotation, and the head's heading then.
    pelvis: Option<(Quat, f32)>,
}

impl Ears {
    /// What is heard now. A pelvis that is silent follows the head's heading.
    pub(super) fn listen(&mut self, input: &Input<'_>) -> (Seen, Heard) {
        let mut seen = Seen(std::array::from_fn(|sensor| self.one(input, sensor)));
        let count = seen.0.iter().flatten().count();
        let heading = seen.0[HEAD].map(|head| yaw_of(head.turn));
        match (seen.0[PELVIS], self.pelvis) {
            (Some(pelvis), last) => {
                let heading = heading.or(last.map(|(_, heading)| heading)).unwrap_or(0.0);
                self.pelvis = Some((pelvis.turn, heading));
            }
            (None, Some((turn, since))) => {
                let turned = heading.map_or(0.0, |heading| heading - since);
                seen.0[PELVIS] = Some(Reading {
                    turn: (Quat::from_rotation_y(turned) * turn).normalize(),
                    accel: Vec3::ZERO,
                });
            }
            (None, None) => {}
        }
        let pelvis = seen.0[PELVIS].is_some();
        (seen, Heard { count, pelvis })
    }

    fn one(&mut self, input: &Input<'_>, sensor: usize) -> Option<Reading> {
        let role = ROLES[sensor];
        if let Some(reading) = inertial(input, role) {
            return Some(reading);
        }
        let pose = input.part(role).fresh()?;
        if pose.how == PoseHow::Lost || !pose.is_sound() {
            self.velocities[sensor] = None;
            return None;
        }
        let now = (input.target, pose.velocity);
        let accel = match self.velocities[sensor].replace(now) {
            Some((before, velocity)) if input.target > before => {
                let seconds = input.target.since_secs(before) as f32;
                (pose.velocity - velocity) / seconds.max(1e-3)
            }
            _ => Vec3::ZERO,
        };
        Some(Reading {
            turn: pose.rotation.normalize(),
            accel: accel.clamp_length_max(ACCEL_MAX),
        })
    }
}

/// The role's inertial tracker, unless it has been silent for long.
fn inertial(input: &Input<'_>, role: Role) -> Option<Reading> {
    let lookup = input.inertial[role as usize];
    let orientation = lookup.fresh()?;
    let carried = match lookup {
        Lookup::Extrapolated { by_ns, .. } => by_ns.abs(),
        _ => 0,
    };
    if !orientation.is_sound() || carried > TURN_NS_MAX {
        return None;
    }
    let accel = if carried > ACCEL_NS_MAX {
        Vec3::ZERO
    } else {
        orientation.accel.clamp_length_max(ACCEL_MAX)
    };
    Some(Reading {
        turn: orientation.rotation.normalize(),
        accel,
    })
}
