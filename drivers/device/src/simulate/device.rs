//! What is simulated: which devices there are and how they move.

use glam::{DQuat, DVec3};
use posed_signal::Role;

/// Where a frame is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Metres, in the world.
    pub position: DVec3,
    /// Frame to world, unit.
    pub rotation: DQuat,
}

/// A motion in continuous time. It has to be twice continuously differentiable: the simulated
/// IMU measures its derivatives. A closure from seconds to a [`Placement`] is a path.
pub trait Path: Send {
    /// Where the frame is, `seconds` after the start of the simulation. Times a little before
    /// the start and after the end are asked for too.
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
