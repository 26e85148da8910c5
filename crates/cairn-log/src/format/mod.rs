//! The public formats: envelopes, trees, notes, checkpoints, proofs, tiles, policies, records, keys.
//!
//! Nothing here reads or writes a file, so an auditor that depends on this module alone cannot change a log.

pub mod answer;
pub mod checkpoint;
pub mod cosignature;
pub mod digest;
pub mod dsse;
pub mod erasure;
pub mod heir;
pub mod key;
pub mod leaf;
pub mod manifest;
pub mod map;
pub mod map_leaf;
pub mod merkle;
pub mod note;
pub mod packs;
pub mod policy;
pub mod proof;
pub mod record;
#[cfg(feature = "sealed-keys")]
pub mod sealed;
mod serial;
pub mod shares;
pub mod signed;
mod statement;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod tile;

pub use answer::{Answer, AnswerError};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use cosignature::{Cosignature, CosignatureError, WitnessVerifier, cosign};
pub use digest::{Digest, DigestError};
pub use dsse::{DsseError, Envelope};
pub use erasure::{Erasure, ErasureRequest};
pub use key::{KeyError, OwnerKey, PublicKey};
pub use leaf::Leaf;
pub use map::{MapEntry, MapKey, MapProof, MapTree};
pub use map_leaf::{Entry, MapLeaf};
pub use merkle::ProofError;
pub use note::{Note, NoteError, NoteSignature, NoteVerifier};
pub use policy::{Policy, PolicyError, PolicyVerdict, Quorum};
pub use proof::{TlogProof, TlogProofError};
pub use record::{OwnerRecord, RecordError, RecordKind};
pub use signed::SignedRecord;
