//! A person with a simulated headset and controllers: a motion clip, joined to the device
//! simulator through the same mounts that tracking takes out again.

use std::{io::Cursor, sync::Arc};

use glam::{DQuat, DVec3, Quat, Vec3};
use posed_body::{
    Joint,
    motion::{
        Clip, MotionError, MotionSet, Trajectory, procedural,
        silhouette::{LIMBS, Limb},
    },
};
use posed_device::simulate::{Device, Model, Occluder, Options, Placement, slimevr};
use posed_signal::{HostTime, Role};
use posed_tracker::{Mount, Mounts, Wearer, worn};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg32;
use serde::Serialize;

/// The built-in human of the given stature in metres.
#[must_use]
pub fn built_in(height: f32, seed: u64) -> Clip {
    procedural::timeline(height, seed)
}

/// A clip of a motion file.
///
/// # Errors
/// The bytes are no motion set, or it has no such clip.
pub fn from_file(bytes: &[u8], clip: &str) -> Result<Clip, MotionError> {
    Ok(MotionSet::read(Cursor::new(bytes))?.named(clip)?.centred())
}

/// Address of the first simulated tracker; the others follow it.
const TRACKER_ADDRESS: u64 = 0x5117_0000_0001;
/// The farthest that a tracker is strapped on askew about each axis, radians (20 degrees).
const ASKEW: f32 = 0.35;

/// The name of the `index`-th simulated tracker.
#[must_use]
pub fn tracker_serial(index: usize) -> String {
    format!("{:012X}", TRACKER_ADDRESS + index as u64)
}

/// Where six trackers are worn, as `--trackers six` has them and as PIP needs them.
pub const SIX: [Role; 6] = [
    Role::Waist,
    Role::LeftKnee,
    Role::RightKnee,
    Role::LeftWrist,
    Role::RightWrist,
    Role::Head,
];

/// Whether a tracker can be strapped to a role's bone.
#[must_use]
pub fn carries(role: Role) -> bool {
    !matches!(role, Role::None | Role::LeftHand | Role::RightHand)
}

/// One line of the truth about the body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodyTruth {
    /// Host time, ns.
    pub t_ns: u64,
    /// Position of the pelvis, metres.
    pub root: [f32; 3],
    /// Positions of the 22 joints, metres.
    pub joints: Vec<[f32; 3]>,
    /// Local rotations of the 22 joints, x, y, z, w.
    pub rotations: Vec<[f32; 4]>,
}

/// Somebody who moves, wearing a headset and holding two controllers.
#[derive(Debug, Clone)]
pub struct Person {
    trajectory: Arc<Trajectory>,
    wearer: Wearer,
}

impl Person {
    /// Moves as the clip says.
    #[must_use]
    pub fn new(clip: &Clip) -> Self {
        let wearer = Wearer {
            height: clip.skeleton.stature(),
            skeleton: clip.skeleton,
        };
        Self {
            trajectory: Arc::new(Trajectory::new(clip)),
            wearer,
        }
    }

    /// The wearer, with the clip's own bones.
    #[must_use]
    pub fn wearer(&self) -> &Wearer {
        &self.wearer
    }

    /// Options of a simulation as long as the motion, or `seconds` if that is less.
    #[must_use]
    pub fn options(&self, seed: u64, seconds: Option<f64>) -> Options {
        let whole = self.trajectory.duration();
        let stature = f64::from(self.wearer.height);
        let occluder = |limb: &Limb| {
            let (trajectory, limb) = (Arc::clone(&self.trajectory), *limb);
            Occluder {
                axis: Box::new(move |seconds| limb.axis(&trajectory, seconds)),
                radius: limb.radius(stature),
            }
        };
        Options {
            seed,
            duration_s: seconds.map_or(whole, |seconds| seconds.min(whole)),
            occluders: LIMBS.iter().map(occluder).collect(),
            ..Options::default()
        }
    }

    /// Headset and both controllers.
    #[must_use]
    pub fn devices(&self) -> Vec<Device> {
        let mounts = Mounts::index(&self.wearer);
        [
            (Model::Headset, Role::Head, Joint::Head),
            (Model::LeftController, Role::LeftHand, Joint::LeftWrist),
            (Model::RightController, Role::RightHand, Joint::RightWrist),
        ]
        .into_iter()
        .map(|(model, role, joint)| self.device(model, *mounts.get(role), joint))
        .collect()
    }

