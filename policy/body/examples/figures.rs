//! Measures the body on recorded motion: what the character's missing degrees of freedom cost,
//! what the optimiser does to true and to noisy motion, how its solver compares with Clarabel,
//! and how the simulated character takes random torques on every scene.
//!
//! `cargo run --release -p posed-body --example figures -- <folder of motion sets> <what>
//! [every nth clip] [split]`, where `<what>` is `retarget`, `clean`, `noise`, `qp` or `drop`; or
//! `figures <file> tracked`, with what `posed eval --dump` wrote: the optimiser on the poses of a
//! tracker.

#[path = "../tests/qp_oracle/mod.rs"]
mod qp_oracle;

use std::fmt;
use std::fs::File;
use std::path::Path;
use std::time::Instant;

use glam::{Quat, Vec3};
use npyz::npz::NpzArchive;
use posed_body::character::{Character, HINGES, average_mass};
use posed_body::motion::{Clip, MotionSet};
use posed_body::optimiser::{Optimiser, Outcome, Reference, Settings};
use posed_body::qp::{Solver, Status};
use posed_body::retarget::Retarget;
use posed_body::scene::{Ground, samples};
use posed_body::simulation::{Model, Step};
use posed_body::skeleton::PARENTS;
use posed_body::{BodyPose, JOINTS, Joint, Skeleton};
use qp_oracle::{Verdict, judge};

const SETS: [(&str, &str); 8] = [
    ("bandai", "test"),
    ("cmu_amc", "test"),
    ("cmu_amc2", "test"),
    ("cmu_bvh", "test"),
    ("cmu_cc", "test"),
    ("snu", "test"),
    ("fubot", "test"),
    ("hdm05", "cross"),
];

type Places = Vec<[Vec3; JOINTS]>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, what, ..] = arguments.as_slice() else {
        return Err(
            "usage: figures <folder of motion sets> <what> [every nth clip] [split]".into(),
        );
    };
    let every = arguments.get(2).map_or(Ok(1), |n| n.parse())?;
    match what.as_str() {
        "drop" => return drop_on_scenes(),
        "tracked" => {
            optimise(folder, &tracked(Path::new(folder), every)?);
            return Ok(());
        }
        _ => {}
    }
    let mut noise = Noise(1);
    for (set, split) in SETS {
        let split = arguments.get(3).map_or(split, String::as_str);
        let clips = clips(&Path::new(folder).join(format!("{set}.npz")), split, every)?;
        if clips.is_empty() {
            continue;
        }
        match what.as_str() {
            "retarget" => retarget(set, &clips),
            "clean" => optimise(set, &streams(&clips, BodyPose::clone)),
            "noise" => optimise(set, &streams(&clips, |pose| noise.disturb(pose))),
            "qp" => compare_solvers(set, &clips),
            _ => return Err(format!("there is nothing called {what}").into()),
        }
    }
    Ok(())
}

fn clips(path: &Path, split: &str, every: usize) -> Result<Vec<Clip>, Box<dyn std::error::Error>> {
    let set = MotionSet::read(File::open(path)?)?;
    let wanted = |index: &usize| set.entries()[*index].split == split;
    (0..set.entries().len())
        .filter(wanted)
        .step_by(every)
        .map(|index| Ok(set.clip(index)?.resampled(60.0)))
        .collect()
}

/// A running mean.
#[derive(Debug, Clone, Copy, Default)]
struct Mean(f64, usize);

impl Mean {
    fn add(&mut self, value: f64) {
        self.0 += value;
        self.1 += 1;
    }

    fn get(self) -> f64 {
        self.0 / self.1.max(1) as f64
    }
}

fn retarget(set: &str, clips: &[Clip]) {
    let mut joints = [Mean::default(); JOINTS];
    let mut turns = [Mean::default(); JOINTS];
    let mut all = Mean::default();
    let started = Instant::now();
    for clip in clips {
        let character = Character::new(&clip.skeleton, None).expect("a person's stature");
        let mut retarget = Retarget::new(character.clone());
        for pose in &clip.frames {
            let fitted = retarget.fit(pose);
            let there = character.joints(&character.forward(&fitted));
            let truth = clip.skeleton.forward(pose);
            for joint in 0..JOINTS {
                let apart = f64::from(there.positions[joint].distance(truth.positions[joint]));
                joints[joint].add(apart);
                all.add(apart);
                let turn = there.rotations[joint].angle_between(truth.rotations[joint]);
                turns[joint].add(f64::from(turn).to_degrees());
            }
        }
    }
    let frames = all.1 / JOINTS;
    let micros = started.elapsed().as_secs_f64() * 1e6 / frames as f64;
    println!(
        "{set}: MPJPE {:.2} cm, {frames} frames, {micros:.0} us a frame",
        100.0 * all.get()
    );
    for joint in Joint::ALL {
        let index = joint as usize;
        print!(
            "  {} {:.1} cm {:.0}°",
            joint.name(),
            100.0 * joints[index].get(),
            turns[index].get()
        );
    }
    println!();
}

