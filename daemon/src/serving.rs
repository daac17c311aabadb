//! The gRPC server beside the threads that track: a runtime of its own, fed through channels.

use std::{
    io,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use posed_device::rig::DeviceInfo;
use posed_signal::{Clock, HostTime, PoseHow, time::MILLISECOND_NS};
use tokio::{runtime, sync::watch, task::JoinHandle};

use crate::{
    config::Grpc,
    control::{Control, Known, Requests},
    grpc::{self, Hub, ListenError, Listeners, PoseSink, Services},
    output::record::Recorder,
    published::DeviceState,
};

/// Threads for all clients together.
const WORKERS: usize = 2;
/// How long the server may take to say good-bye.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);
/// A device is tracked while light stood behind its last pose and that is no older.
const TRACKED_NS: i64 = 100 * MILLISECOND_NS as i64;
/// Weight of one listing in running means; listings come ten times a second.
const LISTING_WEIGHT: f32 = 0.05;

/// Why serving cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ServingError {
    /// A socket cannot be used.
    #[error(transparent)]
    Listen(#[from] ListenError),
    /// A thread cannot be started.
    #[error("the server's threads cannot be started: {0}")]
    Threads(#[from] io::Error),
}

/// What is served besides poses and devices, and to whom.
pub struct Setup<'a> {
    /// The sockets.
    pub grpc: &'a Grpc,
    /// Where sockets that have no other place are.
    pub runtime_dir: Option<&'a Path>,
    /// Where recordings are written.
    pub recordings: Option<PathBuf>,
    /// Poses a second.
    pub rate_hz: f64,
    /// The ways of requests to tracker and devices.
    pub requests: Requests,
    /// What can be asked of it, and what holds at first.
    pub known: Known,
    /// What poses' times are told by.
    pub clock: Arc<dyn Clock + Send + Sync>,
}

/// A running server.
pub struct Serving {
    runtime: runtime::Runtime,
    server: JoinHandle<()>,
    stop: watch::Sender<bool>,
    devices: watch::Sender<Vec<DeviceState>>,
    services: Services,
    names: Vec<String>,
}

impl Serving {
    /// Binds the sockets and starts to serve; the sink is the tracker thread's.
    ///
    /// # Errors
    /// A socket or a thread cannot be had.
    pub fn start(setup: Setup<'_>) -> Result<(PoseSink, Self), ServingError> {
        let listeners = Listeners::open(setup.grpc, setup.runtime_dir)?;
        let names = listeners.names().to_vec();
        let (sink, hub) = Hub::new()?;
        let (devices, devices_seen) = watch::channel(Vec::new());
        let (wearer, wearer_seen) = watch::channel(setup.known.heights.body());
        let (stop, mut stopped) = watch::channel(false);
        let control = Control::new(setup.requests, wearer, setup.known);
        let services = Services {
            recorder: Recorder::new(hub.clone(), setup.recordings, setup.rate_hz),
            hub,
            devices: devices_seen,
            wearer: wearer_seen,
            clock: setup.clock,
            control: Arc::new(control),
        };
        let runtime = runtime::Builder::new_multi_thread()
            .worker_threads(WORKERS)
            .thread_name("grpc")
            .enable_all()
            .build()?;
        runtime.spawn(tell_measured(services.clone()));
        let served = services.clone();
        let server = runtime.spawn(async move {
            let shutdown = async move {
                let _ = stopped.wait_for(|stop| *stop).await;
            };
            if let Err(error) = grpc::serve(served, listeners, shutdown).await {
                tracing::error!(%error, "the gRPC server ended");
            }
        });
        Ok((
            sink,
            Self {
                runtime,
                server,
                stop,
                devices,
                services,
                names,
            },
        ))
    }

    /// Where clients can connect, for people.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The runtime, for other outputs.
    #[must_use]
    pub fn runtime(&self) -> &runtime::Runtime {
        &self.runtime
    }

    /// The way to tell clients of the devices.
    #[must_use]
    pub fn devices(&self) -> watch::Sender<Vec<DeviceState>> {
        self.devices.clone()
    }

    /// What is served, for other outputs.
    #[must_use]
    pub fn services(&self) -> &Services {
        &self.services
    }

    /// Ends every stream, waits for `last`, and gives the sockets back.
    pub fn stop<T>(self, last: impl Future<Output = T>) -> T {
        self.stop.send_replace(true);
        if let Ok(recording) = self.services.recorder.stop() {
            tracing::info!("recorded {}", recording.path.display());
        }
        let server = self.server;
        let answer = self.runtime.block_on(async {
            let _ = tokio::time::timeout(STOP_TIMEOUT, server).await;
            last.await
        });
        self.runtime.shutdown_timeout(STOP_TIMEOUT);
        answer
    }
}

/// Tells everybody of a height that the tracker loop has measured.
async fn tell_measured(services: Services) {
    let (mut changes, mut last) = (services.hub.changes(), None);
    while changes.changed().await.is_ok() {
        let measured = services.hub.latest().and_then(|pose| pose.measured_m);
        if measured != last {
            last = measured;
            measured
                .into_iter()
                .for_each(|metres| services.control.measured(metres));
        }
    }
}

/// Makes device states out of the rig's listings, with rates and shares that need a past.
#[derive(Debug, Default)]
pub struct Listing {
    past: Vec<Past>,
    last: Option<HostTime>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Past {
    samples: u64,
    rate_hz: f32,
    share: f32,
    seen: bool,
}

impl Listing {
    /// The states at `now`.
    pub fn states(&mut self, devices: &[DeviceInfo], now: HostTime) -> Vec<DeviceState> {
        let seconds = self.last.map_or(0.0, |last| now.since_secs(last)) as f32;
        self.last = Some(now);
        self.past.resize(devices.len(), Past::default());
        let pairs = devices.iter().zip(&mut self.past);
        pairs
            .map(|(device, past)| state(device, past, now, seconds))
            .collect()
    }
}

fn state(device: &DeviceInfo, past: &mut Past, now: HostTime, seconds: f32) -> DeviceState {
    let counters = &device.counters;
    let fresh = |pose: &posed_signal::Pose| {
        pose.how == PoseHow::Optical && now.since_ns(pose.at) < TRACKED_NS
    };
    let tracked = f32::from(u8::from(device.pose.as_ref().is_some_and(fresh)));
    if seconds > 0.0 {
        let rate = (counters.samples - past.samples.min(counters.samples)) as f32 / seconds;
        let weight = if past.seen { LISTING_WEIGHT } else { 1.0 };
        past.rate_hz += (rate - past.rate_hz) * weight;
        past.share += (tracked - past.share) * weight;
        past.seen = true;
    }
    past.samples = counters.samples;
    DeviceState {
        id: device.id,
        serial: device.identity.serial,
        model: device.identity.model.to_owned(),
        role: device.role,
        connected: device.connected,
        battery: device.battery,
        radio: device.radio,
        rate_hz: past.rate_hz,
        tracked_share: past.share,
        packets: counters.packets,
        errors: counters.decode_errors,
        dropped: counters.dropped,
        has_haptics: device.identity.has_haptics,
        haptics: counters.haptics,
        haptics_dropped: counters.haptics_dropped,
        troubles: device.troubles.clone(),
        pose: device.pose,
    }
}
