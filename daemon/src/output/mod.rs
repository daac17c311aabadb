//! Ways out of the daemon besides gRPC.

pub mod jsonl;
