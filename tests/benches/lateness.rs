//! How late the tracker's ticks begin, without any output and with all of them.
//!
//! Source and tracker run on their threads at 90 Hz, as live, over the embedded capture. The
//! outputs are gRPC with 32 clients that follow every pose, VMC, VRChat, the live page and a
//! recording. Ticks lie on a grid; where most of them begin shows where.

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::Duration,
};

use posed::{
    assemble::{Assembly, assemble},
    clock::Monotonic,
    commands::demo,
    config::{self, Grpc, Loopback, UnixSocket},
    control::{Known, Requests},
    follow::{Follower, Late, Server},
    grpc::PoseSink,
    heights::Heights,
    output::{
        export,
        record::{Format, Wish},
        start::start,
    },
    page::{self, Page},
    pipeline::live::{Shared, spawn_source, spawn_tracker},
    published::PublishedPose,
    serving::{Serving, Setup},
};
use posed_device::{
    decode::Command,
    transport::{Event, Replay, Transport, TransportError},
    usb::Port,
};
use posed_signal::{Clock as _, HostTime, time::SECOND_NS};
use posed_tracker::TrackerKind;

const RATE_HZ: f64 = 90.0;
const FOLLOWERS: usize = 32;
/// Seconds of each measurement; where the capture ends, the tracker goes on without it.
const SECONDS: u64 = 30;

fn main() {
    // `cargo test --benches` runs this too; there is nothing to measure then.
    if std::env::args().any(|argument| argument == "--test") {
        return;
    }
    println!("lateness of ticks, {RATE_HZ} Hz, {SECONDS} s each");
    let (begins, shared) = ticks(None);
    print("no output", &begins, &shared);
    let received = Arc::new(AtomicU64::new(0));
    let (begins, shared) = ticks(Some(&received));
    print("every output and 32 followers", &begins, &shared);
    let share = received.load(Ordering::Relaxed) as f64 / (begins.len() * FOLLOWERS) as f64;
    println!("  followers got {:.1} % of the poses", share * 100.0);
}

/// Runs source and tracker; answers when each tick began.
fn ticks(outputs: Option<&Arc<AtomicU64>>) -> (Vec<HostTime>, Arc<Shared>) {
    let options = demo::options();
    let transport = Paced {
        inner: demo::replay().expect("the embedded capture can be read"),
        pending: None,
        origin: None,
    };
    let Assembly {
        source,
        tracker,
        requests,
    } = assemble(Box::new(transport), options);
    let (mut sink, outputs) = outputs
        .map(|received| Outputs::start(requests, received))
        .unzip();
    let begins = Arc::new(Mutex::new(Vec::with_capacity(10_000)));
    let noted = Arc::clone(&begins);
    let publish = move |pose: &PublishedPose| {
        if let Some(sink) = &mut sink {
            sink.publish(pose);
        }
        // Without look-ahead the target time is the tick's begin. Nobody else holds the lock.
        if let Ok(mut begins) = noted.lock() {
            begins.push(pose.target_at);
        }
    };
    let shared = Arc::new(Shared::default());
    let source = spawn_source(source, Arc::clone(&shared), |_| {}, |_| {}).expect("a thread");
    let tracker = spawn_tracker(tracker, RATE_HZ, Arc::clone(&shared), publish).expect("a thread");
    thread::sleep(Duration::from_secs(SECONDS));
    shared.stop.store(true, Ordering::Relaxed);
    source.join().expect("the source's thread ends well");
    tracker.join().expect("the tracker's thread ends well");
    drop(outputs);
    let begins = begins
        .lock()
        .map(|begins| begins.clone())
        .unwrap_or_default();
    (begins, shared)
}

fn print(what: &str, begins: &[HostTime], shared: &Shared) {
    let period_ns = (SECOND_NS as f64 / RATE_HZ) as i64;
    let Some(first) = begins.first() else {
        println!("  {what}: no tick");
        return;
    };
    let since: Vec<i64> = begins.iter().map(|begin| begin.since_ns(*first)).collect();
    // Most ticks begin at their time, a late one up to two thirds of a tick after it.
    let mut phases: Vec<i64> = since.iter().map(|ns| ns.rem_euclid(period_ns)).collect();
    phases.sort_unstable();
    let usual = *phases
        .windows(phases.len() / 2 + 1)
        .min_by_key(|half| half[half.len() - 1] - half[0])
        .map_or(&0, |half| &half[0]);
    let early = usual - period_ns / 3;
    let mut late: Vec<i64> = since
        .iter()
        .map(|ns| (ns - early).rem_euclid(period_ns) + early)
        .collect();
    late.sort_unstable();
    let at = |share: f64| (late[((late.len() - 1) as f64 * share) as usize] - late[0]) as f64 / 1e3;
    let slots: Vec<i64> = since
        .iter()
        .map(|ns| (ns - early).div_euclid(period_ns))
        .collect();
    let missed: i64 = slots.windows(2).map(|pair| pair[1] - pair[0] - 1).sum();
    println!(
        "  {what}: p50 {:.0} us, p99 {:.0} us, p99.9 {:.0} us, latest {:.0} us; {} ticks, {} \
         missed; real-time priority {}",
        at(0.5),
        at(0.99),
        at(0.999),
        shared.lateness_max_ns.load(Ordering::Relaxed) as f64 / 1e3,
        begins.len(),
        missed,
        if shared.real_time.load(Ordering::Relaxed) {
            "granted"
        } else {
            "refused"
        },
    );
}

