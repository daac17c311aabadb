//! A motion on its way to a file: frames, and where they come from.

use std::io::{self, BufRead};

use glam::{Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joints, Skeleton, skeleton::PARENTS};
use posed_signal::HostTime;
use serde::Deserialize;

use crate::published::PublishedPose;

/// One pose of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The time that it is valid for.
    pub at: HostTime,
    /// Root and local rotations.
    pub pose: BodyPose,
    /// The bones that it was made with.
    pub skeleton: Skeleton,
}

impl From<&PublishedPose> for Frame {
    fn from(published: &PublishedPose) -> Self {
        Self {
            at: published.target_at,
            pose: published.pose,
            skeleton: skeleton_of(&published.joints),
        }
    }
}

/// The bone offsets that `joints` were made with.
#[must_use]
pub fn skeleton_of(joints: &Joints) -> Skeleton {
    let mut offsets = [Vec3::ZERO; JOINTS];
    for (index, parent) in PARENTS.into_iter().enumerate() {
        if let Some(parent) = parent {
            let between = joints.positions[index] - joints.positions[parent];
            offsets[index] = joints.rotations[parent].inverse() * between;
        }
    }
    Skeleton { offsets }
}

/// What is wrong with a file of poses.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// It cannot be read.
    #[error("cannot be read after line {after}: {source}")]
    Read {
        /// Lines read before.
        after: u64,
        /// Why.
        source: io::Error,
    },
    /// A line is no pose.
    #[error("line {line} is no pose as `--poses` writes it: {what}")]
    Line {
        /// Its number, from 1.
        line: u64,
        /// What is wrong with it.
        what: String,
    },
}

/// A line of `--poses`, as far as a motion needs it.
#[derive(Deserialize)]
struct Line {
    target_ns: u64,
    root: [f32; 3],
    joints: [[f32; 3]; JOINTS],
    rotations: [[f32; 4]; JOINTS],
}

impl Line {
    fn frame(&self) -> Option<Frame> {
        let pose = BodyPose {
            root: Vec3::from_array(self.root),
            rotations: self.rotations.map(Quat::from_array),
        };
        let positions = self.joints.map(Vec3::from_array);
        if !pose.is_sound() || !positions.iter().all(|position| position.is_finite()) {
            return None;
        }
        // Whatever the bones, the joints' rotations follow from the local ones.
        let nobody = Skeleton {
            offsets: [Vec3::ZERO; JOINTS],
        };
        let rotations = nobody.forward(&pose).rotations;
        Some(Frame {
            at: HostTime(self.target_ns),
            pose,
            skeleton: skeleton_of(&Joints {
                positions,
                rotations,
            }),
        })
    }
}

/// Reads what `--poses` wrote, line by line. A last line that breaks off, as a killed process
/// leaves it, is the end and no error.
#[derive(Debug)]
pub struct PoseLines<R> {
    input: R,
    line: String,
    number: u64,
}

impl<R: BufRead> PoseLines<R> {
    /// Reads from `input`.
    pub fn new(input: R) -> Self {
        Self {
            input,
            line: String::new(),
            number: 0,
        }
    }

    fn read(&mut self) -> Result<Option<Frame>, PosesError> {
        loop {
            self.line.clear();
            let read = self.input.read_line(&mut self.line);
            let after = self.number;
            if read.map_err(|source| PosesError::Read { after, source })? == 0 {
                return Ok(None);
            }
            self.number += 1;
            if !self.line.trim().is_empty() {
                return self.parse();
            }
        }
    }

    fn parse(&self) -> Result<Option<Frame>, PosesError> {
        let fail = |what| PosesError::Line {
            line: self.number,
            what,
        };
        match serde_json::from_str::<Line>(&self.line) {
            Ok(line) => {
                let frame = line.frame();
                let what = "a number is not finite or a rotation not unit";
                frame.map(Some).ok_or_else(|| fail(what.into()))
            }
            Err(error) if error.is_eof() && !self.line.ends_with('\n') => Ok(None),
            Err(error) => Err(fail(error.to_string())),
        }
    }
}

