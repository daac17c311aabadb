//! A person with a simulated headset and controllers: a motion clip, joined to the device
//! simulator through the same mounts that tracking takes out again.

use std::{io::Cursor, sync::Arc};

use glam::{DQuat, DVec3};
use posed_body::{
    Joint,
    motion::{
        Clip, MotionError, MotionSet, Trajectory, procedural,
        silhouette::{LIMBS, Limb},
    },
};
use posed_device::simulate::{Device, Model, Occluder, Options, Placement};
use posed_signal::{HostTime, Role};
use posed_tracker::{Mount, Mounts, Wearer};
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
