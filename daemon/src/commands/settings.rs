//! From configuration and command line to what the parts are told.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use posed_body::scene::Scene;
use posed_device::{
    catalog,
    lighthouse::{self, room},
    rig,
};
use posed_signal::Serial;
use posed_tracker::{Ik, Physical, Tracker, TrackerKind, gather};

use super::CommandError;
use crate::{
    assemble::Options,
    cli::BodyArgs,
    clock::Monotonic,
    config::{self, Config},
    control::{Known, Requests},
    grpc::PoseSink,
    heights::Heights,
    models::Models,
    output,
    page::{self, Page},
    pipeline::{live::Shared, playback::Playback},
    serving::{self, Serving},
};

/// Reads the configuration's files; the command line wins over them.
///
/// # Errors
/// A file cannot be read or does not hold.
pub fn configuration(args: &BodyArgs) -> Result<Config, CommandError> {
    let mut config = config::files::load(args.config.as_deref())?;
    if let Some(height) = args.height {
        config.wearer.height_m = height;
    }
    config.wearer.avatar_height_m = args.avatar_height.or(config.wearer.avatar_height_m);
    if let Some(tracker) = args.tracker {
        config.tracker.name = tracker;
    }
    if let Some(rate) = args.rate {
        config.tracker.rate_hz = rate;
    }
    config.tracker.physics |= args.physics;
    if let Some(path) = &args.base_stations {
        config.devices.base_stations = Some(path.clone());
    }
    Ok(config)
}

/// Where recordings are written.
pub(super) fn recordings(config: &Config) -> Option<PathBuf> {
    let folder = config.recording.folder.clone();
    folder.or_else(config::files::recordings_dir)
}

/// What the parts are told by this configuration.
///
/// # Errors
/// The base stations' file cannot be read or does not hold.
pub fn options(config: &Config) -> Result<Options, CommandError> {
    let base_stations = match &config.devices.base_stations {
        Some(path) => base_stations(path)?,
        None => Vec::new(),
    };
    let room = room::Handle::default();
    room.with(|room| room.set_stature(f64::from(config.wearer.height_m)));
    let roles = config
        .devices
        .roles
        .iter()
        .map(|(serial, role)| (Serial::new(serial), *role));
    let devices = catalog::Settings {
        lighthouse: lighthouse::Settings {
            base_stations,
            room,
        },
    };
    Ok(Options {
        trackers: with_physics(trackers(config.tracker.name, &config.scene), config),
        rig: rig::Settings {
            devices,
            roles: roles.collect(),
            ..rig::Settings::default()
        },
        tracker: config.tracker.name,
        heights: heights(config),
        measure_height: config.wearer.measure_height,
        horizon_ns: (config.tracker.prediction_ms * 1e6) as i64,
    })
}

fn heights(config: &Config) -> Heights {
    Heights {
        wearer: config.wearer.height_m,
        avatar: config.wearer.avatar_height_m,
    }
}

/// Takes the room over that was kept at the last start. One that cannot be used is no reason not
/// to start: it is measured anew.
pub(super) fn take_kept_room(handle: &room::Handle, path: &Path) {
    match crate::room::load(path) {
        Ok(Some(stored)) => handle.with(|room| room.adopt(&stored)),
        Ok(None) => {
            tracing::info!("base stations are not known yet: they are found by their light");
        }
        Err(error) => tracing::warn!("{error}"),
    }
}

/// The base stations in a file.
///
/// # Errors
/// It cannot be read, or holds none.
pub(super) fn base_stations(
    path: &Path,
) -> Result<Vec<lighthouse::base_station::BaseStation>, CommandError> {
    let text = fs::read_to_string(path).map_err(|error| CommandError::file(path, error))?;
    lighthouse::base_station::parse_libsurvive(&text)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}

/// Puts physics behind the trackers, and behind `ik` if that is what was asked for. QuestSim's
/// character obeys it already, on a ground of its own.
fn with_physics(trackers: Vec<Box<dyn Tracker>>, config: &Config) -> Vec<Box<dyn Tracker>> {
    if !config.tracker.physics {
        return trackers;
    }
    let wearer = heights(config).body();
    let ik = (config.tracker.name == TrackerKind::Ik).then(|| Box::new(Ik::default()) as _);
    let physical = |inner| Physical::new(inner, &wearer, config.tracker.rate_hz);
    let all = trackers.into_iter().chain(ik);
    let one = |inner: Box<dyn Tracker>| match inner.kind() {
        TrackerKind::QuestSim => inner,
        _ => Box::new(physical(inner)),
    };
    all.map(one).collect()
}

/// Every tracker that this build has a model for; `ik` is always there besides. That `wanted`
/// cannot be had is no reason to do without a body: a warning says so, and `ik` stands in.
pub(super) fn trackers(wanted: TrackerKind, scene: &Scene) -> Vec<Box<dyn Tracker>> {
    let (trackers, warning) = match Models::load() {
        Ok(models) => gather(wanted, |kind| models.tracker(kind, scene)),
        Err(error) => gather(wanted, |_| Err(error.clone())),
    };
    if let Some(warning) = warning {
        tracing::warn!("{warning}");
    }
    trackers
}

/// Starts the gRPC server as the configuration says.
///
/// # Errors
/// A socket or a thread cannot be had.
pub(super) fn serve(
    config: &Config,
    requests: Requests,
    trackers: Vec<TrackerKind>,
) -> Result<(PoseSink, Serving), CommandError> {
    let runtime_dir = config::files::runtime_dir();
    let setup = serving::Setup {
        grpc: &config.grpc,
        runtime_dir: runtime_dir.as_deref(),
        recordings: recordings(config),
        rate_hz: config.tracker.rate_hz,
        requests,
        known: Known {
            heights: heights(config),
            tracker: config.tracker.name,
            trackers,
            objects: config.scene.objects.clone(),
        },
        clock: Arc::new(Monotonic),
    };
    Ok(Serving::start(setup)?)
}

/// What the page tells of besides poses and devices.
pub(super) enum Watched {
    /// A live tracker's ticks.
    Live(Arc<Shared>),
    /// Where a replay stands.
    Replay(Arc<Playback>),
}

/// Starts everything that poses go to besides gRPC; answers their names.
///
/// # Errors
/// An address cannot be used.
pub(super) fn outputs(
    config: &Config,
    serving: &Serving,
    watched: Watched,
    room: room::Handle,
) -> Result<Vec<String>, CommandError> {
    let runtime = serving.runtime().handle();
    let services = serving.services();
    let resets = services.control.resets();
    let mut names =
        output::start::start(runtime, &services.hub, &resets, &config.vmc, &config.vrchat)?;
    let (ticks, playback) = match watched {
        Watched::Live(ticks) => (Some(ticks), None),
        Watched::Replay(playback) => (None, Some(playback)),
    };
    let page = Page {
        services: services.clone(),
        ticks,
        playback,
        rate_hz: config.tracker.rate_hz,
        room,
    };
    names.extend(page::start(runtime, &config.page, page)?);
    Ok(names)
}
