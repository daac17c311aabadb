//! `posed replay`.

use std::{fs::File, io::BufReader, path::Path, sync::Arc};

use indicatif::{ProgressBar, ProgressStyle};
use posed_device::{
    capture::{self, identity},
    rig::DeviceInfo,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{Clock as _, DeviceId, HostTime, Pose, Sample, time::SECOND_NS};
use posed_tracker::Wearer;
use tokio::sync::watch;

use super::{CommandError, Report, Tally, settings};
use crate::{
    assemble::{Assembly, assemble},
    cli::{OutputArgs, ReplayArgs, Speed},
    clock::{Monotonic, sleep_until},
    config,
    grpc::PoseSink,
    output::jsonl::JsonLines,
    pipeline::{
        replay::{Watcher, replay},
        source::Source,
    },
    published::{DeviceState, PublishedPose},
    serving::{Listing, Serving},
};

/// Devices are listed once in so many poses.
const LISTING_POSES: u64 = 9;

/// Opens a capture, and the `.usbdevs` file beside it where there is one.
///
/// # Errors
/// The capture cannot be opened, or is none.
pub fn recording(path: &Path) -> Result<Recording, CommandError> {
    let file = File::open(path).map_err(|error| CommandError::file(path, error))?;
    let reader = capture::open(BufReader::with_capacity(1 << 16, file))
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))?;
    Ok(Recording {
        name: path.display().to_string(),
        reader,
        devices: identities_beside(path),
    })
}

/// `NAME.usbdevs` beside `NAME.pcap.gz`, as libsurvive writes it.
pub(super) fn identities_beside(
    path: &Path,
) -> Vec<(posed_device::usb::Port, posed_device::usb::UsbId)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.split(".pcap").next().unwrap_or(&name);
    let beside = path.with_file_name(format!("{stem}.usbdevs"));
    std::fs::read_to_string(beside)
        .map_or_else(|_| Vec::new(), |text| identity::parse_usbdevs(&text))
}

/// Replays the captures and prints what came of them.
///
/// # Errors
/// A capture or the configuration cannot be read, or an output cannot be written.
pub fn run(args: &ReplayArgs) -> Result<(), CommandError> {
    let config = settings::configuration(&args.body)?;
    let options = settings::options(&config)?;
    let recordings = args
        .files
        .iter()
        .map(|path| recording(path))
        .collect::<Result<Vec<_>, _>>()?;
    let transport = Replay::new(recordings, Merge::OneSession);
    let Assembly {
        mut source,
        mut tracker,
        requests: _requests,
    } = assemble(Box::new(transport), options);

    let mut watcher = Outputs::new(&args.output, args.speed)?;
    let mut serving = None;
    if args.serve {
        let wearer = Wearer::of_height(config.wearer.height_m);
        let runtime_dir = config::files::runtime_dir();
        let (sink, server) = Serving::start(
            &config.grpc,
            runtime_dir.as_deref(),
            wearer,
            Arc::new(Monotonic),
        )?;
        for name in server.names() {
            tracing::info!("serving on {name}");
        }
        let speed = match args.speed {
            Speed::Times(speed) => speed,
            Speed::Max => 1.0,
        };
        watcher.broadcast = Some(Broadcast::new(speed, sink, server.devices()));
        serving = Some(server);
    }
    let begun = Monotonic.now();
    let span = replay(
        &mut source,
        &mut tracker,
        config.tracker.rate_hz,
        &mut watcher,
    );
    let wall_s = Monotonic.now().since_secs(begun);
    let report = watcher.finish(source.rig().devices(), span.seconds(), wall_s)?;
    if let Some(server) = serving {
        server.stop(async {});
    }
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&report).map_err(std::io::Error::from)?
        );
    } else {
        print!("{}", report.text());
    }
    Ok(())
}

/// Holds a replay back to real time.
#[derive(Debug, Clone, Copy)]
pub struct Pacer {
    speed: f64,
    /// Capture time and real time of the start.
    origin: Option<(HostTime, HostTime)>,
}

impl Pacer {
    /// `speed` times real time.
    #[must_use]
    pub fn new(speed: f64) -> Self {
        Self {
            speed,
            origin: None,
        }
    }

    /// The real time that belongs to a time of the capture; the first one asked for is now.
    pub fn real(&mut self, time: HostTime) -> HostTime {
        let (from, start) = *self.origin.get_or_insert_with(|| (time, Monotonic.now()));
        start.plus_secs(time.since_secs(from) / self.speed)
    }

    /// Waits for that time.
    pub fn wait(&mut self, time: HostTime) {
        let real = self.real(time);
        sleep_until(&Monotonic, real);
    }
}

