//! What the wearer's devices say of a recorded motion.

use glam::Vec3;
use posed_body::{
    Joint,
    motion::{Clip, JointMotion, Trajectory},
};
use posed_signal::{HostTime, Lookup, Orientation, Pose, PoseHow, Role};

use super::inertial::{Placement, Straps};
use crate::tracker::{Input, NO_INERTIAL, Tracked, Tracker, Wearer};

/// Which devices the wearer has on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sensors {
    /// A headset alone.
    Hmd,
    /// A headset and two controllers, always tracked (QuestSim §3.4).
    #[default]
    HmdControllers,
    /// A headset that sees hands inside its field of view only (HMD-NeMo §4).
    HmdHands,
    /// Inertial sensors on forearms, shanks, head and pelvis (PIP §4).
    Imu6,
}

impl Sensors {
    /// Every set.
    pub const ALL: [Self; 4] = [Self::Hmd, Self::HmdControllers, Self::HmdHands, Self::Imu6];

    /// The name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hmd => "hmd",
            Self::HmdControllers => "hmd+controllers",
            Self::HmdHands => "hmd+hands",
            Self::Imu6 => "imu6",
        }
    }

    /// The inverse of [`Sensors::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sensors| sensors.name() == name)
    }
}

/// The space in which a headset's cameras track hands, like HoloLens 2's: a pyramid between two
/// distances, in front of the eyes and pitched down. HMD-NeMo names the device, not the numbers;
/// these make hands visible about as often as there. Lengths over the head height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frustum {
    /// Cameras above the head joint.
    pub up: f32,
    /// Cameras in front of it.
    pub forward: f32,
    /// Radians below the head's forward axis.
    pub pitch_down: f32,
    /// Half of the horizontal opening, radians.
    pub half_width: f32,
    /// Half of the vertical opening, radians.
    pub half_height: f32,
    /// Nearest and farthest distance.
    pub range: (f32, f32),
}

impl Default for Frustum {
    fn default() -> Self {
        Self {
            up: 0.08 / 1.5,
            forward: 0.09 / 1.5,
            pitch_down: 0.45,
            half_width: 1.0,
            half_height: 0.95,
            range: (0.1 / 1.5, 1.1 / 1.5),
        }
    }
}

impl Frustum {
    /// Whether a hand at `in_head`, in the head joint's frame and over the head height, is seen.
    #[must_use]
    pub fn sees(&self, in_head: Vec3) -> bool {
        let from_camera = in_head - Vec3::new(0.0, self.up, -self.forward);
        let (sine, cosine) = self.pitch_down.sin_cos();
        let depth = -from_camera.z * cosine - from_camera.y * sine;
        let height = from_camera.y * cosine - from_camera.z * sine;
        let distance = from_camera.length();
        depth > 0.0
            && from_camera.x.abs().atan2(depth) < self.half_width
            && height.abs().atan2(depth) < self.half_height
            && distance > self.range.0
            && distance < self.range.1
    }
}

/// A moving wearer with devices on.
pub struct Shown<'a> {
    trajectory: &'a Trajectory,
    sensors: Sensors,
    /// The inertial sensors that are worn.
    placements: [Option<Placement>; Role::COUNT],
    frustum: Frustum,
    head_height: f32,
}

impl<'a> Shown<'a> {
    /// The wearer of a clip. `straps` tell how inertial sensors sit, if they are worn.
    #[must_use]
    pub fn new(trajectory: &'a Trajectory, clip: &Clip, sensors: Sensors, straps: Straps) -> Self {
        let placement = |role| {
            let worn = sensors == Sensors::Imu6;
            let seed = fnv1a(&clip.name);
            worn.then(|| Placement::of(role, &clip.skeleton, straps, seed))?
        };
        Self {
            trajectory,
            sensors,
            placements: Role::ALL.map(placement),
            frustum: Frustum::default(),
            head_height: clip.skeleton.head_height().max(0.1),
        }
    }

    /// Seconds until the motion's end.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.trajectory.duration()
    }

    /// What a tracker makes at `target` of the body parts as they are then, `seconds` into the
    /// motion, with no delay and none missed; it looks ahead as far as it asks to.
    pub fn track(
        &self,
        tracker: &mut dyn Tracker,
        wearer: &Wearer,
        seconds: f64,
        target: HostTime,
    ) -> Tracked {
        let parts = |seconds: f64, at: HostTime| -> [Lookup<Pose>; Role::COUNT] {
            Role::ALL.map(|role| {
                self.pose(role, seconds, at)
                    .map_or(Lookup::Empty, Lookup::Exact)
            })
        };
        for (index, &by_ns) in tracker.foresight().iter().enumerate() {
            let at = target.plus_ns(by_ns);
            tracker.foresee(index, at, &parts(seconds + by_ns as f64 * 1e-9, at));
        }
        tracker.track(&Input {
            target,
            parts: &parts(seconds, target),
            inertial: &NO_INERTIAL,
            wearer,
        })
    }

    /// The pose of a role's body part, stamped `at`; `None` where nothing is worn there.
    #[must_use]
    pub fn pose(&self, role: Role, seconds: f64, at: HostTime) -> Option<Pose> {
        let joint = match (role, self.sensors) {
            (_, Sensors::Imu6) | (Role::LeftHand | Role::RightHand, Sensors::Hmd) => return None,
            (Role::Head, _) => Joint::Head,
            (Role::LeftHand, _) => Joint::LeftWrist,
            (Role::RightHand, _) => Joint::RightWrist,
            _ => return None,
        };
        let mut pose = optical(&self.trajectory.joint(joint, seconds), at);
        if self.sensors == Sensors::HmdHands && role != Role::Head {
            let head = self.trajectory.joint(Joint::Head, seconds);
            let in_head = head.rotation.inverse() * (pose.position.as_dvec3() - head.position);
            if !self.frustum.sees(in_head.as_vec3() / self.head_height) {
                pose.how = PoseHow::Lost;
            }
        }
        Some(pose)
    }

    /// What the role's inertial tracker says, calibrated, stamped `at`; only of the six that PIP
    /// has.
    #[must_use]
    pub fn orientation(&mut self, role: Role, seconds: f64, at: HostTime) -> Option<Orientation> {
        let placement = self.placements[role as usize].as_mut()?;
        Some(placement.measure(self.trajectory, seconds, at))
    }
}

/// Fowler, Noll and Vo's hash: the same seed for a name in every run and build.
fn fnv1a(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

fn optical(motion: &JointMotion, at: HostTime) -> Pose {
    Pose {
        at,
        position: motion.position.as_vec3(),
        rotation: motion.rotation.as_quat().normalize(),
        velocity: motion.velocity.as_vec3(),
        angular_velocity: motion.angular_velocity.as_vec3(),
        residual_rad: 0.0,
        how: PoseHow::Optical,
    }
}