/// The embedded capture at real speed, and silence after it.
struct Paced {
    inner: Replay,
    pending: Option<Event>,
    origin: Option<(HostTime, HostTime)>,
}

impl Transport for Paced {
    fn next(&mut self, wait_ns: u64) -> Event {
        let event = self.pending.take().unwrap_or_else(|| self.inner.next(0));
        let mut packet = match event {
            Event::Packet(packet) => packet,
            Event::End => {
                thread::sleep(Duration::from_nanos(wait_ns));
                self.pending = Some(Event::End);
                return Event::Idle;
            }
            other => return other,
        };
        let (from, start) = *self
            .origin
            .get_or_insert_with(|| (packet.at, Monotonic.now()));
        let due = start.plus_ns(packet.at.since_ns(from));
        let wait = due.since_ns(Monotonic.now());
        if wait > wait_ns as i64 {
            thread::sleep(Duration::from_nanos(wait_ns));
            self.pending = Some(Event::Packet(packet));
            return Event::Idle;
        }
        if wait > 0 {
            thread::sleep(Duration::from_nanos(wait.unsigned_abs()));
        }
        packet.at = Monotonic.now();
        Event::Packet(packet)
    }

    fn send(&mut self, _port: Port, _command: &Command) -> Result<(), TransportError> {
        Ok(())
    }
}

/// Everything that poses go to, and 32 clients; all end when this is dropped.
struct Outputs {
    serving: Option<Serving>,
    _clients: tokio::runtime::Runtime,
    _folder: tempfile::TempDir,
}

impl Outputs {
    fn start(requests: Requests, received: &Arc<AtomicU64>) -> (PoseSink, Self) {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = folder.path().join("posed.sock");
        let grpc = Grpc {
            unix: UnixSocket::At(socket.clone()),
            tcp: None::<Loopback>,
        };
        let setup = Setup {
            grpc: &grpc,
            runtime_dir: None,
            recordings: Some(folder.path().into()),
            rate_hz: RATE_HZ,
            requests,
            known: Known {
                heights: Heights::of(demo::HEIGHT),
                tracker: TrackerKind::Ik,
                trackers: vec![TrackerKind::Ik],
                objects: Vec::new(),
            },
            clock: Arc::new(Monotonic),
        };
        let (sink, serving) = Serving::start(setup).expect("a socket");
        start_outputs(&serving);
        let clients = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .expect("threads");
        for _ in 0..FOLLOWERS {
            let (server, received) = (Server::Unix(socket.clone()), Arc::clone(received));
            clients.spawn(async move {
                let followed = Follower::connect(&server, Monotonic, Late::CatchUp).await;
                let mut follower = followed.expect("the server answers");
                while let Ok(Some(_)) = follower.next().await {
                    received.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let outputs = Self {
            serving: Some(serving),
            _clients: clients,
            _folder: folder,
        };
        (sink, outputs)
    }
}

/// VMC, VRChat, the page and a recording.
fn start_outputs(serving: &Serving) {
    let services = serving.services();
    let runtime = serving.runtime().handle();
    // Nobody listens there; sending costs the same.
    let to = vec![SocketAddr::from((Ipv4Addr::LOCALHOST, 9))];
    let vmc = config::Vmc {
        to: to.clone(),
        ..config::Vmc::default()
    };
    let vrchat = config::VrChat {
        to,
        ..config::VrChat::default()
    };
    let resets = services.control.resets();
    start(runtime, &services.hub, &resets, &vmc, &vrchat).expect("UDP sockets");
    let page = Page {
        services: services.clone(),
        ticks: None,
        playback: None,
        rate_hz: RATE_HZ,
        room: Default::default(),
    };
    let any_port = config::Page {
        listen: Some((Ipv4Addr::LOCALHOST, 0).into()),
        ..config::Page::default()
    };
    page::start(runtime, &any_port, page).expect("the page's socket");
    let wish = Wish {
        format: Format::Motion(export::Format::Bvh),
        name: String::new(),
        names: None,
    };
    services.recorder.start(&wish).expect("a file");
}

impl Drop for Outputs {
    fn drop(&mut self) {
        if let Some(serving) = self.serving.take() {
            serving.stop(async {});
        }
    }
}
