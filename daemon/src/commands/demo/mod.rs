//! `posed demo`: the whole way on one machine, without any device.

pub mod figure;
mod screen;

use std::{
    io::{Cursor, IsTerminal as _},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};

use posed_body::scene::Scene;
use posed_device::{
    capture,
    lighthouse::room,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{Clock as _, DeviceId, HostTime, Sample};
use posed_tracker::TrackerKind;

use super::{
    CommandError, Tally,
    broadcast::{self, Broadcast, Open},
    live, settings,
};
use crate::{
    assemble::{Assembly, Options, assemble},
    cli::DemoArgs,
    clock::Monotonic,
    config::{self, Grpc, Loopback, UnixSocket},
    control::{Known, Requests},
    grpc::PoseSink,
    heights::Heights,
    page::{self, Page},
    pipeline::{
        playback::Playback,
        replay::{Watcher, replay as run_replay},
        source::Source,
    },
    published::PublishedPose,
    serving::{self, Serving},
};
use screen::Screen;

/// The embedded capture: USB traffic of a simulated Index headset and two Index controllers on
/// somebody who stands, walks, turns, squats, reaches and waves (`make assets`).
pub static CAPTURE: &[u8] = include_bytes!("../../../assets/demo.pcap.gz");
/// Height of the simulated wearer, metres.
pub const HEIGHT: f32 = 1.75;
/// What works out the body, if it can be had.
const TRACKER: TrackerKind = TrackerKind::HmdNemo;
/// Poses a second.
pub const RATE_HZ: f64 = 90.0;

/// The embedded capture as a transport.
///
/// # Errors
/// It cannot be read; it is built in, so that this is a fault of the build.
pub fn replay() -> Result<Replay, CommandError> {
    let reader = capture::open(Cursor::new(CAPTURE))
        .map_err(|error| CommandError::Input(format!("embedded capture: {error}")))?;
    let recording = Recording {
        name: "embedded capture".into(),
        reader,
        devices: Vec::new(),
    };
    Ok(Replay::new(vec![recording], Merge::OneSession))
}

/// What tracks the embedded capture, with the tracker that needs no model. The base stations are
/// found by their light.
#[must_use]
pub fn options() -> Options {
    let options = Options {
        heights: Heights::of(HEIGHT),
        ..Options::default()
    };
    let room = &options.rig.devices.lighthouse.room;
    room.with(|room| room.set_stature(f64::from(HEIGHT)));
    options
}

/// Replays the embedded capture at real speed, serves it, follows it over gRPC and shows that.
///
/// # Errors
/// A socket or thread cannot be had.
pub fn run(args: &DemoArgs) -> Result<(), CommandError> {
    let folder = std::env::temp_dir().join(format!("posed-demo-{}", std::process::id()));
    let options = Options {
        trackers: settings::trackers(TRACKER, &Scene::default()),
        tracker: TRACKER,
        ..options()
    };
    let rig = options.rig.clone();
    let room = rig.devices.lighthouse.room.clone();
    let trackers = options.choices();
    let open: Open = Arc::new(|| Ok(Box::new(replay()?)));
    let Assembly {
        mut source,
        mut tracker,
        requests,
    } = assemble(open()?, options);
    let (sink, serving) = serve(args, &folder, requests, trackers)?;
    for name in serving.names() {
        println!("serving on {name}");
    }
    let terminal = std::io::stdout().is_terminal();
    let devices = serving.devices().subscribe();
    let screen = Screen::follow(serving.runtime(), &socket(&folder), devices, terminal);
    let playback = Arc::new(Playback::default());
    broadcast::measure(&open, &playback)?;
    match page(args, &serving, &playback, room) {
        Ok(Some(url)) => println!("the live page is at {url}"),
        Ok(None) => {}
        // Another posed may be running; the demo goes on without its page.
        Err(error) => println!("{error}"),
    }
    let begun = Monotonic.now();
    let mut served = Served {
        broadcast: Broadcast::new(Some(1.0), sink, &serving, playback),
        tally: Tally::default(),
        stop: live::stop_flag()?,
        end: args.seconds.map(|seconds| begun.plus_secs(seconds)),
    };
    let span = loop {
        let pass = thread::scope(|scope| {
            let work = || run_replay(&mut source, &mut tracker, RATE_HZ, &mut served);
            scope.spawn(work).join()
        });
        let failed = |_| CommandError::Input("the replay's thread failed; this is a bug".into());
        let span = pass.map_err(failed)?;
        if served.is_over() || !served.broadcast.rewind(args.again) {
            break span;
        }
        let control = &serving.services().control;
        (source, tracker) = broadcast::renew(&open, rig.clone(), tracker, control)?;
    };
    let wall_s = Monotonic.now().since_secs(begun);
    let report = served
        .tally
        .report(source.rig().devices(), span.seconds(), wall_s);
    drop(served);
    let summary = serving.stop(screen.finish());
    let _ = std::fs::remove_dir(&folder);
    print!("{}{}", report.text(), summary);
    Ok(())
}

fn socket(folder: &Path) -> PathBuf {
    folder.join("posed.sock")
}

/// Serves on a socket of the demo's own, beside any other posed.
fn serve(
    args: &DemoArgs,
    folder: &Path,
    requests: Requests,
    trackers: Vec<TrackerKind>,
) -> Result<(PoseSink, Serving), CommandError> {
    let grpc = Grpc {
        unix: UnixSocket::At(socket(folder)),
        tcp: args.listen.map(Loopback::try_from).transpose()?,
    };
    let setup = serving::Setup {
        grpc: &grpc,
        runtime_dir: None,
        recordings: config::files::recordings_dir(),
        rate_hz: RATE_HZ,
        requests,
        known: Known {
            heights: Heights::of(HEIGHT),
            tracker: TRACKER,
            trackers,
            objects: Vec::new(),
        },
        clock: Arc::new(Monotonic),
    };
    Ok(Serving::start(setup)?)
}

fn page(
    args: &DemoArgs,
    serving: &Serving,
    playback: &Arc<Playback>,
    room: room::Handle,
) -> Result<Option<String>, page::PageError> {
    let page = Page {
        services: serving.services().clone(),
        ticks: None,
        playback: Some(Arc::clone(playback)),
        rate_hz: RATE_HZ,
        room,
    };
    let mut config = config::Page::default();
    config.listen = args.page.or(config.listen);
    page::start(serving.runtime().handle(), &config, page)
}

/// Serves a replay at real speed.
struct Served {
    broadcast: Broadcast,
    tally: Tally,
    stop: Arc<AtomicBool>,
    end: Option<HostTime>,
}

impl Served {
    fn is_over(&self) -> bool {
        is_over(&self.stop, self.end)
    }
}

fn is_over(stop: &AtomicBool, end: Option<HostTime>) -> bool {
    stop.load(Ordering::Relaxed) || end.is_some_and(|end| Monotonic.now() > end)
}

impl Watcher for Served {
    fn pace(&mut self, time: HostTime) -> bool {
        let (stop, end) = (&self.stop, self.end);
        self.broadcast.wait(time, || is_over(stop, end))
    }

    fn sample(&mut self, _device: DeviceId, _sample: &Sample) {}

    fn pose(&mut self, pose: &PublishedPose, source: &Source) {
        self.tally.pose(pose);
        self.broadcast.pose(pose, source);
    }

    fn warning(&mut self, text: &str) {
        tracing::warn!("{text}");
    }
}