/// Numbers of a normal distribution, the same for every run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn vector(&mut self, deviation: f32) -> Vec3 {
        let mut normal = || (0..12).map(|_| self.uniform()).sum::<f64>() as f32 - 6.0;
        Vec3::new(normal(), normal(), normal()) * deviation
    }

    /// 2 cm on the pelvis's position and 3° on every rotation, per axis.
    fn disturb(&mut self, pose: &BodyPose) -> BodyPose {
        let mut noisy = *pose;
        noisy.root += self.vector(0.02);
        for rotation in &mut noisy.rotations {
            let turn = Quat::from_scaled_axis(self.vector(3.0_f32.to_radians()));
            *rotation = (*rotation * turn).normalize();
        }
        noisy
    }
}

fn optimiser(skeleton: &Skeleton) -> Optimiser {
    let mass = average_mass(f64::from(skeleton.stature()));
    Optimiser::new(skeleton, mass, 1.0 / 60.0, Settings::default())
}

/// A true motion and what a tracker made of it.
struct Stream {
    skeleton: Skeleton,
    truth: Vec<BodyPose>,
    shown: Vec<BodyPose>,
    /// What it said of the feet.
    contacts: Vec<Option<[f32; 2]>>,
}

fn streams(clips: &[Clip], mut shown: impl FnMut(&BodyPose) -> BodyPose) -> Vec<Stream> {
    let stream = |clip: &Clip| Stream {
        skeleton: clip.skeleton,
        truth: clip.frames.clone(),
        shown: clip.frames.iter().map(&mut shown).collect(),
        contacts: vec![None; clip.frames.len()],
    };
    clips.iter().map(stream).collect()
}

/// Reads what `posed eval --dump` wrote.
fn tracked(path: &Path, every: usize) -> Result<Vec<Stream>, Box<dyn std::error::Error>> {
    let mut archive = NpzArchive::open(path)?;
    let suffix = "/true_joints";
    let mut names: Vec<String> = archive
        .array_names()
        .filter_map(|name| Some(name.strip_suffix(suffix)?.to_owned()))
        .collect();
    names.sort();
    let mut streams = Vec::new();
    for name in names.iter().step_by(every) {
        let mut numbers = |kind: &str| -> Result<Vec<f32>, Box<dyn std::error::Error>> {
            let array = archive.by_name(&format!("{name}/{kind}"))?;
            Ok(array.ok_or("an array is missing")?.into_vec()?)
        };
        let joints = numbers("true_joints")?;
        let truth = poses(&joints, &numbers("true_rotations")?);
        let shown = poses(
            &numbers("predicted_joints")?,
            &numbers("predicted_rotations")?,
        );
        let skeleton = skeleton_of(&joints[..3 * JOINTS], &truth[0]);
        let said = |feet: &[f32]| {
            let [left, right] = [feet[0], feet[1]];
            (!left.is_nan()).then_some([left, right])
        };
        let contacts = numbers("contacts")?.chunks(2).map(said).collect();
        streams.push(Stream {
            skeleton,
            truth,
            shown,
            contacts,
        });
    }
    Ok(streams)
}

/// Poses from all joints' positions and local rotations.
fn poses(joints: &[f32], rotations: &[f32]) -> Vec<BodyPose> {
    let frames = joints.chunks(3 * JOINTS).zip(rotations.chunks(4 * JOINTS));
    frames
        .map(|(joints, rotations)| BodyPose {
            root: Vec3::from_slice(joints),
            rotations: std::array::from_fn(|joint| {
                Quat::from_slice(&rotations[4 * joint..]).normalize()
            }),
        })
        .collect()
}

