//! The whole way: the motion becomes USB traffic of simulated devices under simulated base
//! stations, and the pose is worked out from those bytes by everything that runs live.

use std::io::Cursor;

use posed_body::{
    Joint,
    motion::{Clip, Trajectory},
};
use posed_device::{
    capture::{self, UsbmonOptions, UsbmonWriter},
    rig::{self, Rig},
    simulate::Simulator,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{DeviceId, HostTime, Sample, latest::latest, ring::ring};
use posed_tracker::{
    Tracker, Wearer,
    eval::{ClipResult, Dump, Options, evaluate},
    metrics::{Metric, Scores, Track, point_masses},
};

use crate::{
    heights::Heights,
    pipeline::{
        replay::{Watcher, replay},
        source::Source,
        tracking::{Inputs, Setup, TrackerLoop},
    },
    published::PublishedPose,
    simulated::Person,
};

/// What comes before this time is left out on both sides: devices start up and are found, seconds.
const SETTLE_S: f64 = 2.0;
/// Clips whose head goes farther from the middle of the room than this leave the base stations'
/// sight, metres.
const ROOM_M: f32 = 1.6;

/// One clip from ideal sensors and from USB traffic, over the same frames.
pub(super) struct Both {
    pub ideal: ClipResult,
    pub usb: ClipResult,
}

/// Whether the clip lasts long enough and stays within the base stations' sight.
pub(super) fn fits(clip: &Clip) -> bool {
    let head = |frame| clip.skeleton.forward(frame).position(Joint::Head);
    let within = |frame| {
        let head = head(frame);
        head.x.hypot(head.z) < ROOM_M
    };
    clip.duration() > SETTLE_S + 1.0 && clip.frames.iter().all(within)
}

/// Evaluates a clip in both ways, each with a tracker of its own.
///
/// # Errors
/// The simulation or its capture fails; as text.
pub(super) fn both(
    clip: &Clip,
    [ideal, usb]: [Box<dyn Tracker>; 2],
    options: &Options,
) -> Result<Both, String> {
    let options = Options {
        dump: true,
        ..*options
    };
    let mut ideal_tracker = ideal;
    let ideal = evaluate(clip, &mut *ideal_tracker, &options);
    let wearer = options.bones.wearer(clip);
    let poses = from_bytes(clip, usb, wearer, options.rate_hz)?;
    let trajectory = Trajectory::new(clip);
    let (predicted, truth): (Vec<_>, Vec<_>) = poses
        .iter()
        .filter(|(seconds, _)| (SETTLE_S..=trajectory.duration()).contains(seconds))
        .map(|(seconds, pose)| (pose.pose, trajectory.pose(*seconds)))
        .unzip();
    let tracks = [
        Track::new(options.rate_hz, &wearer.skeleton, &predicted),
        Track::new(options.rate_hz, &clip.skeleton, &truth),
    ];
    let usb = result(&ideal, clip, &tracks);
    let skip = (SETTLE_S * options.rate_hz) as usize;
    let Some(Dump {
        predicted_poses,
        true_poses,
        ..
    }) = &ideal.dump
    else {
        return Err("an evaluation kept no motion; this is a bug".into());
    };
    let skip = skip.min(predicted_poses.len());
    let tracks = [
        Track::new(options.rate_hz, &wearer.skeleton, &predicted_poses[skip..]),
        Track::new(options.rate_hz, &clip.skeleton, &true_poses[skip..]),
    ];
    let ideal = result(&ideal, clip, &tracks);
    Ok(Both { ideal, usb })
}

fn result(like: &ClipResult, clip: &Clip, [predicted, truth]: &[Track; 2]) -> ClipResult {
    ClipResult {
        name: like.name.clone(),
        class: like.class.clone(),
        frames: predicted.len(),
        seconds: predicted.len() as f64 / predicted.fps,
        scores: Scores::measure(predicted, truth, &point_masses(&clip.skeleton)),
        hands_seen: like.hands_seen,
        sure: like.sure,
        own: like.own,
        recoveries: like.recoveries,
        held_s: like.held_s,
        dump: None,
    }
}

/// Poses with their times in the clip, worked out from the clip's USB traffic.
fn from_bytes(
    clip: &Clip,
    tracker: Box<dyn Tracker>,
    wearer: Wearer,
    rate_hz: f64,
) -> Result<Vec<(f64, PublishedPose)>, String> {
    let person = Person::new(clip);
    let options = person.options(1, None);
    let start = options.start;
    let simulator = Simulator::new(options, person.devices()).map_err(|error| error.to_string())?;
    let mut settings = rig::Settings::default();
    settings.devices.lighthouse.base_stations = simulator.stations().to_vec();
    let bytes = traffic(simulator).map_err(|error| error.to_string())?;
    let reader = capture::open(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    let recording = Recording {
        name: clip.name.clone(),
        reader,
        devices: Vec::new(),
    };
    let transport = Replay::new(vec![recording], Merge::OneSession);
    let (rig, rings) = Rig::new(settings);
    let (roles_writer, roles) = latest();
    let (_requests, requests) = ring(1);
    let inputs = Inputs {
        rings,
        roles,
        requests,
    };
    let choice = tracker.kind();
    let setup = Setup {
        trackers: vec![tracker],
        choice,
        heights: Heights::of(wearer.height),
        measure_height: false,
        wearer,
        horizon_ns: 0,
    };
    let (_buzzes, buzzes) = ring(1);
    let mut source = Source::new(Box::new(transport), rig, roles_writer, buzzes);
    let mut tracker = TrackerLoop::new(inputs, setup);
    let mut poses = Poses {
        start,
        poses: Vec::new(),
    };
    replay(&mut source, &mut tracker, rate_hz, &mut poses);
    Ok(poses.poses)
}

/// The bytes of a capture.
fn traffic(simulator: Simulator) -> std::io::Result<Vec<u8>> {
    let mut writer = UsbmonWriter::new(
        Vec::new(),
        UsbmonOptions {
            gzip: false,
            ..UsbmonOptions::default()
        },
    )?;
    for packet in simulator {
        writer.packet(&packet)?;
    }
    writer.finish()
}

struct Poses {
    start: HostTime,
    poses: Vec<(f64, PublishedPose)>,
}

impl Watcher for Poses {
    fn pace(&mut self, _time: HostTime) -> bool {
        true
    }

    fn sample(&mut self, _device: DeviceId, _sample: &Sample) {}

    fn pose(&mut self, pose: &PublishedPose, _source: &Source) {
        let seconds = pose.target_at.since_secs(self.start);
        self.poses.push((seconds, *pose));
    }

    fn warning(&mut self, _text: &str) {}
}

/// What both say in all, and the ratio.
pub(super) fn text(ideal: &Scores, usb: &Scores, clips: usize, left_out: usize) -> String {
    let mut text = format!(
        "{clips} clips ({left_out} too short or outside the base stations' sight are left out), \
         from {SETTLE_S} s on\n{:<22} {:>10} {:>10} {:>7}\n",
        "", "ideal", "USB", "ratio"
    );
    for metric in [
        Metric::MpjpeHead,
        Metric::MpjpeWorld,
        Metric::Mpjve,
        Metric::MpjreGeodesic,
        Metric::HandPe,
        Metric::Jitter,
    ] {
        if let (Some(ideal), Some(usb)) = (ideal.get(metric), usb.get(metric)) {
            let name = metric.name();
            text += &format!(
                "{name:<22} {ideal:>10.3} {usb:>10.3} {:>7.3}\n",
                usb / ideal
            );
        }
    }
    text
}
