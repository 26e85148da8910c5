//! Owner records, signatures, and the append-only log that keeps them.
//!
//! The formats are public ones, so that other tools can check a log of ours: DSSE envelopes ([`format::dsse`]), RFC
//! 6962 Merkle trees ([`format::merkle`]), C2SP signed notes, checkpoints, proofs and tiles ([`format::note`],
//! [`format::checkpoint`], [`format::proof`], [`format::tile`]), cosignatures and trust policies
//! ([`format::cosignature`], [`format::policy`]). Ours are only the owner record ([`format::record`]), the leaf
//! ([`format::leaf`]), the verifiable map over them ([`format::map`], [`format::map_leaf`]) and how envelopes lie
//! beside the log ([`format::packs`]).
//!
//! [`mod@format`] builds without any feature and without I/O. The feature `store` adds the writing half: `log`, the
//! registry with its store on sled, and `keys`, the key files. The features `witness-*` add `witness`.

pub mod format;
#[cfg(feature = "store")]
pub mod keys;
#[cfg(feature = "store")]
pub mod log;
#[cfg(feature = "witness")]
pub mod witness;

pub use format::{
    Answer, AnswerError, Checkpoint, CheckpointError, Cosignature, CosignatureError, Digest, DigestError, DsseError,
    Entry, Envelope, Erasure, ErasureRequest, KeyError, Leaf, MapEntry, MapKey, MapLeaf, MapProof, MapTree, Note,
    NoteError, NoteSignature, NoteVerifier, OwnerKey, OwnerRecord, Policy, PolicyError, PolicyVerdict, ProofError,
    PublicKey, Quorum, RecordError, RecordKind, SignedRecord, TlogProof, TlogProofError, WitnessVerifier, cosign,
    heir::{Ending, Heir},
};
#[cfg(feature = "store")]
pub use log::{Anchor, LogEntry, Published, Receipt, Registry, RegistryError, StoredRecord};
