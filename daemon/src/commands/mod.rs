//! The commands of the command line, one file each.

mod broadcast;
pub mod control;
pub mod demo;
pub mod eval;
pub mod export;
pub mod follow;
pub mod inspect;
pub mod list;
mod live;
pub mod record;
pub mod replay;
pub mod run;
mod settings;
pub mod setup;
pub mod simulate;
mod summary;
pub mod survey;
pub mod vibrate;

use std::{io, path::Path};

pub use summary::{DeviceReport, Report, Tally};

use crate::config::ConfigError;

/// Why a command failed, in words for the person who gave it.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// About the configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// About a file.
    #[error("{path}: {error}")]
    File {
        /// Its name.
        path: String,
        /// What went wrong.
        error: io::Error,
    },
    /// About the server.
    #[error(transparent)]
    Serving(#[from] crate::serving::ServingError),
    /// About the live page.
    #[error(transparent)]
    Page(#[from] crate::page::PageError),
    /// About following.
    #[error(transparent)]
    Follow(#[from] crate::follow::FollowError),
    /// About an address.
    #[error(transparent)]
    Address(#[from] crate::config::NotLoopback),
    /// About the room that is kept.
    #[error(transparent)]
    Room(#[from] crate::room::RoomError),
    /// About the content of an input.
    #[error("{0}")]
    Input(String),
    /// About anything else that the operating system refused.
    #[error("{0}")]
    Io(#[from] io::Error),
}

impl CommandError {
    fn file(path: &Path, error: io::Error) -> Self {
        Self::File {
            path: path.display().to_string(),
            error,
        }
    }
}
