//! PIP as it ships: from USB bytes to the body, with losses and without some trackers; the forces of
//! a walk.

use std::{
    fs::File,
    io::{BufReader, Cursor},
    sync::{Arc, Mutex},
};

use posed::{
    assemble::{Options, assemble},
    postures,
    published::PublishedPose,
    simulated::{self, Person},
};
use posed_body::{
    BodyPose,
    character::average_mass,
    motion::{Clip, MotionSet, Trajectory},
    scene::Scene,
};
use posed_device::{
    capture::open,
    simulate::slimevr,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{HostTime, Role, Serial};
use posed_tracker::{
    Input, Quality, Tracked, Tracker, TrackerKind,
    eval::{self, Sensors, evaluate},
    metrics::{Metric, Scores, Track, point_masses},
};

use crate::{
    allocation::armed,
    shared::{models, shared},
    trackers::{Calibrating, PORT, WORN, usbmon},
};

const RATE_HZ: f64 = 60.0;

fn pip() -> Box<dyn Tracker> {
    let tracker = models()
        .tracker(TrackerKind::Pip, &Scene::default())
        .expect("the model fits");
    tracker.expect("PIP is built in")
}

/// Poses after calibration, from the USB bytes of trackers in these roles.
fn poses(clip: &Clip, worn: &[Role], loss: f64) -> Vec<PublishedPose> {
    let person = Person::new(clip);
    let receiver = slimevr::Options {
        duration_s: clip.duration(),
        loss,
        ..slimevr::Options::default()
    };
    let trackers = person.trackers(worn, 3);
    let packets = slimevr::Receiver::new(receiver, PORT, trackers).expect("six are not too many");
    let recording = Recording {
        name: "simulated".into(),
        reader: open(Cursor::new(usbmon(packets))).expect("a capture"),
        devices: Vec::new(),
    };
    let mut options = Options {
        trackers: vec![pip()],
        tracker: TrackerKind::Pip,
        ..Options::default()
    };
    let named =
        |(index, role): (usize, &Role)| (Serial::new(&simulated::tracker_serial(index)), *role);
    options.rig.roles = worn.iter().enumerate().map(named).collect();
    let transport = Replay::new(vec![recording], Merge::OneSession);
    let mut parts = assemble(Box::new(transport), options);
    let mut watcher = Calibrating::new(parts.requests);
    posed::pipeline::replay::replay(&mut parts.source, &mut parts.tracker, RATE_HZ, &mut watcher);
    watcher.poses
}

fn measured(clip: &Clip, poses: &[PublishedPose]) -> Scores {
    let trajectory = Trajectory::new(clip);
    let start = slimevr::Options::default().start;
    let seconds = |pose: &PublishedPose| pose.target_at.since_secs(start);
    let (predicted, truth): (Vec<BodyPose>, Vec<BodyPose>) = poses
        .iter()
        .filter(|pose| (postures::LEAD_IN_S..trajectory.duration()).contains(&seconds(pose)))
        .map(|pose| (pose.pose, trajectory.pose(seconds(pose))))
        .unzip();
    let track = |poses: &[BodyPose]| Track::new(RATE_HZ, &clip.skeleton, poses);
    let masses = point_masses(&clip.skeleton);
    Scores::measure(&track(&predicted), &track(&truth), &masses)
}

fn sip(scores: &Scores) -> f64 {
    scores.get(Metric::PipSip).expect("frames were compared")
}

#[test]
fn five_percent_of_packets_lost_cost_little() {
    let clip = postures::before(&simulated::built_in(1.75, 1));
    let worn = WORN.map(|(role, _)| role);
    let [whole, lossy] = [0.0, 0.05].map(|loss| {
        let poses = poses(&clip, &worn, loss);
        let last = poses.last().expect("poses came");
        assert_eq!((last.kind, last.quality), (TrackerKind::Pip, Quality::Full));
        measured(&clip, &poses)
    });
    println!(
        "SIP {:.3} degrees lossless, {:.3} lossy",
        sip(&whole),
        sip(&lossy)
    );
    assert!(sip(&whole) < 15.0 && sip(&lossy) < sip(&whole) + 1.5);
}

#[test]
fn one_or_two_trackers_less_are_bridged_and_said() {
    let clip = postures::before(&simulated::built_in(1.75, 1));
    let mut errors = Vec::new();
    for missing in [
        &[][..],
        &[Role::LeftWrist],
        &[Role::LeftWrist, Role::RightKnee],
    ] {
        let worn: Vec<Role> = WORN
            .iter()
            .map(|(role, _)| *role)
            .filter(|role| !missing.contains(role))
            .collect();
        let poses = poses(&clip, &worn, 0.0);
        let last = poses.last().expect("poses came");
        let quality = if missing.is_empty() {
            Quality::Full
        } else {
            Quality::Partial
        };
        assert_eq!((last.kind, last.quality), (TrackerKind::Pip, quality));
        errors.push(sip(&measured(&clip, &poses)));
    }
    println!("SIP with six, five, four trackers: {errors:.2?} degrees");
    assert!(errors.iter().all(|error| *error < 30.0), "{errors:?}");
}

/// Keeps the forces that the tracker tells, and sees that it allocates nothing.
struct Recorder {
    tracker: Box<dyn Tracker>,
    heard: Arc<Mutex<Vec<Step>>>,
}

#[derive(Clone, Copy)]
struct Step {
    at: HostTime,
    feet: [f32; 2],
    ground: f32,
    stands: [bool; 2],
}

impl Tracker for Recorder {
    fn kind(&self) -> TrackerKind {
        self.tracker.kind()
    }

    fn reset(&mut self) {
        self.tracker.reset();
    }

    fn begin(&mut self, pose: &BodyPose) {
        self.tracker.begin(pose);
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let (tracked, allocations) = armed(|| self.tracker.track(input));
        assert_eq!(allocations, 0, "a tick allocated");
        let forces = tracked.forces.expect("PIP tells forces");
        let contact = self.tracker.contacts().expect("PIP tells contacts");
        self.heard.lock().expect("nobody panicked").push(Step {
            at: input.target,
            feet: forces.feet.map(|foot| foot.force.y),
            ground: forces.ground.y,
            stands: contact.map(|probability| probability > 0.5),
        });
        tracked
    }
}

/// Frames in which a foot is set down.
fn steps(heard: &[Step], foot: usize) -> Vec<usize> {
    let down = |pair: &[Step]| pair[1].stands[foot] && !pair[0].stands[foot];
    let pairs = heard.windows(2).enumerate();
    pairs
        .filter(|(_, pair)| down(pair))
        .map(|(index, _)| index + 1)
        .collect()
}

#[test]
fn the_ground_carries_a_walker_foot_by_foot() {
    let Some(path) = shared("mocap/snu.npz") else {
        return;
    };
    let set = MotionSet::read(BufReader::new(File::open(path).expect("a file"))).expect("a set");
    let clip = set
        .named("woody2_walk_slow_stright")
        .expect("it has this walk");
    let heard = Arc::default();
    let mut tracker = Recorder {
        tracker: pip(),
        heard: Arc::clone(&heard),
    };
    let options = eval::Options {
        sensors: Sensors::Imu6,
        ..eval::Options::default()
    };
    let result = evaluate(&clip, &mut tracker, &options);
    assert!(result.own > 0.99, "a stand-in made the poses");
    let heard = heard.lock().expect("nobody panicked");
    // The clip stands before and after it walks.
    let [left, right] = [0, 1].map(|foot| steps(&heard, foot));
    assert!(
        left.len() > 10 && right.len() > 10,
        "{} and {} steps",
        left.len(),
        right.len()
    );
    let whole = &heard[left[0]..left[left.len() - 1]];
    let weight = 9.81 * average_mass(f64::from(clip.skeleton.stature()));
    let mean = |of: fn(&Step) -> f32| {
        whole.iter().map(|step| f64::from(of(step))).sum::<f64>() / whole.len() as f64
    };
    let share = mean(|step| step.ground) / weight;
    // Feet alternate: between two steps of one there is one of the other, ...
    let between = left.windows(2).filter(|pair| {
        right
            .iter()
            .filter(|step| (pair[0]..pair[1]).contains(step))
            .count()
            == 1
    });
    let alternate = between.count() as f64 / (left.len() - 1) as f64;
    // ... and each carries the weight alone for a part of the time.
    let alone = |foot: usize| {
        let carries = |step: &&Step| {
            let [own, other] = [step.feet[foot], step.feet[1 - foot]].map(f64::from);
            own > 0.7 * weight && other < 0.1 * weight
        };
        whole.iter().filter(carries).count() as f64 / whole.len() as f64
    };
    let (strides, apart) = (left.len() - 1, [alone(0), alone(1)]);
    let seconds = whole[whole.len() - 1].at.since_secs(whole[0].at);
    println!(
        "{strides} strides in {seconds:.1} s: mean ground force {share:.3} of body weight, \
         {:.0} % of strides alternate, left alone {:.2}, right alone {:.2} of the time",
        100.0 * alternate,
        apart[0],
        apart[1],
    );
    assert!((share - 1.0).abs() < 0.05, "{share} of body weight");
    assert!(alternate > 0.8, "{alternate} of the strides alternate");
    assert!(apart.iter().all(|share| *share > 0.2), "{apart:?}");
}
