//! Witnesses (C2SP tlog-witness): who cosigns a log's checkpoints only while it goes on from the last one seen.
//!
//! A log that shows different people different histories needs its witnesses' help for it; a verifier that asks for a quorum
//! of them (`crate::format::policy`) is safe from a split view. [`Witness`] is the witness without any network;
//! [`server`] puts it on HTTP; [`client`] is the log's side, which asks witnesses for cosignatures. [`plain_http`] is the bounded
//! HTTP server below it, which the daemon serves its public files with as well.
//!
//! The protocol is followed as of tlog-witness v1.0.0, with what its text clarifies since, and one key type: Ed25519
//! cosignatures (0x04). `sign-subtree`, which is optional, is not offered.

#[cfg(feature = "witness-client")]
pub mod client;
mod cosigner;
mod evidence;
#[cfg(feature = "witness-server")]
pub mod plain_http;
pub mod request;
#[cfg(feature = "witness-server")]
pub mod server;
mod state;

#[cfg(feature = "witness-client")]
pub use client::{WitnessClient, WitnessError, collect};
pub use cosigner::{Clock, OpenError, Response, Witness};
pub use request::{AddCheckpoint, RequestError};