/// The bones of somebody whose joints are here in this pose.
fn skeleton_of(joints: &[f32], pose: &BodyPose) -> Skeleton {
    let mut skeleton = Skeleton::of_height(1.7);
    let turns = skeleton.forward(pose).rotations;
    let place = |joint: usize| Vec3::from_slice(&joints[3 * joint..]);
    for (joint, parent) in PARENTS.iter().enumerate() {
        if let Some(parent) = *parent {
            skeleton.offsets[joint] = turns[parent].inverse() * (place(joint) - place(parent));
        }
    }
    skeleton
}

fn optimise(set: &str, streams: &[Stream]) {
    let (mut error, mut given) = (Errors::default(), Errors::default());
    let (mut jitter, mut jitter_true, mut jitter_given) =
        (Mean::default(), Mean::default(), Mean::default());
    let (mut skate, mut skate_true, mut skate_given) =
        (Skate::default(), Skate::default(), Skate::default());
    let (mut deepest, mut times, mut not_full) = (0.0_f32, Vec::new(), 0);
    for stream in streams {
        let mut optimiser = optimiser(&stream.skeleton);
        let places = |pose: &BodyPose| stream.skeleton.forward(pose).positions;
        let truth: Places = stream.truth.iter().map(places).collect();
        let input: Places = stream.shown.iter().map(places).collect();
        let mut output = Places::new();
        for (pose, &contacts) in stream.shown.iter().zip(&stream.contacts) {
            let reference = Reference {
                pose,
                velocities: None,
                contacts,
            };
            let started = Instant::now();
            let solved = optimiser.step(&reference, &Ground::Flat);
            times.push(started.elapsed().as_secs_f64() * 1e3);
            not_full += usize::from(solved.outcome != Outcome::Full);
            output.push(places(&solved.pose));
        }
        error.add(&output, &truth);
        given.add(&input, &truth);
        add_jitter(&mut jitter, &output);
        add_jitter(&mut jitter_true, &truth);
        add_jitter(&mut jitter_given, &input);
        skate.add(&output, &truth);
        skate_true.add(&truth, &truth);
        skate_given.add(&input, &truth);
        let lowest = output.iter().flatten().map(|p| p.y).fold(0.0, f32::min);
        deepest = deepest.max(-lowest);
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{set}: {} ticks ({not_full} not in full); MPJPE cm {error} (given {given}); jitter \
         {:.4} km/s³ (true {:.4}, given {:.4}); skate {skate} (true {skate_true}, given \
         {skate_given}); deepest {:.1} mm; whole tick median {:.3} ms, p99 {:.3} ms",
        times.len(),
        jitter.get(),
        jitter_true.get(),
        jitter_given.get(),
        1000.0 * deepest,
        times[times.len() / 2],
        times[times.len() * 99 / 100],
    );
}

/// Mean distances of the joints, metres: in the world, and with one joint brought together.
#[derive(Default)]
struct Errors {
    world: Mean,
    head: Mean,
    root: Mean,
}

impl Errors {
    fn add(&mut self, places: &Places, truth: &Places) {
        for (a, b) in places.iter().zip(truth) {
            let head = Joint::Head as usize;
            for (mean, shift) in [
                (&mut self.world, Vec3::ZERO),
                (&mut self.head, b[head] - a[head]),
                (&mut self.root, b[0] - a[0]),
            ] {
                for joint in 0..JOINTS {
                    mean.add(f64::from((a[joint] + shift).distance(b[joint])));
                }
            }
        }
    }
}

impl fmt::Display for Errors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [world, head, root] = [self.world, self.head, self.root].map(|m| 100.0 * m.get());
        write!(f, "world {world:.3}, head {head:.3}, root {root:.3}")
    }
}

/// Third differences at 60 frames a second, km/s³.
fn add_jitter(mean: &mut Mean, places: &Places) {
    for w in places.windows(4) {
        for joint in 0..JOINTS {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| w[k][joint].as_dvec3());
            mean.add((d - 3.0 * c + 3.0 * b - a).length() * 216.0);
        }
    }
}

/// How far ankles and toes move while the true ones move at most a centimetre a frame.
#[derive(Default)]
struct Skate {
    /// AvatarJLM's: along each axis, over all frames, metres a frame.
    components: Mean,
    /// Level speed over those frames alone, metres a frame.
    slide: Mean,
}

