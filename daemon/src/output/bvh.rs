//! Biovision hierarchy (BVH): text that every animation program reads.
//!
//! The skeleton's T-pose is the rest pose; positions and axes are posed's own (right-handed, Y up,
//! forward -Z). A joint's channels are degrees about Z, X and Y in this order, which by BVH's rule
//! means the matrix Rz Rx Ry, from the joint to its parent.

use std::{
    fmt::Write as _,
    fs::File,
    io::{self, Seek, SeekFrom, Write},
    path::Path,
};

use glam::{EulerRot, Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Skeleton, skeleton::PARENTS};
use posed_signal::{HostTime, time::SECOND_NS};

use super::{
    motion::{Frame, between},
    names::Names,
};

/// Digits kept free for the number of frames, which is known only at the end.
const COUNT_WIDTH: usize = 10;
/// A longer break in the poses is cut out, ns.
const BREAK_NS: i64 = 2 * SECOND_NS as i64;
/// A frame this near a pose is that pose: capture times are rounded to nanoseconds.
const SAME_NS: i64 = 1_000;

/// Length of a hand and of the toes over the stature, for bones that end where no joint is
/// (Winter, Biomechanics and Motor Control of Human Movement, table 4.1 and figure 4.1).
const HAND_OVER_STATURE: f32 = 0.108;
const TOES_OVER_STATURE: f32 = 0.03;

/// The unit of lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unit {
    /// As most animation programs expect of BVH.
    #[default]
    Centimetres,
    /// As posed measures.
    Metres,
}

impl Unit {
    fn per_metre(self) -> f32 {
        match self {
            Self::Centimetres => 100.0,
            Self::Metres => 1.0,
        }
    }
}

/// How to write.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// What the joints are called.
    pub names: Names,
    /// The unit of offsets and positions.
    pub unit: Unit,
    /// Frames a second: BVH has no times of its own, so that poses between frames are interpolated.
    pub rate_hz: f64,
}

/// A BVH file that grows. The number of frames in its header is brought up to date every second, so
/// that the file can be read at any time, and after the process was killed.
#[derive(Debug)]
pub struct Bvh<W> {
    output: W,
    options: Options,
    /// Joints in the order of the hierarchy, and so of the channels.
    order: Vec<Joint>,
    count_at: u64,
    waiting: String,
    waiting_frames: u64,
    frames: u64,
    angles: [Vec3; JOINTS],
    origin: HostTime,
    /// Index of the next frame, counted from `origin`.
    next: u64,
    last: Option<Frame>,
}

impl Bvh<File> {
    /// Creates or replaces `path`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, skeleton: &Skeleton, options: Options) -> io::Result<Self> {
        Self::new(File::create(path)?, skeleton, options)
    }
}

impl<W: Write + Seek> Bvh<W> {
    /// Writes the hierarchy of `skeleton`.
    ///
    /// # Errors
    /// `output` cannot be written to.
    pub fn new(mut output: W, skeleton: &Skeleton, options: Options) -> io::Result<Self> {
        let mut hierarchy = Hierarchy {
            text: "HIERARCHY\n".into(),
            order: Vec::with_capacity(JOINTS),
            skeleton,
            options,
        };
        hierarchy.joint(Joint::Pelvis, 0);
        let Hierarchy {
            mut text, order, ..
        } = hierarchy;
        text.push_str("MOTION\nFrames: ");
        let count_at = text.len() as u64;
        let seconds = 1.0 / options.rate_hz;
        let _ = write!(text, "{:>COUNT_WIDTH$}\nFrame Time: {seconds:.9}\n", 0);
        output.write_all(text.as_bytes())?;
        Ok(Self {
            output,
            options,
            order,
            count_at,
            waiting: String::new(),
            waiting_frames: 0,
            frames: 0,
            angles: [Vec3::ZERO; JOINTS],
            origin: HostTime(0),
            next: 0,
            last: None,
        })
    }

