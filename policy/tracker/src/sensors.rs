//! Where a device sits on the body part that it is worn on or held by, and poses carried over from
//! one to the other: device to part when running, part to device when sensors are simulated.
//!
//! The synthetic sensors of QuestSim (Winkler et al. 2022, §3.4) stand at such fixed offsets from
//! the head and wrist joints.

use std::f32::consts::FRAC_PI_2;

use glam::{EulerRot, Quat, Vec3};
use posed_signal::{Lookup, Pose, Role};

use crate::tracker::Wearer;

/// Height of the eyes over stature (Winter, Biomechanics and Motor Control, after Drillis and
/// Contini 1966).
pub const EYES_OVER_STATURE: f32 = 0.936;
/// Height of a standing wearer's toe joints above the floor, over stature: the median of the
/// motion sets, 2.5 cm at 1.44 m head height.
pub const TOE_JOINT_OVER_STATURE: f32 = 0.0143;
/// Eyes in front of the skull base, over stature: 9 cm at 1.75 m.
const EYES_FORWARD: f32 = 0.051;
/// Axis of a gripped rod beyond the wrist joint and to the palm's side of it, over stature: 7 cm
/// and 2.5 cm at 1.75 m. Winter's hand is 0.108 of stature long.
const GRIP_BEYOND_WRIST: f32 = 0.04;
const GRIP_BELOW_WRIST: f32 = 0.014;
/// How far a gripped rod's thumb end leans towards the fingers from square: a straight hand and a
/// handle meet at 65 degrees (Young et al. 2013, Ergonomics 56).
const ROD_LEAN: f32 = 25.0 / 180.0 * std::f32::consts::PI;

/// A device's frame in the frame of its body part, rigid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// The device's origin in the part's frame, metres.
    pub position: Vec3,
    /// Device frame to part frame, unit.
    pub rotation: Quat,
}

impl Mount {
    /// The device's frame is the part's.
    pub const IDENTITY: Self = Self {
        position: Vec3::ZERO,
        rotation: Quat::IDENTITY,
    };

    /// A headset whose frame lies between the eyes and looks along them (-Z forward, +Y up, as
    /// OpenXR's view space), on the head joint. A wearer who stands upright with the eyes at their
    /// share of the stature has the head joint of the skeleton exactly at its standing height.
    #[must_use]
    pub fn headset(wearer: &Wearer) -> Self {
        let joint = wearer.skeleton.head_height() + TOE_JOINT_OVER_STATURE * wearer.height;
        let up = EYES_OVER_STATURE * wearer.height - joint;
        let position = Vec3::new(0.0, up, -EYES_FORWARD * wearer.height);
        Self {
            position,
            rotation: Quat::IDENTITY,
        }
    }

    /// A frame of OpenXR's grip kind in the hand (centre of the fist; -Z along the gripped rod to
    /// the thumb's end; X square to the palm), on the wrist joint.
    #[must_use]
    pub fn grip(left: bool, wearer: &Wearer) -> Self {
        // The rest pose stretches the arms out sideways with the palms down, thumbs forward.
        let side = if left { -1.0 } else { 1.0 };
        let (beyond, below) = (GRIP_BEYOND_WRIST, GRIP_BELOW_WRIST);
        let position = Vec3::new(side * beyond, -below, 0.0) * wearer.height;
        let square = Quat::from_rotation_z(side * FRAC_PI_2);
        Self {
            position,
            rotation: Quat::from_rotation_y(-side * ROD_LEAN) * square,
        }
    }

    /// A Valve Index controller's frame (origin at the tip, handle along +Z), on the wrist joint.
    #[must_use]
    pub fn index_controller(left: bool, wearer: &Wearer) -> Self {
        Self::grip(left, wearer).times(&index_grip(left).inverse())
    }

    /// This mount, then `inner` in its device's frame.
    #[must_use]
    pub fn times(&self, inner: &Self) -> Self {
        Self {
            position: self.position + self.rotation * inner.position,
            rotation: (self.rotation * inner.rotation).normalize(),
        }
    }

    /// The part's frame in the device's.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            position: -(rotation * self.position),
            rotation,
        }
    }

    /// The device's pose from the part's; velocities follow the lever arm.
    #[must_use]
    pub fn device_pose(&self, part: &Pose) -> Pose {
        let arm = part.rotation * self.position;
        Pose {
            position: part.position + arm,
            rotation: (part.rotation * self.rotation).normalize(),
            velocity: part.velocity + part.angular_velocity.cross(arm),
            ..*part
        }
    }

    /// The part's pose from the device's.
    #[must_use]
    pub fn part_pose(&self, device: &Pose) -> Pose {
        self.inverse().device_pose(device)
    }
}

