//! The built-in human walks into a scene, driven by QuestSim as it ships: what
//! `policy/training/questsim/pictures.py` draws.
//!
//! `cargo run -p posed --example interaction -- CONFIG.toml > FRAMES.json`; the configuration has the
//! scene. Frames at 90 Hz from 2 to 8 s: `seconds`, `joints` (22 positions, metres), `objects`
//! (positions and quaternions), `touched`, whether the character made the pose (`own`), `falls` so far.
//! `parents` are the joints that each hangs on, `scene` the scene, `ground` heights along x = 0 from
//! z = -2 to 2 every centimetre.

use posed::{
    config::{Layer, parse},
    models::Models,
    simulated,
};
use posed_body::{motion::Trajectory, skeleton::PARENTS};
use posed_signal::HostTime;
use posed_tracker::{
    Tracker, TrackerKind,
    eval::{Bones, Sensors, Shown, Straps},
    questsim,
};
use serde_json::json;

const RATE_HZ: f64 = 90.0;
const SPAN_S: [f64; 2] = [2.0, 8.0];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("give a configuration file")?;
    let text = std::fs::read_to_string(&path)?;
    let scene = parse(&[Layer { origin: path, text }])?.scene;
    let clip = simulated::built_in(1.75, 1);
    let (trajectory, wearer) = (Trajectory::new(&clip), Bones::Clip.wearer(&clip));
    let shown = Shown::new(&trajectory, &clip, Sensors::HmdControllers, Straps::Exact);
    let options = questsim::Options {
        scene: scene.clone(),
        ..questsim::Options::default()
    };
    let mut tracker = Models::load()?.questsim(None, options)?;
    let mut frames = Vec::new();
    for tick in 0..(SPAN_S[1] * RATE_HZ) as u32 {
        let seconds = f64::from(tick) / RATE_HZ;
        let target = HostTime::from_secs_f64(1.0 + seconds);
        let tracked = shown.track(&mut tracker, &wearer, seconds, target);
        if seconds < SPAN_S[0] {
            continue;
        }
        let joints = wearer.skeleton.forward(&tracked.pose).positions;
        let objects = tracker.objects();
        let object =
            |o: &posed_tracker::ObjectPose| json!([o.position.to_array(), o.rotation.to_array()]);
        frames.push(json!({
            "seconds": seconds,
            "joints": joints.map(|joint| joint.to_array()).to_vec(),
            "objects": objects.iter().map(object).collect::<Vec<_>>(),
            "touched": objects.iter().any(|object| object.touched),
            "own": tracked.kind == TrackerKind::QuestSim,
            "falls": tracker.recoveries().map(|counts| counts.total()),
        }));
    }
    let ground = (-200..=200).map(|cm| scene.ground.at(0.0, f64::from(cm) * 0.01).height);
    println!(
        "{}",
        json!({
            "parents": PARENTS,
            "scene": scene,
            "ground": ground.collect::<Vec<_>>(),
            "frames": frames,
        })
    );
    Ok(())
}
