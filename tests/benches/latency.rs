//! Latency and cost of posed, over the embedded capture and, where the shared data are there, a real
//! one of an Index headset and both its controllers; base stations are found by their light.
//!
//! Prints: what each stage costs per tick, what a sweep of a light plane over a sensor costs with
//! everything behind it, how much faster than real time a replay runs on one core, and how
//! long a USB report takes until the first pose that it had a part in is published, with the
//! source and the tracker on threads of their own at 90 Hz, as live: for the headset of the embedded
//! capture, and for PIP with six simulated SlimeVR trackers.

use std::{
    collections::BTreeMap,
    io::Cursor,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use posed::{
    assemble::{Assembly, Options, assemble},
    clock::Monotonic,
    commands::{demo, replay::recording},
    models::Models,
    pipeline::live::{Shared, spawn_source, spawn_tracker},
    postures,
    simulated::{self, Person},
};
use posed_body::scene::Scene;
use posed_device::{
    capture::{UsbmonOptions, UsbmonWriter, open},
    decode::Command,
    lighthouse::inspect::Inspector,
    simulate::slimevr,
    transport::{Event, Merge, Recording, Replay, Transport, TransportError},
    usb::Port,
};
use posed_signal::{Clock as _, HostTime, Serial, VirtualClock};
use posed_tracker::TrackerKind;

const RATE_HZ: f64 = 90.0;
/// A real capture.
const REAL: &str = "index-hmd-and-two-knuckles.pcap.gz";
/// Seconds of the capture that the live measurement takes.
const LIVE_S: f64 = 12.0;

fn main() {
    // `cargo test --benches` runs this too; there is nothing to measure then.
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    stages("embedded capture", &replay);
    match real() {
        Some(path) => stages(REAL, &|| {
            let recording = recording(&path).expect("the capture can be opened");
            Replay::new(vec![recording], Merge::OneSession)
        }),
        None => println!("SKIPPED (needs shared data): {REAL}"),
    }
    live("embedded capture", replay(), options());
    live(
        "PIP, six trackers",
        trackers_replay(),
        trackers_options().expect("ONNX Runtime is fetched by make native"),
    );
}

/// USB traffic of six trackers, whose wearer first stands still and so calibrates them.
fn trackers_replay() -> Replay {
    let clip = postures::before(&simulated::built_in(1.75, 1));
    let trackers = Person::new(&clip).trackers(&simulated::SIX, 3);
    let port = Port { bus: 1, address: 7 };
    let receiver = slimevr::Receiver::new(slimevr::Options::default(), port, trackers);
    let mut writer = UsbmonWriter::new(Vec::new(), UsbmonOptions::default()).expect("a Vec");
    for packet in receiver.expect("six are not too many") {
        writer.packet(&packet).expect("a Vec takes everything");
    }
    let bytes = Cursor::new(writer.finish().expect("a Vec"));
    let recording = Recording {
        name: "simulated".into(),
        reader: open(bytes).expect("a capture"),
        devices: Vec::new(),
    };
    Replay::new(vec![recording], Merge::OneSession)
}

fn trackers_options() -> Result<Options, posed_tracker::inference::InferenceError> {
    let mut options = Options {
        trackers: Models::load()?
            .tracker(TrackerKind::Pip, &Scene::default())?
            .into_iter()
            .collect(),
        tracker: TrackerKind::Pip,
        ..Options::default()
    };
    let serial = |index| Serial::new(&simulated::tracker_serial(index));
    let roles = simulated::SIX.iter().enumerate();
    options.rig.roles = roles.map(|(index, role)| (serial(index), *role)).collect();
    Ok(options)
}

fn options() -> Options {
    demo::options()
}

fn replay() -> Replay {
    demo::replay().expect("the embedded capture can be read")
}

/// p50, p99 and maximum of durations in ns, as microseconds.
fn quantiles(mut ns: Vec<u64>) -> String {
    if ns.is_empty() {
        return "nothing measured".into();
    }
    ns.sort_unstable();
    let at = |share: f64| ns[((ns.len() - 1) as f64 * share) as usize] as f64 / 1e3;
    format!(
        "p50 {:9.1} us   p99 {:9.1} us   max {:9.1} us",
        at(0.5),
        at(0.99),
        at(1.0)
    )
}

/// The real capture: `POSED_SHARED`, else `../shared` beside the repository.
fn real() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent()?;
    let beside = || root.with_file_name("shared");
    let shared = std::env::var_os("POSED_SHARED").map_or_else(beside, PathBuf::from);
    Some(shared.join("captures/lighthouse").join(REAL)).filter(|path| path.is_file())
}

