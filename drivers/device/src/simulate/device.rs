//! What is simulated: which devices there are and how they move.

use glam::{DQuat, DVec3};
use posed_signal::Role;

/// Where a frame is in another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Metres.
    pub position: DVec3,
    /// Inner frame to outer, unit.
    pub rotation: DQuat,
}

impl Placement {
    /// The frame itself.
    pub const IDENTITY: Self = Self {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };

    /// A point of the inner frame, in the outer one.
    #[must_use]
    pub fn point(&self, inner: DVec3) -> DVec3 {
        self.position + self.rotation * inner
    }

    /// Where a frame is that is placed in this one.
    #[must_use]
    pub fn then(&self, inner: &Self) -> Self {
        Self {
            position: self.point(inner.position),
            rotation: self.rotation * inner.rotation,
        }
    }

    /// The outer frame, seen from the inner one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            position: rotation * -self.position,
            rotation,
        }
    }
}

/// A motion in continuous time. It has to be twice continuously differentiable: the simulated
/// IMU measures its derivatives. A closure from seconds to a [`Placement`] is a path.
pub trait Path: Send {
    /// Where the frame is in the world, `seconds` after the start of the simulation. Times up to
    /// a tenth of a second before the start and after the end are asked for too.
    fn at(&self, seconds: f64) -> Placement;
}

impl<F: Fn(f64) -> Placement + Send> Path for F {
    fn at(&self, seconds: f64) -> Placement {
        self(seconds)
    }
}

/// Kinds of devices that can be simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// Index headset on its cable.
    Headset,
    /// Left Index controller behind a dongle.
    LeftController,
    /// Right Index controller behind a dongle.
    RightController,
}

impl Model {
    /// The role that it plays.
    #[must_use]
    pub fn role(self) -> Role {
        match self {
            Self::Headset => Role::Head,
            Self::LeftController => Role::LeftHand,
            Self::RightController => Role::RightHand,
        }
    }
}

/// One simulated device.
pub struct Device {
    /// What it is.
    pub model: Model,
    /// Serial number in its configuration.
    pub serial: String,
    /// Motion of its tracking frame: the frame whose pose the decoders report (the `head` frame
    /// of the configuration: -Z forward, +X right).
    pub path: Box<dyn Path>,
}

impl Device {
    /// A device with a serial of its model, for example `SIM-HMD00001`.
    #[must_use]
    pub fn new(model: Model, path: impl Path + 'static) -> Self {
        let serial = match model {
            Model::Headset => "SIM-HMD00001",
            Model::LeftController => "SIM-CTL0000L",
            Model::RightController => "SIM-CTL0000R",
        };
        Self {
            model,
            serial: serial.to_owned(),
            path: Box::new(path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placements_compose_and_invert() {
        let outer = Placement {
            position: DVec3::new(1.0, 2.0, 3.0),
            rotation: DQuat::from_rotation_y(0.7),
        };
        let inner = Placement {
            position: DVec3::new(-0.2, 0.1, 0.4),
            rotation: DQuat::from_rotation_x(-1.1),
        };
        let point = DVec3::new(0.3, -0.5, 0.2);
        let both = outer.then(&inner);
        assert!((both.point(point) - outer.point(inner.point(point))).length() < 1e-12);
        assert!((both.inverse().point(both.point(point)) - point).length() < 1e-12);
    }
}
