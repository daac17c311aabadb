//! The configuration: layered TOML, every key documented in `default.toml`.
//!
//! [`parse`] is pure: texts in, a valid [`Config`] or an error that says what to change out.
//! [`files`] knows where the texts are.

mod fields;
pub mod files;
mod outputs;

use std::{collections::BTreeMap, path::PathBuf};

use posed_body::scene::{Scene, SceneError};
use posed_signal::Role;
use posed_tracker::TrackerKind;
use serde::Deserialize;

pub use fields::{Loopback, NotLoopback, UnixSocket};
pub use outputs::{Page, Recordings, Vmc, VrChat};

/// The wearer's heights that body proportions hold for, metres.
pub const HEIGHT_M: std::ops::RangeInclusive<f32> = 1.0..=2.5;
/// Poses a second.
pub const RATE_HZ: std::ops::RangeInclusive<f64> = 10.0..=1000.0;
/// How far poses may be made ahead, ms.
pub const PREDICTION_MS: std::ops::RangeInclusive<f64> = -170.0..=60.0;

/// The configuration, validated.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Who wears the headset.
    pub wearer: Wearer,
    /// What works out the body, and when.
    pub tracker: Tracker,
    /// What is known about the devices beforehand.
    pub devices: Devices,
    /// Where to serve.
    pub grpc: Grpc,
    /// The live page.
    pub page: Page,
    /// Poses for VMC receivers.
    pub vmc: Vmc,
    /// Trackers for VRChat.
    pub vrchat: VrChat,
    /// Recordings of poses.
    pub recording: Recordings,
    /// What the simulated character stands on and bumps into.
    pub scene: Scene,
    /// What to log.
    pub log: Log,
}

/// `[wearer]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wearer {
    /// Height, metres.
    pub height_m: f32,
    /// Whether the first seconds upright tell the height.
    pub measure_height: bool,
    /// Height of the body shown, metres; the wearer's own where this is left out.
    pub avatar_height_m: Option<f32>,
}

/// `[tracker]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tracker {
    /// Which tracker.
    #[serde(deserialize_with = "fields::tracker")]
    pub name: TrackerKind,
    /// Poses a second.
    pub rate_hz: f64,
    /// How far ahead of the tick poses are made for, ms; a negative number: how far behind.
    pub prediction_ms: f64,
    /// Whether physics has the last word.
    pub physics: bool,
}

/// `[devices]`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Devices {
    /// Base stations in libsurvive's JSON.
    pub base_stations: Option<PathBuf>,
    /// Roles by serial number.
    #[serde(deserialize_with = "fields::roles")]
    pub roles: BTreeMap<String, Role>,
}

/// `[grpc]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Grpc {
    /// The Unix socket.
    #[serde(deserialize_with = "fields::unix")]
    pub unix: UnixSocket,
    /// The TCP address; `None` for no TCP.
    #[serde(deserialize_with = "fields::tcp")]
    pub tcp: Option<Loopback>,
}

/// `[log]`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Log {
    /// A filter as in `RUST_LOG`.
    pub filter: String,
}

impl Default for Wearer {
    fn default() -> Self {
        Self {
            height_m: 1.75,
            measure_height: false,
            avatar_height_m: None,
        }
    }
}

impl Default for Tracker {
    fn default() -> Self {
        Self {
            name: TrackerKind::HmdNemo,
            rate_hz: 90.0,
            prediction_ms: 0.0,
            physics: false,
        }
    }
}

impl Default for Grpc {
    fn default() -> Self {
        Self {
            unix: UnixSocket::Auto,
            tcp: Some(Loopback::DEFAULT),
        }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self {
            filter: "info".into(),
        }
    }
}

/// One file's text.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Where it came from, for messages.
    pub origin: String,
    /// TOML.
    pub text: String,
}

/// What is wrong with the configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file is not TOML, or holds an unknown key or a value of the wrong kind.
    #[error("{origin}: {message}")]
    Syntax {
        /// Which file.
        origin: String,
        /// Where in it, and what is wrong.
        message: String,
    },
    /// A value is out of its range.
    #[error("{origin}: {key} = {value}: give {allowed}")]
    Range {
        /// Which file.
        origin: String,
        /// The key with its table.
        key: &'static str,
        /// Its value.
        value: String,
        /// What would be right.
        allowed: String,
    },
    /// The scene cannot be built.
    #[error("{origin}: {source}")]
    Scene {
        /// Which file.
        origin: String,
        /// What is wrong.
        source: SceneError,
    },
    /// Two devices cannot be worn at the same place.
    #[error("devices.roles: {first} and {second} are both {role}; give each role to one device")]
    RoleTwice {
        /// One serial number.
        first: String,
        /// The other.
        second: String,
        /// The role of both.
        role: Role,
    },
    /// A file cannot be read.
    #[error("{path}: cannot be read: {source}")]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// Merges `layers`, later ones over earlier ones, key by key, over the defaults.
