//! The public formats: envelopes, trees, notes, checkpoints, proofs, tiles, policies, records. Nothing here reads or writes a file.

pub mod answer;
pub mod checkpoint;
pub mod cosignature;
pub mod digest;
pub mod dsse;
pub mod erasure;
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
pub(crate) mod serial;
pub mod tile;
pub(crate) mod tree;

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
