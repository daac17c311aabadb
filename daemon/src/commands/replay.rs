//! `posed replay`.

use std::{
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use indicatif::{ProgressBar, ProgressStyle};
use posed_device::{
    capture::{self, identity},
    rig::DeviceInfo,
    transport::{Merge, Recording, Replay},
};
use posed_signal::{Clock as _, DeviceId, HostTime, Sample, time::SECOND_NS};

use super::{
    CommandError, Report, Tally,
    broadcast::{self, Broadcast, Open, Pacer},
    live, settings,
};
use crate::{
    assemble::{Assembly, assemble},
    cli::{Calibration, OutputArgs, ReplayArgs, Speed},
    clock::Monotonic,
    output::jsonl::JsonLines,
    pipeline::{
        playback::Playback,
        replay::{Watcher, replay},
        source::Source,
        tracking::Request,
    },
    published::PublishedPose,
};

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
    let open = opener(args.files.clone());
    let rig = options.rig.clone();
    let trackers = options.choices();
    let Assembly {
        mut source,
        mut tracker,
        requests,
    } = assemble(open()?, options);

    let mut watcher = Outputs::new(&args.output, args.speed)?;
    let calibrations = args.calibrate.clone();
    let mut serving = None;
    if args.serve {
        let (sink, server) = settings::serve(&config, requests, trackers)?;
        let playback = Arc::new(Playback::default());
        broadcast::measure(&open, &playback)?;
        let watched = settings::Watched::Replay(Arc::clone(&playback));
        let outputs = settings::outputs(
            &config,
            &server,
            watched,
            rig.devices.lighthouse.room.clone(),
        )?;
        for name in server.names().iter().chain(&outputs) {
            tracing::info!("serving on {name}");
        }
        let speed = watcher.pacer.take().map(Pacer::speed);
        watcher.broadcast = Some(Broadcast::new(speed, sink, &server, playback));
        watcher.stop = Some(live::stop_flag()?);
        let control = Arc::clone(&server.services().control);
        let ask = move |request| {
            if let Err(refusal) = control.request(request) {
                tracing::warn!("not calibrated: {refusal}");
            }
        };
        watcher.calibrations = Some(Calibrations::new(calibrations, ask));
        serving = Some(server);
    } else {
        let mut requests = requests;
        let ask = move |request| {
            requests.tracker.push(request);
        };
        watcher.calibrations = Some(Calibrations::new(calibrations, ask));
    }
    let begun = Monotonic.now();
    let rate_hz = config.tracker.rate_hz;
    let mut span = replay(&mut source, &mut tracker, rate_hz, &mut watcher);
    while let Some(server) = serving.as_ref().filter(|_| watcher.goes_on(args.again)) {
        let control = &server.services().control;
        (source, tracker) = broadcast::renew(&open, rig.clone(), tracker, control)?;
        span = replay(&mut source, &mut tracker, rate_hz, &mut watcher);
    }
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

/// Opens captures as one session.
fn opener(files: Vec<PathBuf>) -> Open {
    Arc::new(move || {
        let recordings = files.iter().map(|path| recording(path));
        let recordings = recordings.collect::<Result<Vec<_>, _>>()?;
        Ok(Box::new(Replay::new(recordings, Merge::OneSession)))
    })
}

/// Asks for calibrations when their time has come.
struct Calibrations {
    /// The next one last.
    waiting: Vec<Calibration>,
    ask: Box<dyn FnMut(Request)>,
    start: Option<HostTime>,
}

impl Calibrations {
    fn new(mut waiting: Vec<Calibration>, ask: impl FnMut(Request) + 'static) -> Self {
        waiting.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        Self {
            waiting,
            ask: Box::new(ask),
            start: None,
        }
    }

    fn tick(&mut self, time: HostTime) {
        let start = *self.start.get_or_insert(time);
        let passed = time.since_secs(start);
        while let Some(due) = self.waiting.pop_if(|next| next.seconds <= passed) {
            (self.ask)(Request::Calibrate(due.stance));
        }
    }
}

/// Everything that a replay writes.
struct Outputs {
    pacer: Option<Pacer>,
    broadcast: Option<Broadcast>,
    /// Set by Ctrl-C, which otherwise ends the process.
    stop: Option<Arc<AtomicBool>>,
    calibrations: Option<Calibrations>,
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
            stop: None,
            calibrations: None,
            poses: create(&args.poses)?,
            devices: create(&args.devices)?,
            pending: Vec::new(),
            tally: Tally::default(),
            progress,
            first: None,
        })
    }

    /// After a pass over the capture: whether there is another.
    fn goes_on(&mut self, again: bool) -> bool {
        let stopped = self.stop.as_ref();
        let stopped = stopped.is_some_and(|stop| stop.load(Ordering::Relaxed));
        let broadcast = self.broadcast.as_mut();
        !stopped && broadcast.is_some_and(|broadcast| broadcast.rewind(again))
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
        let stop = self.stop.as_deref();
        let stops = || stop.is_some_and(|stop| stop.load(Ordering::Relaxed));
        if let Some(calibrations) = &mut self.calibrations {
            calibrations.tick(time);
        }
        match &mut self.broadcast {
            Some(broadcast) => broadcast.wait(time, stops),
            None => true,
        }
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
