//! Compiles the .proto files, without protoc.

use std::{env, error::Error, fs, path::PathBuf};

use protox::prost::Message as _;

const FILES: [&str; 6] = [
    "posed/v1/control_service.proto",
    "posed/v1/geometry.proto",
    "posed/v1/device.proto",
    "posed/v1/device_service.proto",
    "posed/v1/pose.proto",
    "posed/v1/pose_service.proto",
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=posed");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().compile_fds(descriptors)?;
    Ok(())
}
