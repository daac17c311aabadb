//! The daemon: configuration, the tracker thread, publishing and the services that hand poses out.

pub mod assemble;
pub mod cli;
pub mod clock;
pub mod commands;
pub mod config;
pub mod control;
pub mod follow;
pub mod grpc;
pub mod heights;
pub mod models;
pub mod notify;
pub mod output;
pub mod page;
pub mod pipeline;
pub mod postures;
pub mod published;
pub mod room;
pub mod serving;
pub mod simulated;
