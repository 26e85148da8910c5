//! A leaf of the log: 162 bytes, fixed, nothing personal.
//!
//! `version u8 | kind u8 | SHA-256(PAE) 32 | SHA-256(owner key) 32 | salted scene commitment 32 | owner's signature 64`.
//! Leaves can never be removed, so they hold only digests; the envelope lies
//! beside the log and takes the scene's salt with it when it is erased. A leaf
//! can be made again from its envelope alone: that is how anybody checks that
//! the two belong together.

use crate::format::{
    digest::Digest,
    dsse::Envelope,
    key::SIGNATURE_LEN,
    merkle,
    record::{OwnerRecord, RecordError, RecordKind, scene_commitment},
};

/// Bytes of a leaf.
pub const LEAF_LEN: usize = 2 + 3 * Digest::LEN + SIGNATURE_LEN;

/// The leaf format's version.
pub const LEAF_VERSION: u8 = 1;

/// The kind byte of the registry's own leaves: see [`crate::format::map_leaf`].
pub const MAP_KIND: u8 = 7;

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
    /// A kind that there is not.
    #[error("leaf of kind {got}, 1 to 8 expected")]
    Kind {
        /// The kind byte.
        got: u8,
    },
    /// The registry's own leaf, where an owner record's is read.
    #[error(
        "leaf of kind 7 is a map leaf of the registry and belongs to no owner record; read it as `map_leaf::Entry`"
    )]
    IsMap,
    /// An owner record's leaf, where the registry's own is read.
    #[error("leaf of kind {got} belongs to an owner record and is no map leaf; read it as `map_leaf::Entry`")]
    IsRecord {
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
        Self::open(envelope).map(|(leaf, _)| leaf)
    }

    /// The leaf of an envelope and the record in it, at the price of one verification.
    ///
    /// # Errors
    /// [`RecordError`] as from [`OwnerRecord::open`].
    pub fn open(envelope: &Envelope) -> Result<(Self, OwnerRecord), RecordError> {
        let (record, signature) = OwnerRecord::open(envelope)?;
        let leaf = Self {
            kind: record.kind,
            record: envelope.digest(),
            owner: record.owner_key.id(),
            scene: scene_commitment(&record.scene_salt, &record.scene),
            // Verified, so 64 bytes.
            signature: signature
                .sig
                .as_slice()
                .try_into()
                .map_err(|_| RecordError::OwnerSignature { what: "owner record", owner: record.owner_key })?,
        };
        Ok((leaf, record))
    }

    /// The 162 bytes.
    pub fn encode(&self) -> [u8; LEAF_LEN] {
        join(self.kind.code(), [&self.record, &self.owner, &self.scene], &self.signature)
    }

    /// Reads 162 bytes.
    ///
    /// # Errors
    /// [`LeafError`] for another length, an unknown version or kind, and for a map leaf (kind 7).
    pub fn decode(bytes: &[u8]) -> Result<Self, LeafError> {
        let (kind, [record, owner, scene], signature) = split(bytes)?;
        if kind == MAP_KIND {
            return Err(LeafError::IsMap);
        }
        let kind = RecordKind::from_code(kind).ok_or(LeafError::Kind { got: kind })?;
        Ok(Self { kind, record, owner, scene, signature })
    }

    /// The leaf's hash in the log, `H(0x00 | leaf)`.
    pub fn hash(&self) -> Digest {
        merkle::leaf_hash(&self.encode())
    }
}

/// Lays out the 162 bytes that leaves of every kind share.
pub(crate) fn join(kind: u8, digests: [&Digest; 3], signature: &[u8; SIGNATURE_LEN]) -> [u8; LEAF_LEN] {
    let mut out = [0; LEAF_LEN];
    out[0] = LEAF_VERSION;
    out[1] = kind;
    for (part, digest) in out[2..98].chunks_exact_mut(Digest::LEN).zip(digests) {
        part.copy_from_slice(digest.as_bytes());
    }
    out[98..].copy_from_slice(signature);
    out
}

/// Takes the 162 bytes apart: kind byte, three digests, signature.
pub(crate) fn split(bytes: &[u8]) -> Result<(u8, [Digest; 3], [u8; SIGNATURE_LEN]), LeafError> {
    let bytes: &[u8; LEAF_LEN] = bytes.try_into().map_err(|_| LeafError::Length { got: bytes.len() })?;
    if bytes[0] != LEAF_VERSION {
        return Err(LeafError::Version { got: bytes[0] });
    }
    let part = |at: usize| {
        let mut digest = [0; Digest::LEN];
        digest.copy_from_slice(&bytes[at..at + Digest::LEN]);
        Digest::from_bytes(digest)
    };
    let mut signature = [0; SIGNATURE_LEN];
    signature.copy_from_slice(&bytes[98..]);
    Ok((bytes[1], [part(2), part(34), part(66)], signature))
}
