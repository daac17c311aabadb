//! From configuration and command line to what the parts are told.

use std::{fs, path::Path};

use posed_device::{catalog, lighthouse, rig};
use posed_signal::Serial;

use super::CommandError;
use crate::{
    assemble::Options,
    cli::BodyArgs,
    config::{self, Config},
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
        rig: rig::Settings {
            devices,
            roles: roles.collect(),
            ..rig::Settings::default()
        },
        tracker: config.tracker.name,
        height: config.wearer.height_m,
        horizon_ns: (config.tracker.prediction_ms * 1e6) as i64,
        ..Options::default()
    })
}

fn base_stations(path: &Path) -> Result<Vec<lighthouse::base_station::BaseStation>, CommandError> {
    let text = fs::read_to_string(path).map_err(|error| CommandError::file(path, error))?;
    lighthouse::base_station::parse_libsurvive(&text)
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}
