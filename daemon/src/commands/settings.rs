//! From configuration and command line to what the parts are told.

use std::{fs, path::Path};

use posed_device::{catalog, lighthouse, rig};
use posed_signal::Serial;
use posed_tracker::{Ik, Physical, Tracker, TrackerKind, Wearer};

use super::CommandError;
use crate::{
    assemble::Options,
    cli::BodyArgs,
    config::{self, Config},
    models::Models,
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

/// What the parts are told by this configuration.
///
/// # Errors
/// The base stations' file cannot be read or does not hold.
pub fn options(config: &Config) -> Result<Options, CommandError> {
    let base_stations = match &config.devices.base_stations {
        Some(path) => base_stations(path)?,
        None => {
            tracing::warn!(
                "no base stations are known, so that headset and controllers get no position: \
                 name their file by --base-stations or devices.base_stations"
            );
            Vec::new()
        }
    };
    let roles = config
        .devices
        .roles
        .iter()
        .map(|(serial, role)| (Serial::new(serial), *role));
    let devices = catalog::Settings {
        lighthouse: lighthouse::Settings { base_stations },
    };
    Ok(Options {
        trackers: with_physics(trackers(config.tracker.name), config),
        rig: rig::Settings {
            devices,
            roles: roles.collect(),
            ..rig::Settings::default()
        },
        tracker: config.tracker.name,
        height: config.wearer.height_m,
        horizon_ns: (config.tracker.prediction_ms * 1e6) as i64,
    })
}

fn base_stations(path: &Path) -> Result<Vec<lighthouse::base_station::BaseStation>, CommandError> {
    let text = fs::read_to_string(path).map_err(|error| CommandError::file(path, error))?;
    lighthouse::base_station::parse_libsurvive(&text)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}

/// Puts physics behind the trackers, and behind `ik` if that is what was asked for.
fn with_physics(trackers: Vec<Box<dyn Tracker>>, config: &Config) -> Vec<Box<dyn Tracker>> {
    if !config.tracker.physics {
        return trackers;
    }
    let wearer = Wearer::of_height(config.wearer.height_m);
    let ik = (config.tracker.name == TrackerKind::Ik).then(|| Box::new(Ik::default()) as _);
    let physical = |inner| Physical::new(inner, &wearer, config.tracker.rate_hz);
    let all = trackers.into_iter().chain(ik);
    all.map(|inner| Box::new(physical(inner)) as _).collect()
}

/// The tracker asked for, unless it is `ik`, which is always there. One that cannot be had is no
/// reason to do without a body: a warning says so, and `ik` stands in.
pub(super) fn trackers(kind: TrackerKind) -> Vec<Box<dyn Tracker>> {
    if kind == TrackerKind::Ik {
        return Vec::new();
    }
    match Models::load().and_then(|models| models.tracker(kind)) {
        Ok(Some(tracker)) => vec![tracker],
        Ok(None) => {
            tracing::warn!(
                "this build has no model for the tracker {}: ik stands in",
                kind.name()
            );
            Vec::new()
        }
        Err(error) => {
            tracing::warn!(
                "the tracker {} cannot be used, ik stands in: {error}",
                kind.name()
            );
            Vec::new()
        }
    }
}
