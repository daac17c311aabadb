//! The network as one step of 1/60 s, with its memory.

use glam::{Mat3, Quat, Vec3};
use posed_body::JOINTS;

use super::{
    features::{Builder, STREAM, STREAMS},
    mirror::{mirror_answer, mirror_features},
};
use crate::inference::{InferenceError, Network, Port, Runtime};

const INPUTS: [Port; 7] = [
    Port {
        name: "features",
        shape: &[Some(1), Some(STREAMS), Some(STREAM)],
    },
    Port {
        name: "visible",
        shape: &[Some(1), Some(2)],
    },
    Port {
        name: "reset",
        shape: &[Some(1)],
    },
    Port {
        name: "streams",
        shape: &[Some(STREAMS), Some(1), None],
    },
    Port {
        name: "token",
        shape: &[Some(4), Some(1), None],
    },
    Port {
        name: "pose",
        shape: &[Some(1), None],
    },
    Port {
        name: "trajectory",
        shape: &[Some(1), None],
    },
];
const OUTPUTS: [Port; 7] = [
    Port {
        name: "rotation",
        shape: &[Some(1), Some(JOINTS), Some(3), Some(3)],
    },
    Port {
        name: "root",
        shape: &[Some(1), Some(3)],
    },
    Port {
        name: "contact",
        shape: &[Some(1), Some(4)],
    },
    Port {
        name: "streams_next",
        shape: &[Some(STREAMS), Some(1), None],
    },
    Port {
        name: "token_next",
        shape: &[Some(4), Some(1), None],
    },
    Port {
        name: "pose_next",
        shape: &[Some(1), None],
    },
    Port {
        name: "trajectory_next",
        shape: &[Some(1), None],
    },
];
const FEATURES: usize = 0;
const VISIBLE: usize = 1;
const RESET: usize = 2;
/// State inputs, and the outputs that follow them up.
const STATE: std::ops::Range<usize> = 3..7;
const ROTATION: usize = 0;
const ROOT: usize = 1;
const CONTACT: usize = 2;

/// The network's answer to one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Answer {
    /// Local rotations, that of the pelvis to the world.
    pub rotations: [Quat; JOINTS],
    /// The pelvis from the head joint in the world, metres: the trajectory decoder's estimate.
    pub root_from_head: Vec3,
    /// Probabilities that the ankles (left, right) and toes (left, right) stand.
    pub contact: [f32; 4],
}

impl Answer {
    /// From the heading frame and head heights to the world and metres.
    fn in_world(mut self, features: &Builder<'_>) -> Self {
        let heading = Quat::from_rotation_y(features.yaw());
        self.rotations[0] = (heading * self.rotations[0]).normalize();
        self.root_from_head = heading * self.root_from_head * features.height();
        self
    }
}

/// What one run of steps remembers.
#[derive(Debug, Clone)]
pub(super) struct Memory {
    /// The numbers of each state.
    state: [Vec<f32>; STATE.end - STATE.start],
    /// Whether the next step starts from nothing.
    reset: bool,
}

impl Memory {
    /// Drops it before the next step.
    pub(super) fn reset(&mut self) {
        self.reset = true;
    }
}

/// A loaded HMD-NeMo. It makes the steps of any number of memories: weights are read from memory
/// for every step, and those of one network stay in the processor's cache where those of two push
/// each other out (measured: two steps of one take twice as long as a step, of two five times).
pub(super) struct Step {
    network: Network<7, 7>,
}

impl Step {
    pub(super) fn load(
        runtime: &Runtime,
        model: &str,
        bytes: &[u8],
    ) -> Result<Self, InferenceError> {
        let mut network = Network::load(runtime, model, bytes, INPUTS, OUTPUTS)?;
        for port in STATE {
            let (kept, next) = (network.input(port).len(), network.output(port).len());
            if kept != next {
                return Err(InferenceError::Port {
                    model: model.to_owned(),
                    port: format!("output `{}`", OUTPUTS[port].name),
                    wanted: format!("as many numbers as the input, {kept}"),
                    found: format!("{next}"),
                });
            }
        }
        Ok(Self { network })
    }

    /// A memory of nothing.
    pub(super) fn memory(&mut self) -> Memory {
        let mut size = |port: usize| self.network.input(port).len();
        Memory {
            state: std::array::from_fn(|index| vec![0.0; size(STATE.start + index)]),
            reset: true,
        }
    }

    /// One step. `None` when inference fails or answers with numbers that are none; the memory is
    /// then dropped.
    pub(super) fn run(
        &mut self,
        memory: &mut Memory,
        features: &Builder<'_>,
        visible: [bool; 2],
    ) -> Option<Answer> {
        features.write(self.network.input(FEATURES));
        let answer = self.step(memory, visible)?;
        Some(answer.in_world(features))
    }

    /// The same for the wearer's mirror image; the answer is turned back.
    pub(super) fn run_mirrored(
        &mut self,
        memory: &mut Memory,
        features: &Builder<'_>,
        [left, right]: [bool; 2],
    ) -> Option<Answer> {
        features.write(self.network.input(FEATURES));
        mirror_features(self.network.input(FEATURES));
        let answer = self.step(memory, [right, left])?;
        Some(mirror_answer(&answer).in_world(features))
    }

    /// One step with the features that were written.
    fn step(&mut self, memory: &mut Memory, visible: [bool; 2]) -> Option<Answer> {
        let flags = visible.map(|seen| f32::from(u8::from(seen)));
        self.network.input(VISIBLE).copy_from_slice(&flags);
        let reset = f32::from(u8::from(memory.reset));
        self.network.input(RESET).fill(reset);
        for (state, port) in memory.state.iter_mut().zip(STATE) {
            if memory.reset {
                state.fill(0.0);
            }
            self.network.input(port).copy_from_slice(state);
        }
        let ran = self.network.run().is_ok();
        let answer = ran.then(|| self.answer()).flatten();
        memory.reset = answer.is_none();
        if !memory.reset {
            for (state, port) in memory.state.iter_mut().zip(STATE) {
                state.copy_from_slice(self.network.output(port));
            }
        }
        answer
    }

    /// The answer in the heading frame, its lengths over the head height.
    fn answer(&self) -> Option<Answer> {
        let mut rotations = [Quat::IDENTITY; JOINTS];
        let matrices = self.network.output(ROTATION).chunks_exact(9);
        for (rotation, numbers) in rotations.iter_mut().zip(matrices) {
            // Row-major in the file, columns in memory.
            let matrix = Mat3::from_cols_slice(numbers).transpose();
            *rotation = Quat::from_mat3(&matrix).normalize();
        }
        let root_from_head = Vec3::from_slice(self.network.output(ROOT));
        let mut contact = [0.0; 4];
        contact.copy_from_slice(self.network.output(CONTACT));
        let sound = rotations.iter().all(|rotation| rotation.is_finite())
            && root_from_head.is_finite()
            && contact.iter().all(|number| number.is_finite());
        sound.then_some(Answer {
            rotations,
            root_from_head,
            contact,
        })
    }
}
