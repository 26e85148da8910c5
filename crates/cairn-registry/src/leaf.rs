//! A leaf of the log: 162 bytes, fixed, nothing personal.
//!
//! `version u8 | kind u8 | SHA-256(PAE) 32 | SHA-256(owner key) 32 | salted scene commitment 32 | owner's signature 64`.
//! Leaves can never be removed, so they hold only digests; the envelope lies
//! beside the log and takes the scene's salt with it when it is erased. A leaf
//! can be made again from its envelope alone: that is how anybody checks that
//! the two belong together.

use crate::{
    digest::Digest,
    dsse::Envelope,
    keys::SIGNATURE_LEN,
    merkle,
    record::{OwnerRecord, RecordError, RecordKind, scene_commitment},
};

/// Bytes of a leaf.
pub const LEAF_LEN: usize = 2 + 3 * Digest::LEN + SIGNATURE_LEN;

/// The leaf format's version.
pub const LEAF_VERSION: u8 = 1;

/// One leaf.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Leaf {
    /// What the record says.
    pub kind: RecordKind,
    /// SHA-256 of the envelope's PAE.
    pub record: Digest,
    /// SHA-256 of the owner's public key.
    pub owner: Digest,
    /// Salted commitment to the scene's name.
    pub scene: Digest,
    /// The owner's signature over the PAE.
    pub signature: [u8; SIGNATURE_LEN],
}

/// Why bytes are not a leaf.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LeafError {
    /// Not 162 bytes.
    #[error("a leaf is {LEAF_LEN} bytes, got {got}")]
    Length {
        /// How many there were.
        got: usize,
    },
    /// A version that this release does not know.
    #[error("leaf of version {got}, this release reads version {LEAF_VERSION}")]
    Version {
        /// The version byte.
        got: u8,
    },
    /// A kind that version 1 does not have.
    #[error("leaf of kind {got}, 1 to 6 expected")]
    Kind {
        /// The kind byte.
        got: u8,
    },
}

impl Leaf {
    /// The leaf of an envelope whose owner signed it.
    ///
    /// # Errors
    /// [`RecordError`] as from [`OwnerRecord::open`].
    pub fn of(envelope: &Envelope) -> Result<Self, RecordError> {
        let (record, signature) = OwnerRecord::open(envelope)?;
        Self::of_opened(envelope, &record, &signature.sig)
    }

    /// The leaf of an envelope, by what [`OwnerRecord::open`] gave for it.
    pub(crate) fn of_opened(envelope: &Envelope, record: &OwnerRecord, signature: &[u8]) -> Result<Self, RecordError> {
        // Verified, so 64 bytes; anything else would have been refused.
        let refuse = |_| RecordError::OwnerSignature { owner: record.owner_key };
        Ok(Self {
            kind: record.kind,
            record: envelope.digest(),
            owner: record.owner_key.id(),
            scene: scene_commitment(&record.scene_salt, &record.scene),
            signature: signature.try_into().map_err(refuse)?,
        })
    }

    /// The 162 bytes.
    pub fn encode(&self) -> [u8; LEAF_LEN] {
        let mut out = [0; LEAF_LEN];
        out[0] = LEAF_VERSION;
        out[1] = self.kind.code();
        out[2..34].copy_from_slice(self.record.as_bytes());
        out[34..66].copy_from_slice(self.owner.as_bytes());
        out[66..98].copy_from_slice(self.scene.as_bytes());
        out[98..].copy_from_slice(&self.signature);
        out
    }

    /// Reads 162 bytes.
    ///
    /// # Errors
    /// [`LeafError`] for another length, an unknown version or kind.
    pub fn decode(bytes: &[u8]) -> Result<Self, LeafError> {
        let bytes: &[u8; LEAF_LEN] = bytes.try_into().map_err(|_| LeafError::Length { got: bytes.len() })?;
        if bytes[0] != LEAF_VERSION {
            return Err(LeafError::Version { got: bytes[0] });
        }
        let kind = RecordKind::from_code(bytes[1]).ok_or(LeafError::Kind { got: bytes[1] })?;
        let part = |at: usize| {
            let mut digest = [0; 32];
            digest.copy_from_slice(&bytes[at..at + 32]);
            Digest::from_bytes(digest)
        };
        let mut signature = [0; SIGNATURE_LEN];
        signature.copy_from_slice(&bytes[98..]);
        Ok(Self { kind, record: part(2), owner: part(34), scene: part(66), signature })
    }

    /// The leaf's hash in the log, `H(0x00 | leaf)`.
    pub fn hash(&self) -> Digest {
        merkle::leaf_hash(&self.encode())
    }
}