    /// Takes the next pose, and writes the frames up to it. Poses that are not newer than the ones
    /// before are left out; a break of more than two seconds is cut out.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        let gap = self
            .last
            .map_or(i64::MAX, |last| frame.at.since_ns(last.at));
        if gap <= 0 && gap > -BREAK_NS {
            return Ok(());
        }
        let last = self.last.replace(*frame);
        let Some(last) = last.filter(|_| (0..BREAK_NS).contains(&gap)) else {
            self.origin = frame.at;
            self.next = 1;
            return self.write(&frame.pose);
        };
        loop {
            let due = self.due();
            let ahead = frame.at.since_ns(due);
            if ahead < -SAME_NS {
                return Ok(());
            }
            self.next += 1;
            if ahead <= SAME_NS {
                return self.write(&frame.pose);
            }
            let fraction = due.since_ns(last.at) as f32 / gap as f32;
            self.write(&between(&last.pose, &frame.pose, fraction.clamp(0.0, 1.0)))?;
        }
    }

    /// Writes what is waiting, and says how many frames there are.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> io::Result<u64> {
        self.flush()?;
        self.output.flush()?;
        Ok(self.frames)
    }

    /// The time of the next frame; from the index, so that rounding does not add up.
    fn due(&self) -> HostTime {
        self.origin
            .plus_secs(self.next as f64 / self.options.rate_hz)
    }

    fn write(&mut self, pose: &BodyPose) -> io::Result<()> {
        let root = pose.root * self.options.unit.per_metre();
        // Writing to a string cannot fail.
        let _ = write!(self.waiting, "{:.5} {:.5} {:.5}", root.x, root.y, root.z);
        for joint in &self.order {
            let last = &mut self.angles[*joint as usize];
            *last = nearest_angles(pose.rotations[*joint as usize], *last);
            let _ = write!(self.waiting, " {:.5} {:.5} {:.5}", last.x, last.y, last.z);
        }
        self.waiting.push('\n');
        self.waiting_frames += 1;
        if self.waiting_frames as f64 >= self.options.rate_hz {
            self.flush()?;
        }
        Ok(())
    }

    /// Whole lines first, their number after them: whoever reads in between finds more lines than
    /// frames, never fewer.
    fn flush(&mut self) -> io::Result<()> {
        if self.waiting_frames == 0 {
            return Ok(());
        }
        self.output.write_all(self.waiting.as_bytes())?;
        self.frames += self.waiting_frames;
        self.waiting.clear();
        self.waiting_frames = 0;
        self.output.seek(SeekFrom::Start(self.count_at))?;
        write!(self.output, "{:>COUNT_WIDTH$}", self.frames)?;
        self.output.seek(SeekFrom::End(0))?;
        Ok(())
    }
}

/// Builds the first half of the file.
struct Hierarchy<'a> {
    text: String,
    order: Vec<Joint>,
    skeleton: &'a Skeleton,
    options: Options,
}

impl Hierarchy<'_> {
    fn joint(&mut self, joint: Joint, depth: usize) {
        self.order.push(joint);
        let keyword = if joint.parent().is_none() {
            "ROOT"
        } else {
            "JOINT"
        };
        let name = self.options.names.of(joint);
        self.line(depth, &format!("{keyword} {name}"));
        self.line(depth, "{");
        self.offset(depth + 1, self.skeleton.offsets[joint as usize]);
        let channels = match joint.parent() {
            None => "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
            Some(_) => "3 Zrotation Xrotation Yrotation",
        };
        self.line(depth + 1, &format!("CHANNELS {channels}"));
        let children = Joint::ALL
            .into_iter()
            .filter(|child| child.parent() == Some(joint));
        for child in children {
            self.joint(child, depth + 1);
        }
        if let Some(end) = end_of(joint, self.skeleton) {
            self.line(depth + 1, "End Site");
            self.line(depth + 1, "{");
            self.offset(depth + 2, end);
            self.line(depth + 1, "}");
        }
        self.line(depth, "}");
    }

    fn offset(&mut self, depth: usize, offset: Vec3) {
        let Vec3 { x, y, z } = offset * self.options.unit.per_metre();
        self.line(depth, &format!("OFFSET {x:.6} {y:.6} {z:.6}"));
    }

    fn line(&mut self, depth: usize, text: &str) {
        let _ = writeln!(self.text, "{:1$}{text}", "", 2 * depth);
    }
}

/// Where the bone of a joint without children ends, in the joint's frame, metres.
pub(super) fn end_of(joint: Joint, skeleton: &Skeleton) -> Option<Vec3> {
    if PARENTS.contains(&Some(joint as usize)) {
        return None;
    }
    let stature = skeleton.stature();
    Some(match joint {
        Joint::LeftWrist => Vec3::NEG_X * HAND_OVER_STATURE * stature,
        Joint::RightWrist => Vec3::X * HAND_OVER_STATURE * stature,
        Joint::LeftFoot | Joint::RightFoot => Vec3::NEG_Z * TOES_OVER_STATURE * stature,
        _ => Vec3::Y * (stature - skeleton.head_height()),
    })
}

/// Degrees about Z, X and Y, chosen among all that mean `rotation` so that they follow `last`
/// without a jump: programs interpolate each curve by itself.
fn nearest_angles(rotation: Quat, last: Vec3) -> Vec3 {
    // In 64 bits: near 90° about X the angles lose half of their digits.
    let (z, x, y) = rotation.as_dquat().normalize().to_euler(EulerRot::ZXY);
    let angles = [z, x, y].map(|angle| angle.to_degrees() as f32);
    let first = Vec3::from_array(angles);
    let second = Vec3::new(first.x + 180.0, 180.0 - first.y, first.z + 180.0);
    let unwrap = |angles: Vec3| angles - ((angles - last) / 360.0).round() * 360.0;
    let (first, second) = (unwrap(first), unwrap(second));
    if (first - last).length_squared() <= (second - last).length_squared() {
        first
    } else {
        second
    }
}

#[cfg(test)]
mod tests;