/// The grip frame in an Index controller's own frame, as SteamVR's render model and Monado's
/// driver place it: 13 cm behind the tip, turned by 15.4, -2.1 and 0.3 degrees (left hand).
fn index_grip(left: bool) -> Mount {
    let side = if left { 1.0 } else { -1.0 };
    let [x, y, z] = [15.392f32, -2.071 * side, 0.303 * side].map(f32::to_radians);
    Mount {
        position: Vec3::new(0.0, -0.015, 0.13),
        rotation: Quat::from_euler(EulerRot::XYZ, x, y, z),
    }
}

/// The mount of every role, for one wearer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounts([Mount; Role::COUNT]);

impl Mounts {
    /// Devices whose frames are the body parts' own: simulated sensors on the joints.
    pub const IDENTITY: Self = Self([Mount::IDENTITY; Role::COUNT]);

    /// A headset at the eyes and Index controllers in the hands. Body trackers are taken to be on
    /// their part until they are calibrated.
    #[must_use]
    pub fn index(wearer: &Wearer) -> Self {
        let mut mounts = Self::IDENTITY;
        mounts.0[Role::Head as usize] = Mount::headset(wearer);
        mounts.0[Role::LeftHand as usize] = Mount::index_controller(true, wearer);
        mounts.0[Role::RightHand as usize] = Mount::index_controller(false, wearer);
        mounts
    }

    /// The mount of a role.
    #[must_use]
    pub fn get(&self, role: Role) -> &Mount {
        &self.0[role as usize]
    }

    /// Replaces the mount of a role, for another kind of device or a calibrated one.
    pub fn set(&mut self, role: Role, mount: Mount) {
        self.0[role as usize] = mount;
    }

    /// What a history said of a role's device, said of its body part.
    #[must_use]
    pub fn part(&self, role: Role, device: Lookup<Pose>) -> Lookup<Pose> {
        let turn = |pose: Pose| self.get(role).part_pose(&pose);
        device.map(turn)
    }
}

/// Fits what the wearer's body parts do to a body `scale` times as tall: everything grows about the
/// place on the floor under the head. So the avatar stands as upright as the wearer and walks where
/// they walk. (The paper leaves positions as they are, section 5.2: a taller avatar crouches.)
pub fn rescale(parts: &mut [Lookup<Pose>; Role::COUNT], scale: f32) {
    if scale == 1.0 {
        return;
    }
    const LEVEL: Vec3 = Vec3::new(1.0, 0.0, 1.0);
    let head = parts[Role::Head as usize].value();
    let (under, along) = head.map_or((Vec3::ZERO, Vec3::ZERO), |head| {
        (head.position * LEVEL, head.velocity * LEVEL)
    });
    for part in parts {
        *part = part.map(|pose| Pose {
            position: under + (pose.position - under) * scale,
            velocity: along + (pose.velocity - along) * scale,
            ..pose
        });
    }
}

#[cfg(test)]
mod tests {
    use posed_body::{BodyPose, Joint};
    use posed_signal::{HostTime, PoseHow};
    use proptest::prelude::*;

    use super::*;

    fn wearer() -> Wearer {
        Wearer::of_height(1.75)
    }

    #[test]
    fn upright_eyes_put_the_head_joint_at_standing_height() {
        for height in [1.3, 1.75, 2.1] {
            let wearer = Wearer::of_height(height);
            let mut eyes = Pose::unknown(HostTime(0));
            eyes.position = Vec3::new(0.3, EYES_OVER_STATURE * height, 1.0);
            let head = Mount::headset(&wearer).part_pose(&eyes);
            let standing = wearer.skeleton.head_height() + TOE_JOINT_OVER_STATURE * height;
            assert!((head.position.y - standing).abs() < 1e-4);
            assert!(
                head.position.z > eyes.position.z,
                "the skull base is behind the eyes"
            );
        }
    }

