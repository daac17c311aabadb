//! Motion-capture sets: many clips on the 22-joint skeleton in one `.npz` file.
//!
//! Per joint and quaternion component the file holds 16-bit integers (times 32767), delta-coded
//! in time within a clip and split into two arrays of bytes: `dquat_lo` and `dquat_hi`, 88 rows,
//! one column a frame. `root` holds the pelvis in metres, three rows; `start` where the clips
//! begin, and the end. Its rest pose faces +Z with the left at +X: everything is turned by half a
//! turn about Y here.

use std::io::{self, BufReader, Read, Seek};

use glam::{Quat, Vec3};
use npyz::{Deserialize, NpyFile, Order};
use zip::ZipArchive;
use zip::result::ZipError;

use super::Clip;
use crate::skeleton::{BodyPose, JOINTS, NAMES, PARENTS, Skeleton};

/// More frames than this are refused: three hours at 60 a second, about twice the largest set.
const FRAMES_MAX: usize = 1_000_000;
/// More clips than this are refused.
const CLIPS_MAX: usize = 100_000;
/// Longer texts than this are refused.
const ITEM_BYTES_MAX: usize = 4096;
/// Rows of `dquat_lo` and `dquat_hi`.
const ROWS: usize = JOINTS * 4;

/// Why a motion set cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum MotionError {
    /// It is no `.npz` archive.
    #[error("motion set: not a readable .npz file: {0}")]
    Archive(#[from] ZipError),
    /// An array is missing or unreadable.
    #[error("motion set: array `{name}`: {cause}")]
    Array {
        /// Which one.
        name: &'static str,
        /// What is wrong with it.
        cause: io::Error,
    },
    /// The arrays do not fit together, or not the skeleton.
    #[error("motion set: array `{name}` {what}")]
    Content {
        /// Which one.
        name: &'static str,
        /// What is wrong with it.
        what: &'static str,
    },
    /// There is no such clip.
    #[error("motion set: there is no clip {0}")]
    NoSuchClip(String),
}

/// What a set says about a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// Who moves.
    pub subject: String,
    /// `train`, `val`, `test`, `cross` or `ood`.
    pub split: String,
    /// Number of frames.
    pub frames: usize,
    /// Height of the head joint above the lowest toe joint in the rest pose, metres.
    pub head_height: f32,
    first: usize,
}

/// A motion-capture set.
#[derive(Debug, Clone)]
pub struct MotionSet {
    fps: f64,
    entries: Vec<Entry>,
    offsets: Vec<f32>,
    low: Vec<u8>,
    high: Vec<u8>,
    root: Vec<f32>,
    frames: usize,
}

impl MotionSet {
    /// Reads a set.
    ///
    /// # Errors
    /// The file is no `.npz` archive, an array is missing, of the wrong type or shape or too
    /// large, or the arrays do not fit together.
    pub fn read(reader: impl Read + Seek) -> Result<Self, MotionError> {
        let mut arrays = Arrays(ZipArchive::new(reader)?);
        let start = arrays.take::<i32>("start", &[None], CLIPS_MAX + 1)?;
        let clips = start.len().saturating_sub(1);
        let frames = frames(&start)?;
        let fps = arrays.take::<i64>("fps", &[], 1)?;
        let fps = fps.first().map_or(0.0, |&fps| fps as f64);
        if !(1.0..=1000.0).contains(&fps) {
            return Err(content("fps", "is not between 1 and 1000"));
        }
        arrays.check_skeleton()?;
        let mut texts = |name| arrays.take::<String>(name, &[Some(clips)], clips);
        let (names, subjects, splits) = (texts("names")?, texts("subject")?, texts("split")?);
        let heights = arrays.take::<f32>("head_height", &[Some(clips)], clips)?;
        let shape = [Some(clips), Some(JOINTS), Some(3)];
        let offsets = arrays.take::<f32>("offsets", &shape, clips * JOINTS * 3)?;
        let rows = |rows| [Some(rows), Some(frames)];
        let root = arrays.take::<f32>("root", &rows(3), 3 * frames)?;
        if !root.iter().chain(&offsets).all(|number| number.is_finite()) {
            return Err(content(
                "root",
                "or `offsets` holds a number that is not finite",
            ));
        }
        let entries = (0..clips).map(|clip| Entry {
            name: names[clip].clone(),
            subject: subjects[clip].clone(),
            split: splits[clip].clone(),
            frames: (start[clip + 1] - start[clip]) as usize,
            head_height: heights[clip],
            first: start[clip] as usize,
        });
        Ok(Self {
            fps,
            entries: entries.collect(),
            offsets,
            low: arrays.take::<u8>("dquat_lo", &rows(ROWS), ROWS * frames)?,
            high: arrays.take::<u8>("dquat_hi", &rows(ROWS), ROWS * frames)?,
            root,
            frames,
        })
    }

