//! Cairn's gRPC contract in Rust, generated from `proto/` and nothing else.
//!
//! The words are documented in the `.proto` files, which are the contract; the
//! generated code repeats their comments.

/// Version 1 of the contract.
pub mod v1 {
    #![allow(missing_docs, clippy::doc_lazy_continuation, clippy::missing_errors_doc)]
    tonic::include_proto!("cairn.v1");

    /// All messages and services, encoded as a `FileDescriptorSet`: what
    /// reflection serves.
    pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/cairn_descriptors.bin"));

    /// The full gRPC path of every method in [`FILE_DESCRIPTOR_SET`].
    pub const METHODS: &[&str] = include!(concat!(env!("OUT_DIR"), "/cairn_methods.rs"));
}