    #[test]
    fn a_taller_body_stands_where_the_wearer_does() {
        let pose = |x: f32, y: f32| Pose {
            position: Vec3::new(x, y, -3.0),
            velocity: Vec3::new(1.0, 0.5, 0.0),
            ..Pose::unknown(HostTime(0))
        };
        let mut parts = [Lookup::Empty; Role::COUNT];
        parts[Role::Head as usize] = Lookup::Exact(pose(2.0, 1.5));
        parts[Role::LeftHand as usize] = Lookup::Exact(pose(1.6, 1.0));
        let before = parts;
        rescale(&mut parts, 1.0);
        assert_eq!(parts, before);
        rescale(&mut parts, 1.2);
        let head = parts[Role::Head as usize].value().expect("a head");
        let hand = parts[Role::LeftHand as usize].value().expect("a hand");
        assert!(head.position.distance(Vec3::new(2.0, 1.8, -3.0)) < 1e-5);
        assert!(head.velocity.distance(Vec3::new(1.0, 0.6, 0.0)) < 1e-5);
        assert!(hand.position.distance(Vec3::new(1.52, 1.2, -3.0)) < 1e-5);
    }

    #[test]
    fn a_gripped_rod_points_up_when_the_arm_hangs_forward_with_the_thumb_up() {
        for left in [true, false] {
            let wearer = wearer();
            let side = if left { -1.0 } else { 1.0 };
            // The hand stretched out forward, thumb up, from the rest pose: fingers from +-X to
            // -Z, then the back of the hand outward.
            let hand =
                Quat::from_rotation_z(-side * FRAC_PI_2) * Quat::from_rotation_y(side * FRAC_PI_2);
            let mut wrist = Pose::unknown(HostTime(0));
            wrist.rotation = hand;
            let fingers = hand * Vec3::new(side, 0.0, 0.0);
            assert!(fingers.distance(Vec3::NEG_Z) < 1e-5, "{fingers}");
            let thumb = hand * Vec3::NEG_Z;
            assert!(thumb.distance(Vec3::Y) < 1e-5, "{thumb}");
            let grip = Mount::grip(left, &wearer).device_pose(&wrist);
            let rod = grip.rotation * Vec3::NEG_Z;
            let lean = rod.angle_between(Vec3::Y);
            assert!((lean - ROD_LEAN).abs() < 1e-4 && rod.z < 0.0, "{rod}");
            let outward = grip.rotation * Vec3::new(side, 0.0, 0.0);
            assert!(
                outward.distance(Vec3::new(side, 0.0, 0.0)) < 1e-5,
                "back of the hand: {outward}"
            );
            let tip = Mount::index_controller(left, &wearer).device_pose(&wrist);
            assert!(
                tip.position.y > grip.position.y + 0.08,
                "the tip is above the fist"
            );
        }
    }

    #[test]
    fn left_and_right_mirror_each_other() {
        let wearer = wearer();
        let left = Mount::index_controller(true, &wearer);
        let right = Mount::index_controller(false, &wearer);
        let flip = Vec3::new(-1.0, 1.0, 1.0);
        assert!((left.position * flip).distance(right.position) < 1e-6);
        let mirrored = Quat::from_xyzw(
            left.rotation.x,
            -left.rotation.y,
            -left.rotation.z,
            left.rotation.w,
        );
        assert!(mirrored.dot(right.rotation).abs() > 1.0 - 1e-6);
        let rest = wearer.skeleton.forward(&BodyPose::rest(Vec3::ZERO));
        assert!(rest.position(Joint::LeftWrist).x < 0.0);
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_identity(
            axis in prop::array::uniform3(-2.0f32..2.0),
            spin in prop::array::uniform3(-5.0f32..5.0),
            place in prop::array::uniform3(-3.0f32..3.0),
            height in 1.2f32..2.2,
        ) {
            let part = Pose {
                at: HostTime(7),
                position: place.into(),
                rotation: Quat::from_scaled_axis(axis.into()),
                velocity: Vec3::new(0.1, 0.2, 0.3),
                angular_velocity: spin.into(),
                residual_rad: 0.0,
                how: PoseHow::Optical,
            };
            let wearer = Wearer::of_height(height);
            for role in Role::ALL {
                let mounts = Mounts::index(&wearer);
                let device = mounts.get(role).device_pose(&part);
                let back = mounts.part(role, Lookup::Exact(device)).value().unwrap();
                prop_assert!(back.position.distance(part.position) < 1e-5);
                prop_assert!(back.rotation.dot(part.rotation).abs() > 1.0 - 1e-5);
                prop_assert!(back.velocity.distance(part.velocity) < 1e-5);
                // The device's velocity is that of its origin.
                let dt = 1e-3;
                let later = Pose {
                    position: part.position + part.velocity * dt,
                    rotation: Quat::from_scaled_axis(part.angular_velocity * dt) * part.rotation,
                    ..part
                };
                let moved = mounts.get(role).device_pose(&later).position - device.position;
                prop_assert!((moved / dt).distance(device.velocity) < 0.02);
            }
        }
    }
}
