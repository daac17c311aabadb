use std::io::Cursor;

use glam::Mat4;
use proptest::prelude::*;

use super::*;
use crate::output::motion::tests::frames;

const METRES: Options = Options {
    names: Names::Smpl,
    unit: Unit::Metres,
    rate_hz: 90.0,
};

/// A BVH file as a program that knows nothing of posed understands it: words only.
struct Reader<'a> {
    words: std::iter::Peekable<std::str::SplitAsciiWhitespace<'a>>,
    joints: Vec<ReadJoint>,
}

struct ReadJoint {
    name: String,
    parent: Option<usize>,
    offset: Vec3,
    channels: Vec<String>,
}

struct Read {
    joints: Vec<ReadJoint>,
    frame_time: f64,
    frames: Vec<Vec<f32>>,
}

impl<'a> Reader<'a> {
    fn word(&mut self) -> &'a str {
        self.words.next().expect("a word")
    }

    fn expect(&mut self, word: &str) {
        assert_eq!(self.word(), word);
    }

    fn number<T: std::str::FromStr<Err: std::fmt::Debug>>(&mut self) -> T {
        self.word().parse().unwrap()
    }

    fn joint(&mut self, parent: Option<usize>) {
        let name = self.word().to_owned();
        self.expect("{");
        self.expect("OFFSET");
        let offset = Vec3::new(self.number(), self.number(), self.number());
        let is_end = name == "Site";
        let channels = if is_end {
            Vec::new()
        } else {
            self.expect("CHANNELS");
            let count: usize = self.number();
            (0..count).map(|_| self.word().to_owned()).collect()
        };
        self.joints.push(ReadJoint {
            name,
            parent,
            offset,
            channels,
        });
        let index = self.joints.len() - 1;
        loop {
            match self.word() {
                "}" => return,
                "JOINT" | "End" => self.joint(Some(index)),
                other => panic!("{other}"),
            }
        }
    }

    fn read(text: &'a str) -> Read {
        let words = text.split_ascii_whitespace().peekable();
        let mut reader = Self {
            words,
            joints: Vec::new(),
        };
        reader.expect("HIERARCHY");
        reader.expect("ROOT");
        reader.joint(None);
        reader.expect("MOTION");
        reader.expect("Frames:");
        let count: usize = reader.number();
        reader.expect("Frame");
        reader.expect("Time:");
        let frame_time = reader.number();
        let channels = reader.joints.iter().map(|joint| joint.channels.len()).sum();
        let frame = |_| {
            (0..channels)
                .map(|_| reader.words.next().unwrap().parse().unwrap())
                .collect()
        };
        let frames = (0..count).map(frame).collect();
        Read {
            joints: reader.joints,
            frame_time,
            frames,
        }
    }
}

impl Read {
    /// Positions in the world by name, by BVH's rule: the channels' matrices in their order.
    fn positions(&self, frame: usize) -> Vec<(String, Vec3)> {
        let mut numbers = self.frames[frame].iter().copied();
        let mut worlds: Vec<Mat4> = Vec::new();
        for joint in &self.joints {
            let mut local = Mat4::from_translation(joint.offset);
            for channel in &joint.channels {
                let number = numbers.next().unwrap();
                local *= match channel.as_str() {
                    "Xposition" => Mat4::from_translation(Vec3::X * number),
                    "Yposition" => Mat4::from_translation(Vec3::Y * number),
                    "Zposition" => Mat4::from_translation(Vec3::Z * number),
                    "Xrotation" => Mat4::from_rotation_x(number.to_radians()),
                    "Yrotation" => Mat4::from_rotation_y(number.to_radians()),
                    "Zrotation" => Mat4::from_rotation_z(number.to_radians()),
                    other => panic!("{other}"),
                };
            }
            let parent = joint.parent.map_or(Mat4::IDENTITY, |parent| worlds[parent]);
            worlds.push(parent * local);
        }
        let place = |world: &Mat4| world.transform_point3(Vec3::ZERO);
        self.joints
            .iter()
            .map(|joint| joint.name.clone())
            .zip(worlds.iter().map(place))
            .collect()
    }
}

fn written(frames: &[Frame], options: Options) -> String {
    let mut bytes = Cursor::new(Vec::new());
    let mut bvh = Bvh::new(&mut bytes, &frames[0].skeleton, options).unwrap();
    for frame in frames {
        bvh.frame(frame).unwrap();
    }
    bvh.finish().unwrap();
    String::from_utf8(bytes.into_inner()).unwrap()
}

fn assert_positions(read: &Read, index: usize, pose: &BodyPose, options: Options) {
    let expected = Skeleton::of_height(1.75).forward(pose);
    let positions = read.positions(index);
    for joint in Joint::ALL {
        let name = options.names.of(joint);
        let (_, place) = positions
            .iter()
            .find(|(found, _)| found == name)
            .expect(name);
        let error = *place / options.unit.per_metre() - expected.position(joint);
        assert!(error.length() < 1e-4, "frame {index}, {name}: {error}");
    }
}

#[test]
fn joints_are_where_they_were() {
    let frames = frames(50);
    let centimetres = Options {
        names: Names::Mixamo,
        unit: Unit::Centimetres,
        rate_hz: 90.0,
    };
    for options in [METRES, centimetres] {
        let text = written(&frames, options);
        let read = Reader::read(&text);
        assert_eq!(read.frames.len(), frames.len());
        assert!((read.frame_time - 1.0 / 90.0).abs() < 1e-8);
        assert_eq!(read.joints.len(), JOINTS + 5, "22 joints and 5 ends");
        for (index, frame) in frames.iter().enumerate() {
            assert_positions(&read, index, &frame.pose, options);
        }
    }
}

