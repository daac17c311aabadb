//! Writes recorded motion mapped to the physics character, for training QuestSim.
//!
//! `cargo run --release -p posed-body --example references -- OUT.npz SPLIT [own,1.55,...] SET.npz...`
//! The list has the statures (metres) that clips are scaled to, one after the other; all are their movers'
//! own where it is left out.
//! Arrays of OUT, at 36 frames a second, clips one after the other: `start` (clips + 1), `name`,
//! `set`, `character` (index into `mjcf`), `stature` for each clip; for each frame `root` (3),
//! `rotation` (4, x y z w), `angles` (33), `parts` (3, 7): head, left and right wrist as the
//! devices see them, position and rotation. `mjcf` holds the document of each mover's character
//! on flat ground. `references --mjcf STATURE` prints that of an average person.

use std::{fs::File, io, path::Path};

use npyz::{WriterBuilder as _, npz::NpzWriter};
use posed_body::Joint;
use posed_body::character::Character;
use posed_body::motion::{Clip, MotionSet};
use posed_body::retarget::Retarget;
use posed_body::scene::Scene;
use posed_body::simulation::document;

/// Policy steps a second.
const RATE: f64 = 36.0;
/// Clips shorter than this many frames teach nothing.
const FRAMES_MIN: usize = 36;

type Failure = Box<dyn std::error::Error>;

#[derive(Default)]
struct Out {
    start: Vec<i32>,
    name: Vec<String>,
    set: Vec<String>,
    character: Vec<i32>,
    stature: Vec<f32>,
    mjcf: Vec<String>,
    root: Vec<f32>,
    rotation: Vec<f32>,
    angles: Vec<f32>,
    parts: Vec<f32>,
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, stature] = arguments.as_slice()
        && flag == "--mjcf"
    {
        let character = Character::of_height(stature.parse()?)?;
        print!("{}", document(&character, &Scene::default()));
        return Ok(());
    }
    let [out_path, split, rest @ ..] = arguments.as_slice() else {
        return Err("usage: references OUT.npz SPLIT [own,STATURE,...] SET.npz...".into());
    };
    let (statures, sets) = match rest {
        [list, sets @ ..] if list.starts_with("own") => (statures(list)?, sets),
        sets => (vec![None], sets),
    };
    let mut turn = statures.iter().cycle();
    let mut out = Out::default();
    out.start.push(0);
    for path in sets {
        let set = MotionSet::read(File::open(path)?)?;
        let label = Path::new(path)
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy();
        for index in 0..set.entries().len() {
            if set.entries()[index].split == *split {
                let clip = set.clip(index)?.resampled(RATE);
                let clip = match turn.next().copied().flatten() {
                    Some(stature) => clip.of_stature(stature),
                    None => clip,
                };
                out.add(&label, &clip)?;
            }
        }
    }
    out.write(Path::new(out_path))?;
    let frames = out.start.last().copied().unwrap_or(0);
    println!(
        "{} clips, {:.1} minutes, {} characters",
        out.name.len(),
        f64::from(frames) / RATE / 60.0,
        out.mjcf.len()
    );
    Ok(())
}

/// `own,1.55,1.95`: `None` is the mover's own.
fn statures(list: &str) -> Result<Vec<Option<f32>>, Failure> {
    let one = |item: &str| match item {
        "own" => Ok(None),
        number => number
            .parse()
            .map(Some)
            .map_err(|_| format!("{number:?} in {list:?} is no stature in metres").into()),
    };
    list.split(',').map(one).collect()
}

impl Out {
    fn add(&mut self, set: &str, clip: &Clip) -> Result<(), Failure> {
        if clip.frames.len() < FRAMES_MIN {
            return Ok(());
        }
        let character = Character::new(&clip.skeleton, None)?;
        let text = document(&character, &Scene::default());
        let known = self.mjcf.iter().position(|other| *other == text);
        let index = known.unwrap_or_else(|| {
            self.mjcf.push(text);
            self.mjcf.len() - 1
        });
        self.character.push(index as i32);
        self.stature.push(character.stature as f32);
        self.name.push(clip.name.clone());
        self.set.push(set.to_owned());
        let mut retarget = Retarget::new(character);
        for pose in &clip.frames {
            let fitted = retarget.fit(pose);
            self.root.extend(fitted.root.as_vec3().to_array());
            self.rotation.extend(fitted.rotation.as_quat().to_array());
            self.angles.extend(fitted.angles.map(|angle| angle as f32));
            let joints = clip.skeleton.forward(pose);
            for joint in [Joint::Head, Joint::LeftWrist, Joint::RightWrist] {
                self.parts.extend(joints.position(joint).to_array());
                self.parts.extend(joints.rotation(joint).to_array());
            }
        }
        let frames = clip.frames.len() as i32;
        self.start
            .push(self.start.last().copied().unwrap_or(0) + frames);
        Ok(())
    }

    fn write(&self, path: &Path) -> io::Result<()> {
        let mut archive = NpzWriter::create(path)?;
        let frames = self.root.len() as u64 / 3;
        numbers(
            &mut archive,
            "start",
            &[self.start.len() as u64],
            &self.start,
        )?;
        numbers(
            &mut archive,
            "character",
            &[self.name.len() as u64],
            &self.character,
        )?;
        numbers(
            &mut archive,
            "stature",
            &[self.name.len() as u64],
            &self.stature,
        )?;
        numbers(&mut archive, "root", &[frames, 3], &self.root)?;
        numbers(&mut archive, "rotation", &[frames, 4], &self.rotation)?;
        numbers(&mut archive, "angles", &[frames, 33], &self.angles)?;
        numbers(&mut archive, "parts", &[frames, 3, 7], &self.parts)?;
        texts(&mut archive, "name", &self.name)?;
        texts(&mut archive, "set", &self.set)?;
        texts(&mut archive, "mjcf", &self.mjcf)
    }
}

type Archive = NpzWriter<io::BufWriter<File>>;

fn numbers<T: npyz::AutoSerialize + Copy>(
    archive: &mut Archive,
    name: &str,
    shape: &[u64],
    values: &[T],
) -> io::Result<()> {
    let mut writer = archive
        .array(name, npyz::zip::write::FileOptions::default())?
        .default_dtype()
        .shape(shape)
        .begin_nd()?;
    writer.extend(values.iter().copied())?;
    writer.finish()
}

/// Texts as rows of bytes, padded with zeros: (texts, longest).
fn texts(archive: &mut Archive, name: &str, values: &[String]) -> io::Result<()> {
    let width = values.iter().map(String::len).max().unwrap_or(1).max(1);
    let padded = values.iter().flat_map(|text| {
        let pad = std::iter::repeat_n(0, width - text.len());
        text.bytes().chain(pad)
    });
    let bytes: Vec<u8> = padded.collect();
    numbers(archive, name, &[values.len() as u64, width as u64], &bytes)
}