    /// Frames a second of every clip.
    #[must_use]
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// What there is.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The clip of this name, at the set's own rate.
    ///
    /// # Errors
    /// There is none of this name, or it is damaged.
    pub fn named(&self, name: &str) -> Result<Clip, MotionError> {
        let position = self.entries.iter().position(|entry| entry.name == name);
        self.clip(position.ok_or_else(|| MotionError::NoSuchClip(format!("`{name}`")))?)
    }

    /// The clip at this place of [`MotionSet::entries`], at the set's own rate.
    ///
    /// # Errors
    /// There is none, or it is damaged.
    pub fn clip(&self, index: usize) -> Result<Clip, MotionError> {
        let entry = self.entries.get(index);
        let entry = entry.ok_or_else(|| MotionError::NoSuchClip(format!("number {index}")))?;
        let mut skeleton = Skeleton {
            offsets: [Vec3::ZERO; JOINTS],
        };
        let bones = self.offsets[index * JOINTS * 3..][..JOINTS * 3].chunks_exact(3);
        for (offset, bone) in skeleton.offsets.iter_mut().zip(bones) {
            *offset = turned(Vec3::from_slice(bone));
        }
        skeleton.offsets[0] = Vec3::ZERO;
        let at = |axis: usize, frame: usize| self.root[axis * self.frames + frame];
        let span = entry.first..entry.first + entry.frames;
        let mut frames: Vec<BodyPose> = span
            .map(|frame| {
                BodyPose::rest(turned(Vec3::new(at(0, frame), at(1, frame), at(2, frame))))
            })
            .collect();
        for joint in 0..JOINTS {
            self.decode(entry, joint, &mut frames)?;
        }
        Ok(Clip {
            name: entry.name.clone(),
            subject: entry.subject.clone(),
            split: entry.split.clone(),
            fps: self.fps,
            skeleton,
            frames,
        })
    }

    /// Undoes the delta coding of one joint's rotations.
    fn decode(
        &self,
        entry: &Entry,
        joint: usize,
        frames: &mut [BodyPose],
    ) -> Result<(), MotionError> {
        let mut sum = [0i16; 4];
        for (index, pose) in frames.iter_mut().enumerate() {
            for (component, sum) in sum.iter_mut().enumerate() {
                let place = (joint * 4 + component) * self.frames + entry.first + index;
                let delta = i16::from_le_bytes([self.low[place], self.high[place]]);
                *sum = sum.wrapping_add(delta);
            }
            let [x, y, z, w] = sum.map(f32::from);
            let rotation = Quat::from_xyzw(-x, y, -z, w);
            // A damaged clip drifts off; sound ones stay within rounding of 32767.
            if !(16_000.0..=50_000.0).contains(&rotation.length()) {
                return Err(content("dquat_lo", "does not add up to unit quaternions"));
            }
            pose.rotations[joint] = rotation.normalize();
        }
        Ok(())
    }
}

/// Half a turn about Y.
fn turned(v: Vec3) -> Vec3 {
    Vec3::new(-v.x, v.y, -v.z)
}

fn content(name: &'static str, what: &'static str) -> MotionError {
    MotionError::Content { name, what }
}

/// The number of frames that the clips' begins say.
fn frames(start: &[i32]) -> Result<usize, MotionError> {
    let grows = start.windows(2).all(|pair| pair[0] < pair[1]);
    let last = match start {
        [0, .., last] if grows => *last as usize,
        _ => return Err(content("start", "does not grow from zero")),
    };
    if last > FRAMES_MAX {
        return Err(content(
            "start",
            "says that there are more than a million frames",
        ));
    }
    Ok(last)
}

struct Arrays<R>(ZipArchive<R>);