impl Skate {
    fn add(&mut self, places: &Places, truth: &Places) {
        for (p, t) in places.windows(2).zip(truth.windows(2)) {
            for joint in [
                Joint::LeftAnkle,
                Joint::RightAnkle,
                Joint::LeftFoot,
                Joint::RightFoot,
            ] {
                let joint = joint as usize;
                if t[0][joint].distance(t[1][joint]) > 0.01 {
                    self.components.add(0.0);
                    continue;
                }
                let moved = (p[1][joint] - p[0][joint]).abs();
                self.components.add(f64::from(moved.element_sum()) / 3.0);
                self.slide.add(f64::from(moved.x.hypot(moved.z)));
            }
        }
    }
}

impl fmt::Display for Skate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (components, slide) = (self.components.get(), self.slide.get());
        write!(
            f,
            "{:.4} cm, {:.2} cm/s",
            100.0 * components,
            6000.0 * slide
        )
    }
}

fn compare_solvers(set: &str, clips: &[Clip]) {
    let mut noise = Noise(2);
    let (mut worst, mut count, mut unsure, mut infeasible) = (0.0_f64, 0, 0, 0);
    let (mut ticks, mut solver) = (0, Solver::new(0, 0));
    let mut times = Vec::new();
    for clip in clips {
        let mut optimiser = optimiser(&clip.skeleton);
        for pose in &clip.frames {
            ticks += 1;
            // Every other problem from noisy motion, where more constraints are active.
            let shown = if ticks % 2 == 0 {
                noise.disturb(pose)
            } else {
                *pose
            };
            let reference = Reference {
                pose: &shown,
                velocities: None,
                contacts: None,
            };
            let solved = optimiser.step(&reference, &Ground::Flat);
            let problem = optimiser.problem();
            if ticks % 17 != 0 || problem.unknowns() == 0 || solved.outcome == Outcome::Kinematic {
                continue;
            }
            if solver.x().len() != problem.unknowns() {
                solver = Solver::new(problem.unknowns(), problem.constraints() + 100);
            }
            let started = Instant::now();
            let status = solver.solve(problem, &[]);
            times.push(started.elapsed().as_secs_f64() * 1e3);
            match (status, judge(problem)) {
                (Status::Solved, Verdict::Minimum(theirs)) => {
                    let ours = problem.objective(solver.x());
                    worst = worst.max((ours - theirs).abs() / theirs.abs());
                    count += 1;
                }
                (Status::Infeasible, Verdict::Infeasible) => infeasible += 1,
                (_, Verdict::Unsure) => unsure += 1,
                (status, verdict) => println!("{set}: {status:?} but {verdict:?}"),
            }
        }
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{set}: {count} problems, objectives within {worst:.1e} relative; {infeasible} infeasible \
         for both, {unsure} beyond Clarabel; cold solve median {:.3} ms, p99 {:.3} ms",
        times[times.len() / 2],
        times[times.len() * 99 / 100],
    );
}

/// A minute of random torques, held for 1/36 s each, after a fall from half a metre.
fn drop_on_scenes() -> Result<(), Box<dyn std::error::Error>> {
    let mut noise = Noise(3);
    for stature in [1.4, 1.75, 2.0] {
        for (name, scene) in samples() {
            let character = Character::of_height(stature)?;
            let weight = character.mass() * posed_body::simulation::GRAVITY;
            let limits: [f64; HINGES] = character.hinges.map(|hinge| hinge.torque);
            let model = Model::new(character, scene)?;
            let mut state = model.state();
            let mut pose = state.pose();
            pose.root.y += 0.5;
            state.set_pose(&pose);
            let (mut force, mut highest, mut sound) = (Mean::default(), 0.0_f64, true);
            let mut energies = [0.0_f64; 2];
            let started = Instant::now();
            for _ in 0..60 * 36 {
                let torques = limits.map(|limit| limit * (2.0 * noise.uniform() - 1.0));
                for _ in 0..4 {
                    sound &= state.step(&torques, 1) == Step::Sound;
                    let vertical = state.contact_force().y / weight;
                    force.add(vertical);
                    highest = highest.max(vertical);
                }
                let [potential, kinetic] = state.energy();
                energies[0] = energies[0].max(potential.abs());
                energies[1] = energies[1].max(kinetic);
            }
            println!(
                "{stature} m on {name}: {}; vertical force mean {:.2}, greatest {highest:.1} of the \
                 weight; energies up to {:.0} J potential, {:.0} J kinetic; {:.1} s",
                if sound { "finite" } else { "NOT FINITE" },
                force.get(),
                energies[0],
                energies[1],
                started.elapsed().as_secs_f64(),
            );
        }
    }
    Ok(())
}