impl<R: BufRead> Iterator for PoseLines<R> {
    type Item = Result<Frame, PosesError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

/// `fraction` of the way from one pose to another, each joint by the shorter way.
#[must_use]
pub fn between(from: &BodyPose, to: &BodyPose, fraction: f32) -> BodyPose {
    let mut pose = *to;
    pose.root = from.root.lerp(to.root, fraction);
    for (rotation, from) in pose.rotations.iter_mut().zip(&from.rotations) {
        *rotation = from.slerp(*rotation, fraction).normalize();
    }
    pose
}

#[cfg(test)]
pub(super) mod tests {
    use posed_signal::time::SECOND_NS;

    use super::*;
    use crate::published::tests::pose_at;

    /// A wearer who turns and bends a little more with every frame, at 90 Hz.
    pub(in crate::output) fn frames(count: u64) -> Vec<Frame> {
        let frame = |index: u64| {
            let at = HostTime(7 * SECOND_NS + index * SECOND_NS / 90);
            let mut pose = pose_at(1, at).pose;
            pose.root = Vec3::new(0.01 * index as f32, 0.9, -0.02 * index as f32);
            for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                let axis = Vec3::new(1.0, 0.3 * joint as f32 - 2.0, 0.5).normalize();
                let angle = 0.004 * index as f32 * (1.0 + 0.2 * joint as f32);
                *rotation = Quat::from_axis_angle(axis, angle);
            }
            Frame {
                at,
                pose,
                skeleton: Skeleton::of_height(1.75),
            }
        };
        (0..count).map(frame).collect()
    }

    fn lines(count: u64) -> String {
        let line = |index| serde_json::to_string(&pose_at(index, HostTime(index * 1000))).unwrap();
        (1..=count).map(|index| line(index) + "\n").collect()
    }

    #[test]
    fn what_was_written_is_read() {
        let text = lines(3);
        let read: Vec<_> = PoseLines::new(text.as_bytes())
            .collect::<Result<_, _>>()
            .unwrap();
        assert_eq!(read.len(), 3);
        for (index, frame) in (1..).zip(&read) {
            let published = pose_at(index, HostTime(index * 1000));
            assert_eq!(
                (frame.at, frame.pose),
                (published.target_at, published.pose)
            );
            let joints = frame.skeleton.forward(&frame.pose);
            for (read, written) in joints.positions.iter().zip(&published.joints.positions) {
                assert!((*read - *written).length() < 1e-5);
            }
            let from_pose = Frame::from(&published);
            assert!(
                from_pose
                    .skeleton
                    .offsets
                    .iter()
                    .zip(&frame.skeleton.offsets)
                    .all(|(a, b)| a.distance(*b) < 1e-6)
            );
        }
    }

    #[test]
    fn a_torn_end_is_an_end_and_a_torn_middle_an_error() {
        let text = lines(3);
        for cut in [1, 40, 300] {
            let read: Vec<_> = PoseLines::new(&text.as_bytes()[..text.len() - 1 - cut]).collect();
            assert_eq!(read.len(), 2, "cut by {cut}");
            assert!(read.iter().all(Result::is_ok));
        }
        let broken = text.replacen("\"root\"", "\"boot\"", 1);
        let first = PoseLines::new(broken.as_bytes())
            .next()
            .unwrap()
            .unwrap_err()
            .to_string();
        assert!(
            first.contains("line 1") && first.contains("root"),
            "{first}"
        );
        let huge = text.replacen("\"root\":[", "\"root\":[1e39,", 1);
        assert!(PoseLines::new(huge.as_bytes()).next().unwrap().is_err());
        let mut line: serde_json::Value =
            serde_json::from_str(text.lines().next().unwrap()).unwrap();
        line["rotations"][3] = serde_json::json!([0.0, 0.0, 0.0, 0.0]);
        let unsound = line.to_string();
        let error = PoseLines::new(unsound.as_bytes())
            .next()
            .unwrap()
            .unwrap_err();
        assert!(error.to_string().contains("not unit"), "{error}");
        assert!(PoseLines::new(&b""[..]).next().is_none());
    }

    #[test]
    fn between_two_poses_lies_the_middle() {
        let frames = frames(40);
        let (from, to) = (&frames[0].pose, &frames[39].pose);
        let middle = between(from, to, 0.5);
        for joint in 0..JOINTS {
            let (a, b) = (from.rotations[joint], to.rotations[joint]);
            let halves = [
                a.angle_between(middle.rotations[joint]),
                middle.rotations[joint].angle_between(b),
            ];
            assert!((halves[0] - halves[1]).abs() < 2e-3, "{halves:?}");
        }
        assert_eq!(between(from, to, 1.0).root, to.root);
    }
}
