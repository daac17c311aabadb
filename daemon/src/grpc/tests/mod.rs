//! Server and client in one process, over real sockets.

mod client;
mod control;
mod fixture;
mod following;
mod services;
