//! What the ground does to somebody on recorded motion, as PIP tells it from ideal sensors: the
//! table that `python -m pip.forces` plots.
//!
//!     cargo run -p posed-tracker --example forces -- SET.npz CLIP > FORCES.csv

use std::{
    env,
    fs::File,
    io::{self, BufReader, Write as _},
    path::Path,
    sync::mpsc::{Sender, channel},
};

use posed_body::{BodyPose, motion::MotionSet};
use posed_tracker::{
    Input, Pip, Tracked, Tracker, TrackerKind,
    eval::{Options, Sensors, evaluate},
    inference::Runtime,
    pip,
};

/// Hands on what the tracker says of the ground.
struct Tap(Pip, Sender<[f64; 6]>);

impl Tracker for Tap {
    fn kind(&self) -> TrackerKind {
        self.0.kind()
    }

    fn reset(&mut self) {
        self.0.reset();
    }

    fn begin(&mut self, pose: &BodyPose) {
        self.0.begin(pose);
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let tracked = self.0.track(input);
        if let (Some(forces), Some([left, right])) = (tracked.forces, self.0.contacts()) {
            let feet = forces.feet.map(|foot| f64::from(foot.force.y));
            let row = [
                input.target.as_secs_f64(),
                feet[0],
                feet[1],
                f64::from(forces.ground.y),
                f64::from(left),
                f64::from(right),
            ];
            self.1.send(row).expect("the table outlives the tracker");
        }
        tracked
    }
}

fn main() -> io::Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [set, clip] = &arguments[..] else {
        return Err(io::Error::other("give a motion set and the name of a clip"));
    };
    let library = env::var_os("ORT_DYLIB_PATH").expect("cargo sets ORT_DYLIB_PATH");
    let runtime = Runtime::load(Path::new(&library)).map_err(io::Error::other)?;
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/pip_small.onnx");
    let model = std::fs::read(model)?;
    let set = MotionSet::read(BufReader::new(File::open(set)?)).map_err(io::Error::other)?;
    let clip = set.named(clip).map_err(io::Error::other)?;
    let tracker = Pip::load(&runtime, "pip_small", &model, pip::Options::default());
    let (rows, table) = channel();
    let mut tap = Tap(tracker.map_err(io::Error::other)?, rows);
    let options = Options {
        sensors: Sensors::Imu6,
        ..Options::default()
    };
    let _ = evaluate(&clip, &mut tap, &options);
    drop(tap);
    let mut out = io::stdout().lock();
    writeln!(
        out,
        "seconds,left N,right N,both N,left stands,right stands"
    )?;
    let mut first = None;
    for [at, left, right, both, left_stands, right_stands] in table {
        let seconds = at - *first.get_or_insert(at);
        writeln!(
            out,
            "{seconds:.4},{left:.2},{right:.2},{both:.2},{left_stands:.4},{right_stands:.4}"
        )?;
    }
    Ok(())
}