    /// Trackers on these roles' bones, strapped on by a hand that `seed` makes: up to 20 degrees
    /// askew. Roles that carry none are left out.
    #[must_use]
    pub fn trackers(&self, roles: &[Role], seed: u64) -> Vec<slimevr::Tracker> {
        let mut random = Pcg32::seed_from_u64(seed);
        let mut tracker = |(index, &role): (usize, &Role)| {
            let askew = Vec3::from_array([(); 3].map(|()| random.random_range(-ASKEW..=ASKEW)));
            let (joint, position) = self.strap(role)?;
            let rotation = worn::conventional(role) * Quat::from_scaled_axis(askew);
            let rotation = rotation.as_dquat().normalize();
            let trajectory = Arc::clone(&self.trajectory);
            let path = move |seconds: f64| {
                let carried = trajectory.joint(joint, seconds).carry(position, rotation);
                Placement {
                    position: carried.position,
                    rotation: carried.rotation,
                }
            };
            Some(slimevr::Tracker {
                address: TRACKER_ADDRESS + index as u64,
                role,
                path: Box::new(path),
            })
        };
        roles.iter().enumerate().filter_map(&mut tracker).collect()
    }

    /// The bone that carries a role's tracker, and the place on it, metres.
    fn strap(&self, role: Role) -> Option<(Joint, DVec3)> {
        let bone = |joint: Joint| self.wearer.skeleton.offsets[joint as usize].as_dvec3();
        let arm = |end: Joint| bone(end) * 0.8 + DVec3::Y * 0.03;
        let shank = |end: Joint| bone(end) * 0.2 - DVec3::Z * 0.05;
        let foot = DVec3::new(0.0, 0.04, -0.06);
        Some(match role {
            Role::Head => (Joint::Head, DVec3::new(0.0, 0.1, -0.1)),
            Role::Waist => (Joint::Pelvis, DVec3::new(0.0, 0.05, -0.1)),
            Role::Chest => (Joint::Spine3, DVec3::new(0.0, 0.05, -0.1)),
            Role::LeftKnee => (Joint::LeftKnee, shank(Joint::LeftAnkle)),
            Role::RightKnee => (Joint::RightKnee, shank(Joint::RightAnkle)),
            Role::LeftFoot => (Joint::LeftAnkle, foot),
            Role::RightFoot => (Joint::RightAnkle, foot),
            Role::LeftElbow => (Joint::LeftShoulder, arm(Joint::LeftElbow)),
            Role::RightElbow => (Joint::RightShoulder, arm(Joint::RightElbow)),
            Role::LeftWrist => (Joint::LeftElbow, arm(Joint::LeftWrist)),
            Role::RightWrist => (Joint::RightElbow, arm(Joint::RightWrist)),
            Role::None | Role::LeftHand | Role::RightHand => return None,
        })
    }

    fn device(&self, model: Model, mount: Mount, joint: Joint) -> Device {
        let trajectory = Arc::clone(&self.trajectory);
        let (position, rotation): (DVec3, DQuat) = (
            mount.position.as_dvec3(),
            mount.rotation.as_dquat().normalize(),
        );
        Device::new(model, move |seconds: f64| {
            let carried = trajectory.joint(joint, seconds).carry(position, rotation);
            Placement {
                position: carried.position,
                rotation: carried.rotation,
            }
        })
    }

    /// The body's true poses every `step_ns` from `start`, for `seconds`.
    pub fn truth(
        &self,
        step_ns: u64,
        start: HostTime,
        seconds: f64,
    ) -> impl Iterator<Item = BodyTruth> + '_ {
        let steps = (seconds * 1e9 / step_ns as f64) as u64;
        (0..=steps).map(move |step| {
            let time = start.plus_ns((step * step_ns).cast_signed());
            let pose = self.trajectory.pose(time.since_secs(start));
            let joints = self.wearer.skeleton.forward(&pose);
            BodyTruth {
                t_ns: time.0,
                root: pose.root.to_array(),
                joints: joints.positions.iter().map(|p| p.to_array()).collect(),
                rotations: pose.rotations.iter().map(|q| q.to_array()).collect(),
            }
        })
    }
}
