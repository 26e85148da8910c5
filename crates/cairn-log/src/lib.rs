//! Owner records, signatures, and the append-only log that keeps them.
//!
//! The formats are public ones, so that anybody's tools can check a log of ours:
//! DSSE envelopes ([`dsse`]), RFC 6962 Merkle trees ([`merkle`]), C2SP signed
//! notes, checkpoints, proofs and tiles ([`note`], [`checkpoint`], [`proof`], [`tile`]), cosignatures and trust policies
//! ([`cosignature`], [`policy`]). Ours are only the owner record ([`record`]), the leaf ([`leaf`]), the verifiable
//! map over them ([`map`], [`map_leaf`]) and how envelopes lie beside the log ([`packs`]).
//!
//! Those build without the feature `store`, which adds the writing half: the
//! registry proper and its store on sled, the only code here that knows sled.

pub mod format;
#[cfg(feature = "store")]
pub mod log;
#[cfg(feature = "store")]
pub mod store;
#[cfg(feature = "witness")]
pub mod witness;

pub use format::*;
#[allow(unused_imports)]
use format::{serial, tree};
#[cfg(feature = "store")]
pub use log::{Anchor, LogEntry, Published, Receipt, Registry, RegistryError, StoredRecord};
