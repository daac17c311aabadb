//! The gRPC interface of posed, `posed.v1`: messages, clients and servers generated from the
//! `.proto` files beside this crate's manifest, which hold the documentation.

/// Messages and services of `posed.v1`.
pub mod v1 {
    #![allow(
        missing_docs,
        clippy::all,
        reason = "generated; the .proto files are documented"
    )]
    tonic::include_proto!("posed.v1");
}

/// The encoded `FileDescriptorSet` of `posed.v1`, comments included, for server reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
