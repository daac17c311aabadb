//! Where the configuration files and the runtime directory are (XDG Base Directory
//! Specification 0.8). The environment is read here.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
};

use super::{Config, ConfigError, Layer, parse};

/// The machine's file.
pub const SYSTEM_FILE: &str = "/etc/posed/posed.toml";

/// Reads the machine's file, the user's, and `explicit`, and merges them in this order.
///
/// # Errors
/// `explicit` does not exist, a file that exists cannot be read, or [`parse`] fails.
pub fn load(explicit: Option<&Path>) -> Result<Config, ConfigError> {
    parse(&layers(
        Path::new(SYSTEM_FILE),
        user_file().as_deref(),
        explicit,
    )?)
}

/// The user's file: `posed/posed.toml` under `XDG_CONFIG_HOME` or `~/.config`.
#[must_use]
pub fn user_file() -> Option<PathBuf> {
    let home = || Some(absolute("HOME")?.join(".config"));
    Some(
        absolute("XDG_CONFIG_HOME")
            .or_else(home)?
            .join("posed/posed.toml"),
    )
}

/// The directory for sockets: `posed` under `XDG_RUNTIME_DIR`; `None` where that is not set.
#[must_use]
pub fn runtime_dir() -> Option<PathBuf> {
    Some(absolute("XDG_RUNTIME_DIR")?.join("posed"))
}

/// The directory for what is kept between starts: `posed` under `XDG_STATE_HOME` or
/// `~/.local/state`; `None` where neither is set.
#[must_use]
pub fn state_dir() -> Option<PathBuf> {
    let home = || Some(absolute("HOME")?.join(".local/state"));
    Some(absolute("XDG_STATE_HOME").or_else(home)?.join("posed"))
}

/// Where recordings are written by default: `recordings` in the state directory.
#[must_use]
pub fn recordings_dir() -> Option<PathBuf> {
    Some(state_dir()?.join("recordings"))
}

/// The gRPC socket of a posed that runs with the default configuration.
#[must_use]
pub fn socket() -> Option<PathBuf> {
    Some(runtime_dir()?.join("posed.sock"))
}

/// The specification says that relative paths in these variables are to be ignored.
fn absolute(variable: &str) -> Option<PathBuf> {
    env::var_os(variable)
        .map(PathBuf::from)
        .filter(|path| path.is_absolute())
}

fn layers(
    system: &Path,
    user: Option<&Path>,
    explicit: Option<&Path>,
) -> Result<Vec<Layer>, ConfigError> {
    let mut layers = Vec::new();
    for path in [Some(system), user].into_iter().flatten() {
        match fs::read_to_string(path) {
            Ok(text) => layers.push(Layer {
                origin: path.display().to_string(),
                text,
            }),
            // Nobody has to have one.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(source) => {
                return Err(ConfigError::Read {
                    path: path.into(),
                    source,
                });
            }
        }
    }
    if let Some(path) = explicit {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Read {
            path: path.into(),
            source,
        })?;
        layers.push(Layer {
            origin: path.display().to_string(),
            text,
        });
    }
    Ok(layers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_need_not_exist_may_be_missing_and_others_may_not() {
        let folder = tempfile::tempdir().unwrap();
        let (system, user) = (folder.path().join("system"), folder.path().join("user"));
        assert!(layers(&system, Some(&user), None).unwrap().is_empty());

        fs::write(&user, "[wearer]\nheight_m = 1.6\n").unwrap();
        let found = layers(&system, Some(&user), Some(&user)).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].origin, user.display().to_string());

        let missing = layers(&system, Some(&user), Some(&system))
            .unwrap_err()
            .to_string();
        assert!(missing.contains("system: cannot be read"), "{missing}");
        let folder_as_file = layers(folder.path(), None, None).unwrap_err().to_string();
        assert!(
            folder_as_file.contains("cannot be read"),
            "{folder_as_file}"
        );
    }
}
