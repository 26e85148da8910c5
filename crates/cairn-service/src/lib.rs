//! Cairn as a library: the data folder, trainings, queries, records, and the gRPC handlers over them.

pub mod auth;
pub mod config;
pub mod engine;
pub mod error;
pub mod export;
pub mod grpc;
pub mod query;
pub mod records;
pub mod secrets;
pub mod store;
pub mod train;