/// Serves a replay: its poses go out with the real clock's times, so that clients can tell how
/// old they are.
pub struct Broadcast {
    pacer: Pacer,
    sink: PoseSink,
    devices: watch::Sender<Vec<DeviceState>>,
    listing: Listing,
}

impl Broadcast {
    /// `speed` times real time.
    #[must_use]
    pub fn new(speed: f64, sink: PoseSink, devices: watch::Sender<Vec<DeviceState>>) -> Self {
        Self {
            pacer: Pacer::new(speed),
            sink,
            devices,
            listing: Listing::default(),
        }
    }

    /// Waits until a time of the capture is due.
    pub fn wait(&mut self, time: HostTime) {
        self.pacer.wait(time);
    }

    /// Serves a pose, and now and then the devices.
    pub fn pose(&mut self, pose: &PublishedPose, source: &Source) {
        let mut served = *pose;
        served.target_at = self.pacer.real(pose.target_at);
        // Zero says that there is no headset yet; that is no time.
        if pose.sample_at > HostTime(0) {
            served.sample_at = self.pacer.real(pose.sample_at);
        }
        for part in &mut served.parts {
            *part = part.map(|part| Pose {
                at: self.pacer.real(part.at),
                ..part
            });
        }
        served.publish_at = Monotonic.now();
        self.sink.publish(&served);
        if pose.sequence.is_multiple_of(LISTING_POSES) {
            let devices = source.rig().devices();
            self.devices
                .send_replace(self.listing.states(devices, pose.target_at));
        }
    }
}

/// Everything that a replay writes.
struct Outputs {
    pacer: Option<Pacer>,
    broadcast: Option<Broadcast>,
    poses: Option<JsonLines>,
    devices: Option<JsonLines>,
    pending: Vec<(DeviceId, posed_signal::Pose)>,
    tally: Tally,
    progress: ProgressBar,
    first: Option<HostTime>,
}

impl Outputs {
    fn new(args: &OutputArgs, speed: Speed) -> Result<Self, CommandError> {
        let create = |path: &Option<std::path::PathBuf>| {
            path.as_deref()
                .map(|path| {
                    JsonLines::create(path).map_err(|error| CommandError::file(path, error))
                })
                .transpose()
        };
        let style = ProgressStyle::with_template("{spinner} {msg}");
        let progress = ProgressBar::new_spinner();
        if let Ok(style) = style {
            progress.set_style(style);
        }
        Ok(Self {
            pacer: match speed {
                Speed::Times(speed) => Some(Pacer::new(speed)),
                Speed::Max => None,
            },
            broadcast: None,
            poses: create(&args.poses)?,
            devices: create(&args.devices)?,
            pending: Vec::new(),
            tally: Tally::default(),
            progress,
            first: None,
        })
    }

    fn finish(
        self,
        devices: &[DeviceInfo],
        capture_s: f64,
        wall_s: f64,
    ) -> Result<Report, CommandError> {
        self.progress.finish_and_clear();
        for output in [self.poses, self.devices].into_iter().flatten() {
            output.finish()?;
        }
        Ok(self.tally.report(devices, capture_s, wall_s))
    }
}

impl Watcher for Outputs {
    fn pace(&mut self, time: HostTime) -> bool {
        if let Some(pacer) = &mut self.pacer {
            pacer.wait(time);
        }
        true
    }

    fn sample(&mut self, device: DeviceId, sample: &Sample) {
        if let (Some(_), Sample::Pose(pose)) = (&self.devices, sample) {
            self.pending.push((device, *pose));
        }
    }

    fn pose(&mut self, pose: &PublishedPose, source: &Source) {
        self.tally.pose(pose);
        if let Some(broadcast) = &mut self.broadcast {
            broadcast.pose(pose, source);
        }
        if let Some(output) = &mut self.poses {
            output.line(pose);
        }
        if let Some(output) = &mut self.devices {
            let devices = source.rig().devices();
            for (id, pose) in self.pending.drain(..) {
                if let Some(device) = devices.get(usize::from(id.0)) {
                    output.device(&device.identity.serial, device.role, &pose);
                }
            }
        }
        let first = *self.first.get_or_insert(pose.target_at);
        if pose.sequence.is_multiple_of(90) {
            let seconds = pose.target_at.since_ns(first) / SECOND_NS as i64;
            self.progress
                .set_message(format!("{seconds} s replayed, {}", pose.quality.name()));
            self.progress.tick();
        }
    }

    fn warning(&mut self, text: &str) {
        self.progress.suspend(|| eprintln!("warning: {text}"));
    }
}
