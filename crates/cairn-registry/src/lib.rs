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

pub mod answer;
pub mod checkpoint;
pub mod cosignature;
pub mod digest;
pub mod dsse;
pub mod erasure;
#[cfg(feature = "store")]
pub mod files;
pub mod heir;
pub mod keys;
pub mod leaf;
pub mod map;
pub mod map_leaf;
pub mod merkle;
pub mod note;
pub mod packs;
pub mod policy;
pub mod proof;
pub mod record;
#[cfg(feature = "store")]
pub mod registry;
mod serial;
#[cfg(feature = "store")]
pub mod store;
pub mod tile;
mod tree;

pub use answer::{Answer, AnswerError};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use cosignature::{Cosignature, CosignatureError, WitnessVerifier, cosign};
pub use digest::{Digest, DigestError};
pub use dsse::{DsseError, Envelope};
pub use erasure::{Erasure, ErasureError, ErasureRequest};
pub use heir::{Ending, Heir, heir};
pub use keys::{KeyError, OwnerKey, PublicKey};
pub use leaf::Leaf;
pub use map::{MapEntry, MapKey, MapProof, MapTree};
pub use map_leaf::{Entry, MapLeaf};
pub use merkle::ProofError;
pub use note::{Note, NoteError, NoteSignature, NoteVerifier};
pub use policy::{Policy, PolicyError, PolicyVerdict, Quorum};
pub use proof::{TlogProof, TlogProofError};
pub use record::{OwnerRecord, RecordError, RecordKind};
#[cfg(feature = "store")]
pub use registry::{Anchor, LogEntry, Published, Receipt, Registry, RegistryError, StoredRecord};
