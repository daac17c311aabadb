//! What a frame of HMD-NeMo costs: network, refinement, physics, at 60 and 90 ticks a second; one
//! of PIP: networks, and optimiser; and a step of QuestSim: observation, policy and four physics steps.
//!
//! Prints medians, 99th percentiles and maxima over the built-in human's forty seconds, three times
//! over, for every model in policy/models, or those whose name holds the argument:
//! `cargo bench -p posed-tracker --bench frame -- pip`.

use std::{path::Path, time::Instant};

use posed_body::motion::{Clip, Trajectory, procedural};
use posed_signal::{HostTime, Lookup, Pose, Role};
use posed_tracker::{
    HmdNemo, Ik, Input, Physical, Pip, QuestSim, Tracker, TrackerKind, Wearer,
    eval::{Sensors, Shown, Straps},
    hmd_nemo::Options,
    inference::Runtime,
    pip, questsim,
    tracker::NO_INERTIAL,
};

const ROUNDS: usize = 3;

fn main() {
    // `cargo test --benches` runs this too; there is nothing to measure then.
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    let only = std::env::args()
        .skip(1)
        .find(|argument| !argument.starts_with('-'));
    let wanted = |name: &str| only.as_ref().is_none_or(|only| name.contains(only));
    let library = std::env::var_os("ORT_DYLIB_PATH").expect("cargo sets ORT_DYLIB_PATH");
    let runtime = Runtime::load(Path::new(&library)).expect("run `make native` first");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let clip = procedural::timeline(1.75, 4);
    for name in ["hmd_nemo_small", "hmd_nemo_full"]
        .into_iter()
        .filter(|name| wanted(name))
    {
        let Ok(model) = std::fs::read(folder.join(format!("{name}.onnx"))) else {
            continue;
        };
        let load = |refine, mirror| {
            let options = Options {
                refine,
                mirror,
                ..Options::default()
            };
            HmdNemo::load(&runtime, name, &model, options).expect("the model fits")
        };
        for rate in [60.0, 90.0] {
            println!("{name}, {rate} Hz");
            report("network, once", &mut load(false, false), &clip, rate);
            report("network, and mirrored", &mut load(false, true), &clip, rate);
            report("+ refinement", &mut load(true, true), &clip, rate);
            let wearer = Wearer {
                height: clip.skeleton.stature(),
                skeleton: clip.skeleton,
            };
            let mut physical = Physical::new(Box::new(load(true, true)), &wearer, rate);
            report("+ physics", &mut physical, &clip, rate);
        }
    }
    if wanted("questsim") {
        questsim(&runtime, &folder, &clip);
    }
    for name in ["pip_small", "pip_full"]
        .into_iter()
        .filter(|name| wanted(name))
    {
        let Ok(model) = std::fs::read(folder.join(format!("{name}.onnx"))) else {
            continue;
        };
        for rate in [60.0, 90.0] {
            println!("{name}, {rate} Hz");
            for (what, physics) in [
                ("networks", pip::Physics::Off),
                ("+ optimiser", pip::Physics::DualPd),
            ] {
                let options = pip::Options { physics };
                let loaded = Pip::load(&runtime, name, &model, options);
                report(what, &mut loaded.expect("the model fits"), &clip, rate);
            }
        }
    }
}

/// At 36 ticks a second each has one step of the policy in it, and what little `ik` costs as its
/// stand-in; at 90 two of five have one, and HMD-NeMo stands in, as it ships.
fn questsim(runtime: &Runtime, folder: &Path, clip: &Clip) {
    let read = |name: &str| std::fs::read(folder.join(format!("{name}.onnx")));
    let (Ok(policy), Ok(stand_in)) = (read("questsim"), read("hmd_nemo_small")) else {
        return;
    };
    let load = |stand_in: Box<dyn Tracker>| {
        let options = questsim::Options::default();
        QuestSim::load(runtime, "questsim", &policy, stand_in, options).expect("the model fits")
    };
    println!("questsim");
    let mut alone = load(Box::<Ik>::default());
    report("step, 36 Hz", &mut alone, clip, 36.0);
    println!("  {} steps in all", alone.steps());
    let nemo = HmdNemo::load(runtime, "stand-in", &stand_in, Options::default());
    let mut whole = load(Box::new(nemo.expect("the model fits")));
    report("+ HMD-NeMo, 90 Hz", &mut whole, clip, 90.0);
}

fn report(what: &str, tracker: &mut dyn Tracker, clip: &Clip, rate: f64) {
    let trajectory = Trajectory::new(clip);
    let sensors = match tracker.kind() {
        TrackerKind::Pip => Sensors::Imu6,
        _ => Sensors::HmdControllers,
    };
    let mut shown = Shown::new(&trajectory, clip, sensors, Straps::Exact);
    let wearer = Wearer {
        height: clip.skeleton.stature(),
        skeleton: clip.skeleton,
    };
    let mut costs = Vec::new();
    let frames = (trajectory.duration() * rate) as usize;
    for frame in (0..ROUNDS).flat_map(|_| 0..frames) {
        let seconds = frame as f64 / rate;
        let target = HostTime::from_secs_f64(1.0 + costs.len() as f64 / rate);
        let mut parts: [Lookup<Pose>; Role::COUNT] = [Lookup::Empty; Role::COUNT];
        let mut inertial = NO_INERTIAL;
        for role in Role::ALL {
            if let Some(pose) = shown.pose(role, seconds, target) {
                parts[role as usize] = Lookup::Exact(pose);
            }
            if let Some(orientation) = shown.orientation(role, seconds, target) {
                inertial[role as usize] = Lookup::Exact(orientation);
            }
        }
        let input = Input {
            target,
            parts: &parts,
            inertial: &inertial,
            wearer: &wearer,
        };
        let begun = Instant::now();
        std::hint::black_box(tracker.track(&input));
        costs.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    costs.sort_by(f64::total_cmp);
    let at = |share: f64| costs[((costs.len() - 1) as f64 * share) as usize];
    println!(
        "  {what:<22} p50 {:6.3} ms   p99 {:6.3} ms   max {:6.3} ms",
        at(0.5),
        at(0.99),
        at(1.0)
    );
}
