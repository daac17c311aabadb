//! The network: an observation in, a torque for each hinge out.

use posed_body::character::HINGES;

use super::observation::SIZE;
use crate::inference::{InferenceError, Network, Port, Runtime};

const INPUTS: [Port; 1] = [Port {
    name: "observation",
    shape: &[Some(1), Some(SIZE)],
}];
const OUTPUTS: [Port; 1] = [Port {
    name: "torque",
    shape: &[Some(1), Some(HINGES)],
}];

/// A loaded policy.
pub(super) struct Policy(Network<1, 1>);

impl Policy {
    pub(super) fn load(
        runtime: &Runtime,
        model: &str,
        bytes: &[u8],
    ) -> Result<Self, InferenceError> {
        Network::load(runtime, model, bytes, INPUTS, OUTPUTS).map(Self)
    }

    /// Where the observation goes.
    pub(super) fn observation(&mut self) -> &mut [f32] {
        self.0.input(0)
    }

    /// Torques over their limits, within -1 to 1; `None` when inference fails.
    pub(super) fn act(&mut self) -> Option<[f64; HINGES]> {
        self.0.run().ok()?;
        let answer = self.0.output(0);
        let sound = answer.len() == HINGES && answer.iter().all(|x| x.is_finite());
        sound.then(|| std::array::from_fn(|hinge| f64::from(answer[hinge]).clamp(-1.0, 1.0)))
    }
}
