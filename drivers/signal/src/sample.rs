//! The samples that flow from devices to the tracker. All are `Copy`, in SI units, in posed's
//! world frame (right-handed, Y up, -Z forward, floor at y = 0; OpenXR STAGE).

use glam::{Quat, Vec3};

use crate::time::HostTime;

/// One inertial sample, calibrated, in the device's own tracking frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    /// When it was measured.
    pub at: HostTime,
    /// Specific force, m/s^2: at rest it points up with 9.81.
    pub accel: Vec3,
    /// Angular velocity, rad/s, right-handed about the device's axes.
    pub gyro: Vec3,
}

/// What an inertial tracker says of itself after sensor fusion: its orientation and how it moves,
/// but not where it is.
///
/// In a device's ring the rotated frame is the device's own, and the world is posed's but for its
/// heading: Y is up, while the direction of -Z is whatever the device's fusion began with, and
/// turns slowly, because without a compass nothing holds it. After calibration, in what trackers
/// are given, the rotated frame is that of the bone which carries the device, in posed's world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientation {
    /// When it was measured; for a device without a clock, when its report arrived.
    pub at: HostTime,
    /// The rotated frame to the world, unit.
    pub rotation: Quat,
    /// Acceleration of the place where the device sits, m/s^2, in the world's axes. Gravity is
    /// taken out: at rest it is zero.
    pub accel: Vec3,
    /// rad/s, in the world's axes.
    pub angular_velocity: Vec3,
}

impl Orientation {
    /// Whether every number is finite and the rotation is unit within 1 %.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.accel.is_finite()
            && self.angular_velocity.is_finite()
            && (self.rotation.length_squared() - 1.0).abs() < 0.02
    }

    /// The same said of the world turned by `turn`: a heading put right.
    #[must_use]
    pub fn turned(&self, turn: Quat) -> Self {
        Self {
            at: self.at,
            rotation: (turn * self.rotation).normalize(),
            accel: turn * self.accel,
            angular_velocity: turn * self.angular_velocity,
        }
    }
}

/// How a solved device pose came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum PoseHow {
    /// Not tracked; position and rotation are the last known ones.
    #[default]
    Lost,
    /// Rotation from the IMU alone; the position is held or extrapolated.
    Inertial,
    /// Position and rotation supported by optical measurements.
    Optical,
}

impl PoseHow {
    /// The word used in JSON output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Inertial => "inertial",
            Self::Optical => "optical",
        }
    }
}

/// A 6-DoF pose of a device's tracking frame in the world, with its velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The time that the pose is valid for.
    pub at: HostTime,
    /// Metres.
    pub position: Vec3,
    /// Device frame to world, unit.
    pub rotation: Quat,
    /// m/s, world frame.
    pub velocity: Vec3,
    /// rad/s, world frame.
    pub angular_velocity: Vec3,
    /// Root mean square of the optical residuals behind the pose, rad; 0 where there are none.
    pub residual_rad: f32,
    /// How it came about.
    pub how: PoseHow,
}

impl Pose {
    /// At the origin, at rest, lost.
    #[must_use]
    pub fn unknown(at: HostTime) -> Self {
        Self {
            at,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            velocity: Vec3::ZERO,
            angular_velocity: Vec3::ZERO,
            residual_rad: 0.0,
            how: PoseHow::Lost,
        }
    }

    /// Whether every number is finite and the rotation is unit within 1 %.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.position.is_finite()
            && self.velocity.is_finite()
            && self.angular_velocity.is_finite()
            && self.residual_rad.is_finite()
            && (self.rotation.length_squared() - 1.0).abs() < 0.02
    }
}

/// Buttons, triggers and sticks of a controller. Names follow the OpenXR interaction profiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Buttons {
    /// When the state was reported.
    pub at: HostTime,
    /// Bit set of pressed buttons, see the constants.
    pub pressed: u32,
    /// Bit set of touched buttons.
    pub touched: u32,
    /// Trigger, 0 (released) to 1.
    pub trigger: f32,
    /// Grip or squeeze, 0 to 1.
    pub squeeze: f32,
    /// Thumbstick or pad, each axis -1 to 1, x right, y up.
    pub stick: [f32; 2],
}

impl Buttons {
    /// Trigger pulled to its click.
    pub const TRIGGER: u32 = 1 << 0;
    /// Grip buttons or squeeze.
    pub const SQUEEZE: u32 = 1 << 1;
    /// Application menu.
    pub const MENU: u32 = 1 << 2;
    /// System button.
    pub const SYSTEM: u32 = 1 << 3;
    /// Trackpad.
    pub const TRACKPAD: u32 = 1 << 4;
    /// Thumbstick.
    pub const THUMBSTICK: u32 = 1 << 5;
    /// A.
    pub const A: u32 = 1 << 6;
    /// B.
    pub const B: u32 = 1 << 7;
    /// The headset's proximity sensor says that it is worn.
    pub const PROXIMITY: u32 = 1 << 8;

    /// Nothing pressed.
    #[must_use]
    pub fn released(at: HostTime) -> Self {
        Self {
            at,
            pressed: 0,
            touched: 0,
            trigger: 0.0,
            squeeze: 0.0,
            stick: [0.0; 2],
        }
    }
}

/// A device's battery.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Battery {
    /// When it was reported.
    pub at: HostTime,
    /// 0 (empty) to 1.
    pub charge: f32,
    /// Whether it is on its charger.
    pub charging: bool,
}

/// How well a device's radio is heard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radio {
    /// When it was reported.
    pub at: HostTime,
    /// Signal strength at the receiver, dBm; `None` where it is not known.
    pub rssi_dbm: Option<f32>,
    /// Packets that arrived since the device was first heard.
    pub received: u64,
    /// Packets that did not.
    pub lost: u64,
}

/// Any sample, as it travels through a device's ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sample {
    /// Inertial measurement.
    Imu(Imu),
    /// Orientation of an inertial tracker.
    Orientation(Orientation),
    /// Solved pose.
    Pose(Pose),
    /// Buttons.
    Buttons(Buttons),
    /// Battery.
    Battery(Battery),
    /// Radio link.
    Radio(Radio),
}

impl Sample {
    /// When it was measured.
    #[must_use]
    pub fn at(&self) -> HostTime {
        match self {
            Self::Imu(s) => s.at,
            Self::Orientation(s) => s.at,
            Self::Pose(s) => s.at,
            Self::Buttons(s) => s.at,
            Self::Battery(s) => s.at,
            Self::Radio(s) => s.at,
        }
    }
}
