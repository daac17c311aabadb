//! Ways out of the daemon besides gRPC.

pub mod bvh;
pub mod export;
pub mod gltf;
mod gltf_figure;
pub mod jsonl;
pub mod motion;
pub mod names;
pub mod osc;
pub mod record;
pub mod start;
pub mod vmc;
pub mod vrchat;