#[test]
fn the_ends_of_the_bones_are_those_of_a_person() {
    let frames = frames(1);
    let text = written(&frames, METRES);
    let positions = Reader::read(&text).positions(0);
    let ends: Vec<_> = positions
        .iter()
        .filter(|(name, _)| name == "Site")
        .collect();
    let crown = ends
        .iter()
        .map(|(_, place)| place.y)
        .fold(f32::MIN, f32::max);
    let toe = ends
        .iter()
        .map(|(_, place)| place.y)
        .fold(f32::MAX, f32::min);
    assert!((crown - toe - 1.75).abs() < 1e-3, "from {toe} to {crown}");
    let reach = ends
        .iter()
        .map(|(_, place)| place.x.abs())
        .fold(0.0, f32::max);
    assert!(
        (0.7..1.0).contains(&reach),
        "half the span of the arms is {reach}"
    );
}

#[test]
fn another_rate_interpolates() {
    let frames = frames(91);
    for rate_hz in [30.0, 60.0, 120.0] {
        let options = Options { rate_hz, ..METRES };
        let read_text = written(&frames, options);
        let read = Reader::read(&read_text);
        assert_eq!(
            read.frames.len(),
            rate_hz as usize + 1,
            "one second and its end"
        );
        for index in 0..read.frames.len() {
            let place = 90.0 * index as f32 / rate_hz as f32;
            let before = (place as usize).min(89);
            let pose = between(
                &frames[before].pose,
                &frames[before + 1].pose,
                place - before as f32,
            );
            assert_positions(&read, index, &pose, options);
        }
    }
}

#[test]
fn breaks_are_cut_out_and_repeats_left_out() {
    let mut all = frames(20);
    for frame in &mut all[10..] {
        frame.at = frame.at.plus_secs(100.0);
    }
    all.insert(5, all[4]);
    let text = written(&all, METRES);
    let read = Reader::read(&text);
    assert_eq!(read.frames.len(), 20);
    assert_positions(&read, 10, &all[11].pose, METRES);
    for frame in &mut all[11..] {
        frame.at = frame.at.plus_secs(-104.0);
    }
    assert_eq!(
        Reader::read(&written(&all, METRES)).frames.len(),
        20,
        "wound back"
    );
}

/// A file that is copied at every write, as a kill at that moment would leave it.
struct Killed<'a> {
    file: Cursor<Vec<u8>>,
    copies: &'a mut Vec<Vec<u8>>,
}

impl Write for Killed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.copies.push(self.file.get_ref().clone());
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Killed<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

#[test]
fn a_kill_at_any_write_leaves_a_file_that_can_be_read() {
    let mut copies = Vec::new();
    let file = Killed {
        file: Cursor::default(),
        copies: &mut copies,
    };
    let frames = frames(400);
    let mut bvh = Bvh::new(file, &frames[0].skeleton, METRES).unwrap();
    for frame in &frames {
        bvh.frame(frame).unwrap();
    }
    assert_eq!(bvh.finish().unwrap(), 400);
    let mut counts = Vec::new();
    for copy in &copies {
        let text = std::str::from_utf8(copy).unwrap();
        let read = Reader::read(text);
        for index in [0, read.frames.len().saturating_sub(1)] {
            if index < read.frames.len() {
                assert_positions(&read, index, &frames[index].pose, METRES);
            }
        }
        counts.push(read.frames.len());
    }
    assert!(counts.is_sorted() && counts.contains(&360), "{counts:?}");
    assert_eq!(counts.last(), Some(&400));
}

proptest! {
    #[test]
    fn angles_mean_the_rotation_and_follow_the_last_ones(
        x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, w in -1.0f32..1.0,
        last in prop::array::uniform3(-2000.0f32..2000.0),
    ) {
        let q = Quat::from_xyzw(x, y, z, w);
        prop_assume!(q.length() > 0.1);
        let q = q.normalize();
        let last = Vec3::from_array(last);
        let degrees = nearest_angles(q, last);
        let [z, x, y] = degrees.to_array().map(|degrees| f64::from(degrees).to_radians());
        let back = glam::DQuat::from_rotation_z(z)
            * glam::DQuat::from_rotation_x(x)
            * glam::DQuat::from_rotation_y(y);
        prop_assert!(q.as_dquat().dot(back).abs() > 1.0 - 1e-6);
        prop_assert!((degrees - last).abs().max_element() <= 270.5);
        // Asked again from where it is, it stays there.
        prop_assert!((nearest_angles(q, degrees) - degrees).length() < 0.1);
    }
}

#[test]
fn a_full_turn_makes_no_jump() {
    let mut last = Vec3::ZERO;
    for step in 0..=720 {
        let q = Quat::from_rotation_y((step as f32).to_radians());
        let next = nearest_angles(q, last);
        assert!((next - last).length() < 1.5, "at {step}°: {last} {next}");
        last = next;
    }
    assert!((last.z - 720.0).abs() < 0.01);
}

#[test]
fn a_full_disk_is_an_error() {
    let full = Path::new("/dev/full");
    if full.exists() {
        assert!(Bvh::create(full, &Skeleton::of_height(1.75), METRES).is_err());
    }
}