/// Sweeps of light planes over sensors in a capture.
fn sweeps(mut replay: Replay) -> u64 {
    let mut inspectors = BTreeMap::<Port, Inspector>::new();
    loop {
        match replay.next(0) {
            Event::Packet(packet) => {
                let inspector = inspectors.entry(packet.port);
                inspector
                    .or_insert_with(|| Inspector::new(None))
                    .packet(&packet);
            }
            Event::End => break,
            _ => {}
        }
    }
    let reports = inspectors.values().map(Inspector::report);
    let seen = |report: posed_device::lighthouse::inspect::Report| {
        report
            .stations
            .values()
            .map(|seen| seen.sweeps)
            .sum::<u64>()
    };
    reports.map(seen).sum()
}

/// Everything on one thread, stepped by the capture's time.
fn stages(name: &str, open: &dyn Fn() -> Replay) {
    let sweeps = sweeps(open());
    let Assembly {
        mut source,
        mut tracker,
        ..
    } = assemble(Box::new(open()), options());
    let (mut read, mut decode, mut track) = (Vec::new(), Vec::new(), Vec::new());
    let (mut read_ns, mut decode_ns, mut packets) = (0u64, 0u64, 0u64);
    let mut next: Option<HostTime> = None;
    let (mut first, mut last) = (HostTime(0), HostTime(0));
    let begun = Instant::now();
    loop {
        let t0 = Instant::now();
        let event = source.next(0);
        let t1 = Instant::now();
        if let Event::Packet(packet) = &event {
            packets += 1;
            last = packet.at;
            let due = *next.get_or_insert_with(|| {
                first = packet.at;
                packet.at.plus_secs(1.0 / RATE_HZ)
            });
            if packet.at > due {
                next = Some(due.plus_secs(1.0 / RATE_HZ));
                let clock = VirtualClock::new(due);
                source.tick(due);
                let t = Instant::now();
                let pose = tracker.tick(&clock, &mut |_, _| {});
                std::hint::black_box(&pose);
                track.push(t.elapsed().as_nanos() as u64);
                read.push(std::mem::take(&mut read_ns));
                decode.push(std::mem::take(&mut decode_ns));
            }
        }
        let end = event == Event::End;
        let t2 = Instant::now();
        source.take(event);
        read_ns += (t1 - t0).as_nanos() as u64;
        decode_ns += t2.elapsed().as_nanos() as u64;
        if end {
            break;
        }
    }
    let wall = begun.elapsed().as_secs_f64();
    let capture = last.since_secs(first);
    let fused: u64 = decode.iter().sum();
    println!(
        "{name}: {packets} packets, {sweeps} sweeps of {capture:.1} s, one thread, \
         per tick at {RATE_HZ} Hz"
    );
    println!("  read the capture        {}", quantiles(read));
    println!("  decode, solve and fuse  {}", quantiles(decode));
    println!("  track (tick)            {}", quantiles(track));
    println!(
        "  a sweep {:.2} us, inertial samples and all that hangs on them included",
        fused as f64 * 1e-3 / sweeps.max(1) as f64
    );
    println!("  in all {:.1} times real time", capture / wall);
}