///
/// # Errors
/// A layer is not TOML, holds an unknown key, or a value of the wrong kind or out of range; or
/// two devices have the same role.
pub fn parse(layers: &[Layer]) -> Result<Config, ConfigError> {
    let mut merged = toml::Table::new();
    for layer in layers {
        let syntax = |error: &dyn std::fmt::Display| ConfigError::Syntax {
            origin: layer.origin.clone(),
            message: error.to_string().trim_end().to_owned(),
        };
        // Each layer is checked by itself, so that a message can name the file.
        let config: Config = toml::from_str(&layer.text).map_err(|error| syntax(&error))?;
        config.check_ranges(&layer.origin)?;
        let table: toml::Table = layer.text.parse().map_err(|error| syntax(&error))?;
        if table.contains_key("scene") {
            // Half of one scene and half of another are none.
            merged.remove("scene");
        }
        merge(&mut merged, table);
    }
    let config: Config =
        merged
            .try_into()
            .map_err(|error: toml::de::Error| ConfigError::Syntax {
                origin: "all files together".into(),
                message: error.to_string(),
            })?;
    config.check_roles()?;
    config.page.check("all files together")?;
    Ok(config)
}

fn merge(into: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => merge(below, above),
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}

impl Config {
    fn check_ranges(&self, origin: &str) -> Result<(), ConfigError> {
        let fail = |key, value: String, allowed: String| {
            Err(ConfigError::Range {
                origin: origin.into(),
                key,
                value,
                allowed,
            })
        };
        let span = |unit, (low, high): (f64, f64)| format!("{unit} from {low:?} to {high:?}");
        let heights = [
            ("wearer.height_m", Some(self.wearer.height_m)),
            ("wearer.avatar_height_m", self.wearer.avatar_height_m),
        ];
        for (key, height) in heights {
            if let Some(height) = height.filter(|height| !HEIGHT_M.contains(height)) {
                let bounds = (f64::from(*HEIGHT_M.start()), f64::from(*HEIGHT_M.end()));
                return fail(key, height.to_string(), span("metres", bounds));
            }
        }
        let rate = self.tracker.rate_hz;
        if !RATE_HZ.contains(&rate) {
            let bounds = (*RATE_HZ.start(), *RATE_HZ.end());
            return fail(
                "tracker.rate_hz",
                rate.to_string(),
                span("poses a second", bounds),
            );
        }
        let ahead = self.tracker.prediction_ms;
        if !PREDICTION_MS.contains(&ahead) {
            let bounds = (*PREDICTION_MS.start(), *PREDICTION_MS.end());
            return fail(
                "tracker.prediction_ms",
                ahead.to_string(),
                span("ms", bounds),
            );
        }
        if let Some(path) = &self.devices.base_stations
            && !path.is_absolute()
        {
            let value = path.display().to_string();
            return fail("devices.base_stations", value, "an absolute path".into());
        }
        let filter = &self.log.filter;
        if tracing_subscriber::EnvFilter::try_new(filter).is_err() {
            let allowed = "error, warn, info, debug or trace, or these by module".into();
            return fail("log.filter", filter.clone(), allowed);
        }
        self.scene.validate().map_err(|source| ConfigError::Scene {
            origin: origin.into(),
            source,
        })?;
        outputs::check_rate(origin, "vmc.rate_hz", self.vmc.rate_hz)?;
        outputs::check_rate(origin, "vrchat.rate_hz", self.vrchat.rate_hz)
    }

    fn check_roles(&self) -> Result<(), ConfigError> {
        let mut taken: BTreeMap<Role, &str> = BTreeMap::new();
        for (serial, &role) in self
            .devices
            .roles
            .iter()
            .filter(|(_, role)| **role != Role::None)
        {
            if let Some(first) = taken.insert(role, serial) {
                let (first, second) = (first.to_owned(), serial.clone());
                return Err(ConfigError::RoleTwice {
                    first,
                    second,
                    role,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
