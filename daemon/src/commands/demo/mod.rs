//! `posed demo`: the whole way on one machine, without any device.

pub mod figure;
mod screen;

use std::{
    io::{Cursor, IsTerminal as _},
    sync::Arc,
    thread,
};

use posed_device::{
    capture,
    lighthouse::base_station::parse_libsurvive,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{Clock as _, DeviceId, HostTime, Sample};
use posed_tracker::{TrackerKind, Wearer};

use super::{CommandError, Tally, live, replay::Broadcast, settings};
use crate::{
    assemble::{Assembly, Options, assemble},
    cli::DemoArgs,
    clock::Monotonic,
    config::{self, Grpc, Loopback, UnixSocket},
    control::Control,
    page::{self, Page, Station},
    pipeline::{
        replay::{Watcher, replay as run_replay},
        source::Source,
    },
    published::PublishedPose,
    serving::Serving,
};
use screen::Screen;

/// The embedded capture: USB traffic of a simulated Index headset and two Index controllers on
/// somebody who stands, walks, turns, squats, reaches and waves (`make assets`).
pub static CAPTURE: &[u8] = include_bytes!("../../../assets/demo.pcap.gz");
/// Its base stations, in libsurvive's JSON.
pub static BASE_STATIONS: &str = include_str!("../../../assets/demo-base-stations.json");
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

/// What tracks the embedded capture, with the tracker that needs no model.
///
/// # Errors
/// The embedded base stations cannot be read.
pub fn options() -> Result<Options, CommandError> {
    let mut options = Options {
        height: HEIGHT,
        ..Options::default()
    };
    options.rig.devices.lighthouse.base_stations = parse_libsurvive(BASE_STATIONS)
        .map_err(|error| CommandError::Input(format!("embedded base stations: {error}")))?;
    Ok(options)
}

/// Replays the embedded capture at real speed, serves it, follows it over gRPC and shows that.
///
/// # Errors
/// A socket or thread cannot be had.
pub fn run(args: &DemoArgs) -> Result<(), CommandError> {
    let folder = std::env::temp_dir().join(format!("posed-demo-{}", std::process::id()));
    let socket = folder.join("posed.sock");
    let grpc = Grpc {
        unix: UnixSocket::At(socket.clone()),
        tcp: args.listen.map(Loopback::try_from).transpose()?,
    };
    let wearer = Wearer::of_height(HEIGHT);
    let (sink, serving) = Serving::start(&grpc, None, wearer, Arc::new(Monotonic))?;
    for name in serving.names() {
        println!("serving on {name}");
    }
    let terminal = std::io::stdout().is_terminal();
    let devices = serving.devices().subscribe();
    let screen = Screen::follow(serving.runtime(), &socket, devices, terminal);

    let options = Options {
        trackers: settings::trackers(TRACKER),
        tracker: TRACKER,
        ..options()?
    };
    let stations = &options.rig.devices.lighthouse.base_stations;
    let stations = stations.iter().map(Station::from).collect();
    let Assembly {
        mut source,
        mut tracker,
        requests,
    } = assemble(Box::new(replay()?), options);
    let control = Control::new(requests, serving.wearer());
    match page(&serving, control, stations) {
        Ok(Some(url)) => println!("the live page is at {url}"),
        Ok(None) => {}
        // Another posed may be running; the demo goes on without its page.
        Err(error) => println!("{error}"),
    }
    let mut served = Served {
        broadcast: Broadcast::new(1.0, sink, serving.devices()),
        tally: Tally::default(),
        stop: live::stop_flag()?,
        end_s: args.seconds,
        first: None,
    };
    let begun = Monotonic.now();
    let span = thread::scope(|scope| {
        let work = || run_replay(&mut source, &mut tracker, RATE_HZ, &mut served);
        scope.spawn(work).join()
    })
    .map_err(|_| CommandError::Input("the replay's thread failed; this is a bug".into()))?;
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

fn page(
    serving: &Serving,
    control: Control,
    stations: Vec<Station>,
) -> Result<Option<String>, page::PageError> {
    let page = Page {
        services: serving.services().clone(),
        ticks: None,
        rate_hz: RATE_HZ,
        trackers: vec![TRACKER, TrackerKind::Ik],
        stations,
        request: Arc::new(move |request| control.request(request)),
    };
    page::start(serving.runtime().handle(), &config::Page::default(), page)
}

/// Serves a replay at real speed.
struct Served {
    broadcast: Broadcast,
    tally: Tally,
    stop: Arc<std::sync::atomic::AtomicBool>,
    end_s: Option<f64>,
    first: Option<HostTime>,
}

impl Watcher for Served {
    fn pace(&mut self, time: HostTime) -> bool {
        let first = *self.first.get_or_insert(time);
        self.broadcast.wait(time);
        let over = self.end_s.is_some_and(|end| time.since_secs(first) > end);
        !over && !self.stop.load(std::sync::atomic::Ordering::Relaxed)
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