/// A replay at real speed whose packets are stamped as they are handed out, like live ones.
struct Paced {
    inner: Replay,
    pending: Option<Event>,
    origin: Option<(HostTime, HostTime)>,
    arrivals: Arc<Mutex<Vec<HostTime>>>,
}

impl Transport for Paced {
    fn next(&mut self, wait_ns: u64) -> Event {
        let event = self.pending.take().unwrap_or_else(|| self.inner.next(0));
        let Event::Packet(mut packet) = event else {
            return event;
        };
        let (from, start) = *self
            .origin
            .get_or_insert_with(|| (packet.at, Monotonic.now()));
        if packet.at.since_secs(from) > LIVE_S {
            return Event::End;
        }
        let due = start.plus_ns(packet.at.since_ns(from));
        let wait = due.since_ns(Monotonic.now());
        if wait > wait_ns as i64 {
            std::thread::sleep(Duration::from_nanos(wait_ns));
            self.pending = Some(Event::Packet(packet));
            return Event::Idle;
        }
        if wait > 0 {
            std::thread::sleep(Duration::from_nanos(wait.unsigned_abs()));
        }
        packet.at = Monotonic.now();
        if packet.is_input()
            && let Ok(mut arrivals) = self.arrivals.lock()
        {
            arrivals.push(packet.at);
        }
        Event::Packet(packet)
    }

    fn send(&mut self, _port: Port, _command: &Command) -> Result<(), TransportError> {
        Ok(())
    }
}

/// Source and tracker on their threads, against the real clock.
fn live(what: &str, capture: Replay, options: Options) {
    let arrivals = Arc::new(Mutex::new(Vec::with_capacity(200_000)));
    let paced = Paced {
        inner: capture,
        pending: None,
        origin: None,
        arrivals: Arc::clone(&arrivals),
    };
    let Assembly {
        source, tracker, ..
    } = assemble(Box::new(paced), options);
    let shared = Arc::new(Shared::default());
    let source = spawn_source(source, Arc::clone(&shared), |_| {}, |_| {}).expect("a thread");
    let published = Arc::new(Mutex::new(Vec::with_capacity(10_000)));
    let sink = Arc::clone(&published);
    let publish = move |pose: &posed::published::PublishedPose| {
        if let Ok(mut published) = sink.lock() {
            published.push((pose.target_at, pose.publish_at));
        }
    };
    let tracker = spawn_tracker(tracker, RATE_HZ, Arc::clone(&shared), publish).expect("a thread");
    source.join().expect("the source's thread ends well");
    shared.stop.store(true, Ordering::Relaxed);
    tracker.join().expect("the tracker's thread ends well");

    let arrivals = arrivals.lock().map(|all| all.clone()).unwrap_or_default();
    let published = published.lock().map(|all| all.clone()).unwrap_or_default();
    let mut waits = Vec::new();
    for arrival in arrivals {
        // Without look-ahead the target time is the tick's begin: what arrived before has a part.
        let pose = published.partition_point(|(tick, _)| *tick <= arrival);
        if let Some((_, publish)) = published.get(pose) {
            waits.push(publish.since_ns(arrival).unsigned_abs());
        }
    }
    let period_us = 1e6 / RATE_HZ;
    println!(
        "{what}: report in -> pose published, live threads, {RATE_HZ} Hz (a tick is {period_us:.0} us)"
    );
    println!("  {}", quantiles(waits));
    println!(
        "  {} ticks, {} began over half a period late, the latest {:.1} us late; real-time \
         priority {}",
        shared.ticks.load(Ordering::Relaxed),
        shared.late_ticks.load(Ordering::Relaxed),
        shared.lateness_max_ns.load(Ordering::Relaxed) as f64 / 1e3,
        if shared.real_time.load(Ordering::Relaxed) {
            "granted"
        } else {
            "refused"
        },
    );
}