impl<R: Read + Seek> Arrays<R> {
    /// An array of this shape, `None` standing for any length, in C order.
    fn take<T: Deserialize>(
        &mut self,
        name: &'static str,
        shape: &[Option<usize>],
        length_max: usize,
    ) -> Result<Vec<T>, MotionError> {
        let array = |cause| MotionError::Array { name, cause };
        let file = self
            .0
            .by_name(&format!("{name}.npy"))
            .map_err(|cause| match cause {
                ZipError::FileNotFound => content(name, "is missing"),
                cause => MotionError::Archive(cause),
            })?;
        // Numbers are read one by one: a buffer in between halves the time.
        let file = NpyFile::new(BufReader::with_capacity(1 << 16, file)).map_err(array)?;
        if file
            .dtype()
            .num_bytes()
            .is_none_or(|bytes| bytes > ITEM_BYTES_MAX)
        {
            return Err(content(name, "has items of a strange size"));
        }
        let found = file.shape().to_vec();
        let fits = found.len() == shape.len()
            && found
                .iter()
                .zip(shape)
                .all(|(&is, want)| want.is_none_or(|n| n as u64 == is));
        if !fits || (file.order() == Order::Fortran && found.len() > 1) {
            return Err(content(name, "has the wrong shape or is not in C order"));
        }
        // The header's word for it is checked before anything is allocated by it.
        if found
            .iter()
            .try_fold(1u64, |n, &m| n.checked_mul(m))
            .is_none_or(|n| n > length_max as u64)
        {
            return Err(content(name, "is too large"));
        }
        file.into_vec().map_err(array)
    }

