//! The network asked twice: of what is seen, and of its mirror image.
//!
//! A body and its mirror image move alike, so the mean of the answer and the mirrored answer is as
//! true as either, and what the network is unsure of partly cancels. Costs a second inference.

use glam::{Quat, Vec3};
use posed_body::JOINTS;

use super::{
    features::{Builder, STREAM},
    network::{Answer, Memory, Step},
};

/// Joint order with left and right exchanged.
const SIDES: [usize; JOINTS] = [
    0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20,
];
/// Signs of a stream's numbers in a mirror across x = 0: the columns of a rotation, a position, an
/// angular velocity, a velocity.
const SIGNS: [f32; STREAM] = [
    1.0, -1.0, -1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0, 1.0,
];

/// Features of the mirrored wearer, in place.
pub(super) fn mirror_features(features: &mut [f32]) {
    for stream in features.chunks_exact_mut(STREAM) {
        for (number, sign) in stream.iter_mut().zip(SIGNS) {
            *number *= sign;
        }
    }
    // Streams 1 and 2 are the hands, so are 3 and 4.
    for left in [STREAM, 3 * STREAM] {
        if let Some(hands) = features.get_mut(left..left + 2 * STREAM) {
            let (left, right) = hands.split_at_mut(STREAM);
            left.swap_with_slice(right);
        }
    }
}

/// The answer for the mirrored wearer, in the frame that was mirrored.
pub(super) fn mirror_answer(answer: &Answer) -> Answer {
    let flip = |q: Quat| Quat::from_xyzw(q.x, -q.y, -q.z, q.w);
    let [left, right, left_toe, right_toe] = answer.contact;
    Answer {
        rotations: SIDES.map(|joint| flip(answer.rotations[joint])),
        root_from_head: answer.root_from_head * Vec3::new(-1.0, 1.0, 1.0),
        contact: [right, left, right_toe, left_toe],
    }
}

/// Between two answers.
fn mean(a: &Answer, b: &Answer) -> Answer {
    let between = |a: Quat, b: Quat| {
        let near = if a.dot(b) < 0.0 { -b } else { b };
        (a + near).normalize()
    };
    Answer {
        rotations: std::array::from_fn(|joint| between(a.rotations[joint], b.rotations[joint])),
        root_from_head: (a.root_from_head + b.root_from_head) * 0.5,
        contact: std::array::from_fn(|foot| (a.contact[foot] + b.contact[foot]) * 0.5),
    }
}

/// A network with its memory and, if wanted, that of the mirror image.
pub(super) struct Pair {
    step: Step,
    plain: Memory,
    mirrored: Option<Memory>,
}

impl Pair {
    pub(super) fn new(mut step: Step, mirror: bool) -> Self {
        Self {
            plain: step.memory(),
            mirrored: mirror.then(|| step.memory()),
            step,
        }
    }

    /// Drops the memory before the next step.
    pub(super) fn reset(&mut self) {
        self.plain.reset();
        if let Some(mirrored) = &mut self.mirrored {
            mirrored.reset();
        }
    }

    /// One step. `None` when an inference fails; all memory is then dropped.
    pub(super) fn run(&mut self, features: &Builder<'_>, visible: [bool; 2]) -> Option<Answer> {
        let plain = self.step.run(&mut self.plain, features, visible);
        let Some(mirrored) = &mut self.mirrored else {
            return plain;
        };
        let mirrored = plain.and_then(|_| self.step.run_mirrored(mirrored, features, visible));
        let both = plain.zip(mirrored);
        if both.is_none() {
            self.reset();
        }
        both.map(|(plain, mirrored)| mean(&plain, &mirrored))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrored_twice_is_as_before() {
        let mut features: Vec<f32> = (0..5 * STREAM as u16).map(f32::from).collect();
        let before = features.clone();
        mirror_features(&mut features);
        assert_ne!(features, before);
        assert_eq!(features[7], before[7], "the head's height stays");
        assert_eq!(features[STREAM + 7], before[2 * STREAM + 7]);
        mirror_features(&mut features);
        assert_eq!(features, before);

        let turn =
            |joint: usize| Quat::from_euler(glam::EulerRot::XYZ, 0.1, 0.02 * joint as f32, -0.2);
        let answer = Answer {
            rotations: std::array::from_fn(turn),
            root_from_head: Vec3::new(0.1, -0.6, 0.05),
            contact: [0.1, 0.2, 0.3, 0.4],
        };
        let mirrored = mirror_answer(&answer);
        assert_eq!(mirrored.contact, [0.2, 0.1, 0.4, 0.3]);
        assert_ne!(mirrored.rotations, answer.rotations);
        assert_eq!(mirror_answer(&mirrored), answer);
        let same = mean(&answer, &answer);
        for joint in 0..JOINTS {
            assert!(same.rotations[joint].angle_between(answer.rotations[joint]) < 1e-3);
        }
    }
}
