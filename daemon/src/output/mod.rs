//! Ways out of the daemon besides gRPC.

pub mod jsonl;
pub mod motion;
pub mod names;
pub mod osc;
pub mod vmc;
pub mod vrchat;
