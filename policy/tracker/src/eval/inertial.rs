//! Inertial sensors on a recorded motion, as PIP and TransPose synthesise them.

use glam::DVec3;
use posed_body::{Joint, Skeleton, motion::Trajectory};
use posed_signal::{HostTime, Imu, Role};

const GRAVITY: f64 = 9.81;
/// Accelerations are second differences over this many frames of 1/60 s to either side (TransPose
/// §3.3, smoothing 4): what is left of real sensors after their filters.
const SMOOTHING_S: f64 = 4.0 / 60.0;

/// Where a sensor is strapped on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    /// The joint whose bone carries it, and whose frame is the sensor's.
    pub joint: Joint,
    /// Its place in that frame, metres.
    offset: DVec3,
}

impl Placement {
    /// PIP's six: the forearms near the wrist, the shanks below the knee, the head and the pelvis.
    /// PIP names vertices of the SMPL mesh; these are the same places on the bones.
    pub(super) fn of(role: Role, skeleton: &Skeleton) -> Option<Self> {
        let bone = |joint: Joint| skeleton.offsets[joint as usize].as_dvec3();
        let (joint, offset) = match role {
            Role::LeftWrist => (
                Joint::LeftElbow,
                bone(Joint::LeftWrist) * 0.8 + DVec3::Y * 0.03,
            ),
            Role::RightWrist => (
                Joint::RightElbow,
                bone(Joint::RightWrist) * 0.8 + DVec3::Y * 0.03,
            ),
            Role::LeftKnee => (
                Joint::LeftKnee,
                bone(Joint::LeftAnkle) * 0.2 - DVec3::Z * 0.05,
            ),
            Role::RightKnee => (
                Joint::RightKnee,
                bone(Joint::RightAnkle) * 0.2 - DVec3::Z * 0.05,
            ),
            Role::Head => (Joint::Head, DVec3::new(0.0, 0.1, 0.05)),
            Role::Waist => (Joint::Pelvis, DVec3::new(0.0, 0.05, 0.1)),
            _ => return None,
        };
        Some(Self { joint, offset })
    }
}

/// The sample at a time: specific force and angular velocity in the sensor's frame.
pub(super) fn measure(trajectory: &Trajectory, placement: &Placement, seconds: f64) -> Imu {
    let place = |seconds: f64| {
        let motion = trajectory.joint(placement.joint, seconds);
        motion.position + motion.rotation * placement.offset
    };
    let (before, now, after) = (
        place(seconds - SMOOTHING_S),
        place(seconds),
        place(seconds + SMOOTHING_S),
    );
    let accel = (before - 2.0 * now + after) / (SMOOTHING_S * SMOOTHING_S);
    let motion = trajectory.joint(placement.joint, seconds);
    let into_sensor = motion.rotation.inverse();
    Imu {
        at: HostTime(0),
        accel: (into_sensor * (accel + DVec3::Y * GRAVITY)).as_vec3(),
        gyro: (into_sensor * motion.angular_velocity).as_vec3(),
    }
}
