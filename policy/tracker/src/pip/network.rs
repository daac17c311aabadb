//! The five networks as one step of 1/60 s, with their memory.

use glam::{Mat3, Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint};

use super::{
    features::{self, FEATURES, LEAF_NUMBERS, localise},
    sensors::Seen,
};
use crate::inference::{InferenceError, Network, Port, Runtime};

/// Joints whose rotation is predicted.
pub(super) const PREDICTED: [Joint; 15] = [
    Joint::LeftHip,
    Joint::RightHip,
    Joint::Spine1,
    Joint::LeftKnee,
    Joint::RightKnee,
    Joint::Spine2,
    Joint::Spine3,
    Joint::Neck,
    Joint::LeftCollar,
    Joint::RightCollar,
    Joint::Head,
    Joint::LeftShoulder,
    Joint::RightShoulder,
    Joint::LeftElbow,
    Joint::RightElbow,
];

const INPUTS: [Port; 5] = [
    Port {
        name: "features",
        shape: &[Some(1), Some(FEATURES)],
    },
    Port {
        name: "reset",
        shape: &[Some(1)],
    },
    Port {
        name: "first_leaves",
        shape: &[Some(1), Some(LEAF_NUMBERS)],
    },
    Port {
        name: "first_velocities",
        shape: &[Some(1), Some(3 * JOINTS)],
    },
    Port {
        name: "state",
        shape: &[Some(1), None],
    },
];
const OUTPUTS: [Port; 5] = [
    Port {
        name: "rotations",
        shape: &[Some(1), Some(PREDICTED.len()), Some(3), Some(3)],
    },
    Port {
        name: "velocities",
        shape: &[Some(1), Some(JOINTS), Some(3)],
    },
    Port {
        name: "contact",
        shape: &[Some(1), Some(2)],
    },
    Port {
        name: "joints",
        shape: &[Some(1), Some(JOINTS - 1), Some(3)],
    },
    Port {
        name: "state_next",
        shape: &[Some(1), None],
    },
];
const FEATURE_INPUT: usize = 0;
const RESET: usize = 1;
const FIRST_LEAVES: usize = 2;
const FIRST_VELOCITIES: usize = 3;
const STATE: usize = 4;
const ROTATIONS: usize = 0;
const VELOCITIES: usize = 1;
const CONTACT: usize = 2;
const STATE_NEXT: usize = 4;

/// The motion status of one step (PIP section 3.1): what physics takes as its reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Answer {
    /// Local rotations, that of the pelvis to the world as its sensor says; the root is unknown.
    pub pose: BodyPose,
    /// Joint velocities in the world, m/s.
    pub velocities: [Vec3; JOINTS],
    /// Probabilities that the left and the right foot stand.
    pub contact: [f32; 2],
}

/// The loaded networks with their memory.
pub(super) struct Step {
    network: Network<5, 5>,
    first: [f32; LEAF_NUMBERS],
    reset: bool,
}

impl Step {
    pub(super) fn load(
        runtime: &Runtime,
        model: &str,
        bytes: &[u8],
    ) -> Result<Self, InferenceError> {
        Ok(Self {
            network: Network::load(runtime, model, bytes, INPUTS, OUTPUTS)?,
            first: [0.0; LEAF_NUMBERS],
            reset: true,
        })
    }

    /// Begins the memory anew at the next step, for somebody at rest whose leaf joints are there.
    pub(super) fn begin(&mut self, leaves: [f32; LEAF_NUMBERS]) {
        self.first = leaves;
        self.reset = true;
    }

    /// One step. `None` when inference fails or answers with numbers that are none; the memory is
    /// then begun anew.
    pub(super) fn run(&mut self, seen: &Seen, height: f32) -> Option<Answer> {
        features::write(seen, height, self.network.input(FEATURE_INPUT));
        let reset = f32::from(u8::from(self.reset));
        self.network.input(RESET).fill(reset);
        if self.reset {
            self.network
                .input(FIRST_LEAVES)
                .copy_from_slice(&self.first);
            self.network.input(FIRST_VELOCITIES).fill(0.0);
            self.network.input(STATE).fill(0.0);
        }
        let ran = self.network.run().is_ok();
        let answer = ran.then(|| self.answer(seen, height)).flatten();
        self.reset = answer.is_none();
        if !self.reset {
            self.network.feed_back(STATE_NEXT, STATE);
        }
        answer
    }

    fn answer(&self, seen: &Seen, height: f32) -> Option<Answer> {
        let pelvis = seen.pelvis();
        let mut world = [pelvis; JOINTS];
        let matrices = self.network.output(ROTATIONS).chunks_exact(9);
        for (joint, numbers) in PREDICTED.into_iter().zip(matrices) {
            // Row-major in the file, columns in memory.
            let matrix = Mat3::from_cols_slice(numbers).transpose();
            world[joint as usize] = (pelvis * Quat::from_mat3(&matrix)).normalize();
        }
        let mut pose = BodyPose::rest(Vec3::ZERO);
        localise(&mut pose, &world);
        let mut velocities = [Vec3::ZERO; JOINTS];
        let numbers = self.network.output(VELOCITIES).chunks_exact(3);
        for (velocity, numbers) in velocities.iter_mut().zip(numbers) {
            *velocity = pelvis * Vec3::from_slice(numbers) * height;
        }
        let mut contact = [0.0; 2];
        contact.copy_from_slice(self.network.output(CONTACT));
        let sound = pose.is_sound()
            && velocities.iter().all(|velocity| velocity.is_finite())
            && contact.iter().all(|number| number.is_finite());
        sound.then_some(Answer {
            pose,
            velocities,
            contact,
        })
    }
}
