//! The daemon: configuration, the tracker thread, publishing and the services that hand poses out.

pub mod clock;
pub mod config;
pub mod published;
