//! The registry: takes owner records into an append-only log and vouches for it.
//!
//! Life of a record: **accepted** (its envelope and rules hold), **durable** (flushed
//! to the store, and then acknowledged under a signed checkpoint), **published** (that checkpoint, and the tiles
//! under it, are in the files that monitors read). Nothing is
//! acknowledged before it is durable, and no signature leaves before the size
//! and root it is over are flushed, so that after any crash the log can only go on from
//! what it signed. Submissions that wait at the same time share one flush.
//!
//! Every batch ends in a map leaf: the root of the verifiable map over all that stands before it, so that whoever
//! has a checkpoint can be shown that an answer leaves nothing out ([`crate::format::map`]).
//!
//! When a write fails it is unknown what the disk holds; the registry then halts: it
//! still reads and proves, and writes again only after a new start has re-read everything.

mod anchor;
mod answer;
mod commit;
mod erase;
mod error;
mod fill;
mod layout;
mod lookups;
pub mod map;
mod nonce;
mod publish;
mod read;
mod rebuild;
mod registry;
mod reload;
mod seal;
mod shared;
pub mod store;
mod submit;
mod tiles;

pub use anchor::Anchor;
pub use commit::Receipt;
pub use error::RegistryError;
pub use fill::ORIGIN_PREFIX as BENCH_ORIGIN_PREFIX;
pub use nonce::NONCE_LIFETIME;
pub use read::{LogEntry, StoredRecord};
pub use rebuild::Rebuilt;
pub use registry::Registry;
pub use shared::Published;