    /// Checks that the joints are the skeleton's.
    fn check_skeleton(&mut self) -> Result<(), MotionError> {
        let names = self.take::<String>("joint_names", &[Some(JOINTS)], JOINTS)?;
        let parents = self.take::<i64>("parents", &[Some(JOINTS)], JOINTS)?;
        let expected = PARENTS.map(|parent| parent.map_or(-1, |index| index as i64));
        if names != NAMES || parents != expected {
            return Err(content(
                "joint_names",
                "or `parents` is not the 22-joint skeleton's",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use npyz::{AutoSerialize, WriterBuilder};
    use proptest::prelude::*;
    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::*;
    use crate::skeleton::Joint;

    /// Writes a set whose clips hold these rotations (x, y, z, w) on every joint.
    struct Made {
        zip: ZipWriter<Cursor<Vec<u8>>>,
        skip: &'static str,
    }

    impl Made {
        fn entry(&mut self, name: &str) -> bool {
            if name == self.skip {
                return false;
            }
            let options = SimpleFileOptions::default();
            self.zip.start_file(format!("{name}.npy"), options).unwrap();
            true
        }

        fn array<T: AutoSerialize>(&mut self, name: &str, shape: &[u64], values: Vec<T>) {
            if self.entry(name) {
                let mut bytes = Vec::new();
                let options = npyz::WriteOptions::new().default_dtype().shape(shape);
                let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
                writer.extend(values).unwrap();
                writer.finish().unwrap();
                self.zip.write_all(&bytes).unwrap();
            }
        }

        fn texts<S: AsRef<str>>(&mut self, name: &str, texts: &[S]) {
            if self.entry(name) {
                let mut bytes = Vec::new();
                let dtype = npyz::DType::Plain("<U16".parse().unwrap());
                let shape = [texts.len() as u64];
                let options = npyz::WriteOptions::new().dtype(dtype).shape(&shape);
                let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
                for text in texts {
                    writer.push(text.as_ref()).unwrap();
                }
                writer.finish().unwrap();
                self.zip.write_all(&bytes).unwrap();
            }
        }
    }

    fn archive(clips: &[Vec<[i16; 4]>], skip: &'static str) -> Vec<u8> {
        let mut made = Made {
            zip: ZipWriter::new(Cursor::new(Vec::new())),
            skip,
        };
        let count = clips.len() as u64;
        let frames: usize = clips.iter().map(Vec::len).sum();
        let mut start = vec![0i32];
        let mut columns = Vec::new();
        for clip in clips {
            start.push(start.last().unwrap() + clip.len() as i32);
            let mut last = [0i16; 4];
            for quat in clip {
                columns.push(std::array::from_fn::<i16, 4, _>(|i| {
                    quat[i].wrapping_sub(last[i])
                }));
                last = *quat;
            }
        }
        let byte = |which: usize| -> Vec<u8> {
            let row = |row: usize| columns.iter().map(move |c| c[row % 4].to_le_bytes()[which]);
            (0..ROWS).flat_map(row).collect()
        };
        made.array("start", &[count + 1], start);
        made.array("fps", &[], vec![30i64]);
        made.texts("joint_names", &NAMES);
        let parents = PARENTS.map(|parent| parent.map_or(-1, |i| i as i64));
        made.array("parents", &[22], parents.to_vec());
        for name in ["names", "subject", "split"] {
            let texts: Vec<_> = (0..count).map(|i| format!("{name}{i}")).collect();
            made.texts(name, &texts);
        }
        made.array("head_height", &[count], vec![1.4f32; clips.len()]);
        let offsets = (0..clips.len() * 66)
            .map(|i| (i % 66) as f32 / 100.0)
            .collect();
        made.array("offsets", &[count, 22, 3], offsets);
        let root = (0..3 * frames).map(|i| i as f32).collect();
        made.array("root", &[3, frames as u64], root);
        made.array("dquat_lo", &[88, frames as u64], byte(0));
        made.array("dquat_hi", &[88, frames as u64], byte(1));
        made.zip.finish().unwrap().into_inner()
    }

    /// Turns that take the 16-bit sums over their edge.
    fn spinning(frames: usize) -> Vec<[i16; 4]> {
        let quat = |i: usize| {
            let angle = 2.5 * i as f32;
            let (sin, cos) = (angle / 2.0).sin_cos();
            [0.0, sin, 0.0, cos].map(|x| (x * 32_767.0).round() as i16)
        };
        (0..frames).map(quat).collect()
    }

    #[test]
    fn clips_read_back_turned_to_posed_s_frame() {
        let bytes = archive(&[spinning(5), spinning(9)], "");
        let set = MotionSet::read(Cursor::new(bytes)).unwrap();
        assert_eq!((set.fps(), set.entries().len()), (30.0, 2));
        assert_eq!(set.entries()[1].frames, 9);
        let clip = set.named("names1").unwrap();
        assert_eq!(
            (clip.subject.as_str(), clip.split.as_str()),
            ("subject1", "split1")
        );
        for (index, frame) in clip.frames.iter().enumerate() {
            let expected = Quat::from_rotation_y(2.5 * index as f32);
            for rotation in frame.rotations {
                assert!(rotation.dot(expected).abs() > 1.0 - 1e-6);
            }
            let column = (5 + index) as f32;
            assert_eq!(
                frame.root,
                Vec3::new(-column, column + 14.0, -column - 28.0)
            );
        }
        assert_eq!(clip.skeleton.offsets[1], Vec3::new(-0.03, 0.04, -0.05));
        assert_eq!(clip.resampled(60.0).frames.len(), 17);
        assert!(matches!(
            set.named("nobody"),
            Err(MotionError::NoSuchClip(_))
        ));
    }

    #[test]
    fn what_is_missing_or_wrong_is_named() {
        for name in ["start", "root", "dquat_hi", "joint_names", "names", "fps"] {
            let error = MotionSet::read(Cursor::new(archive(&[spinning(4)], name))).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
        }
        assert!(matches!(
            MotionSet::read(Cursor::new(b"no archive".to_vec())),
            Err(MotionError::Archive(_))
        ));
        let damaged = archive(&[vec![[0, 0, 0, 3]; 4]], "");
        let set = MotionSet::read(Cursor::new(damaged)).unwrap();
        assert!(matches!(set.clip(0), Err(MotionError::Content { .. })));
    }

    #[test]
    fn a_real_set_reads() {
        let shared = std::env::var("POSED_SHARED")
            .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_owned());
        let path = std::path::Path::new(&shared).join("mocap/hdm05.npz");
        let Ok(file) = std::fs::File::open(&path) else {
            println!("SKIPPED (needs shared data): {}", path.display());
            return;
        };
        let set = MotionSet::read(file).unwrap();
        assert_eq!((set.fps(), set.entries().len()), (60.0, 127));
        let clip = set.clip(0).unwrap();
        assert!(clip.frames.iter().all(BodyPose::is_sound));
        assert!((clip.skeleton.head_height() - set.entries()[0].head_height).abs() < 1e-4);
        // Posed's rest pose looks along -Z with the left at -X.
        let offset = |joint: Joint| clip.skeleton.offsets[joint as usize];
        assert!(offset(Joint::LeftHip).x < 0.0 && offset(Joint::LeftFoot).z < 0.0);
        let joints = clip.skeleton.forward(&clip.frames[0]);
        assert!(joints.position(Joint::Head).y > joints.position(Joint::LeftFoot).y + 1.0);
    }

    proptest! {
        #[test]
        fn damaged_files_give_an_answer(
            cut in 0usize..9000, flips in prop::collection::vec((0usize..9000, any::<u8>()), 0..8),
        ) {
            let mut bytes = archive(&[spinning(6)], "");
            bytes.truncate(bytes.len().saturating_sub(cut % 4000));
            for (place, byte) in flips {
                if let Some(slot) = bytes.get_mut(place) {
                    *slot = byte;
                }
            }
            if let Ok(set) = MotionSet::read(Cursor::new(bytes)) {
                for index in 0..set.entries().len() {
                    let _ = set.clip(index);
                }
            }
        }
    }
}
