//! The registry's own leaf: the root of the verifiable map, in the log.
//!
//! `version 1 | kind 7 | SHA-256(PAE of the statement) 32 | SHA-256(registry key) 32 | map root 32 | signature 64`,
//! as long as an owner record's leaf. It is the last leaf of every batch, so that
//! every log that is not empty ends in one: a map leaf at index `i` commits to the map over the leaves
//! `0..i`. The statement that the registry signs follows from origin, index and root,
//! so nothing lies beside the log for it, and nothing of it can be erased.

use serde::Serialize;

use crate::format::{
    digest::Digest,
    dsse::pae,
    key::{OwnerKey, PublicKey, SIGNATURE_LEN},
    leaf::{self, LEAF_LEN, Leaf, LeafError, MAP_KIND},
    merkle,
};

/// The DSSE payloadType of the map statement.
pub const PAYLOAD_TYPE: &str = "application/vnd.cairn.map-root.v1+json";

/// What the registry says about the map at one size of the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MapLeaf {
    /// SHA-256 of the PAE of the statement: see [`statement`].
    pub statement: Digest,
    /// SHA-256 of the registry's public key.
    pub registry: Digest,
    /// The map's root over all leaves before this one.
    pub root: Digest,
    /// The registry's signature over the PAE.
    pub signature: [u8; SIGNATURE_LEN],
}

/// Why a map leaf says nothing about the map at its place.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapLeafError {
    /// Made for another log, another place or another root.
    #[error(
        "map leaf at index {index} of log {origin:?}: its statement is {got}, origin, index and root give {expected}"
    )]
    Statement {
        /// The log that the verifier follows.
        origin: String,
        /// Where the leaf stands.
        index: u64,
        /// What follows from them.
        expected: Digest,
        /// What the leaf carries.
        got: Digest,
    },
    /// Another registry's leaf.
    #[error("map leaf at index {index} is by key {got}, expected the registry's {expected}")]
    Registry {
        /// Where the leaf stands.
        index: u64,
        /// Key id of the registry.
        expected: Digest,
        /// Key id in the leaf.
        got: Digest,
    },
    /// The registry did not sign it.
    #[error("map leaf at index {index}: its signature does not verify under the registry's key {key}")]
    Signature {
        /// Where the leaf stands.
        index: u64,
        /// The registry's key.
        key: PublicKey,
    },
}

/// The bytes that the registry signs: PAE over
/// `{"version":1,"kind":"map","origin":"<origin>","size":<size>,"root":"<64 hex>"}`.
pub fn statement(origin: &str, size: u64, root: &Digest) -> Vec<u8> {
    #[derive(Serialize)]
    struct Body<'a> {
        version: u32,
        kind: &'static str,
        origin: &'a str,
        size: u64,
        root: &'a Digest,
    }
    let body = Body { version: 1, kind: "map", origin, size, root };
    // Strings and numbers only: there is nothing that could fail to serialise.
    pae(PAYLOAD_TYPE, &serde_json::to_vec(&body).unwrap_or_default())
}

impl MapLeaf {
    /// The leaf that goes to index `size` of log `origin`, over a map with this `root`.
    pub fn sign(origin: &str, size: u64, root: Digest, key: &OwnerKey) -> Self {
        let statement = statement(origin, size, &root);
        let registry = key.public().id();
        Self { statement: Digest::of(&statement), registry, root, signature: key.sign(&statement) }
    }

    /// The 162 bytes.
    pub fn encode(&self) -> [u8; LEAF_LEN] {
        leaf::join(MAP_KIND, [&self.statement, &self.registry, &self.root], &self.signature)
    }

    /// Reads 162 bytes.
    ///
    /// # Errors
    /// [`LeafError`] for another length, an unknown version or kind, and for an owner record's leaf.
    pub fn decode(bytes: &[u8]) -> Result<Self, LeafError> {
        match Entry::decode(bytes)? {
            Entry::Map(leaf) => Ok(leaf),
            Entry::Record(leaf) => Err(LeafError::IsRecord { got: leaf.kind.code() }),
        }
    }

    /// The leaf's hash in the log, `H(0x00 | leaf)`.
    pub fn hash(&self) -> Digest {
        merkle::leaf_hash(&self.encode())
    }

    /// Verifies that its statement is the one for `index` of log `origin`: what can be told without the registry's key.
    ///
    /// # Errors
    /// [`MapLeafError::Statement`].
    pub fn verify_statement(&self, origin: &str, index: u64) -> Result<(), MapLeafError> {
        let expected = Digest::of(statement(origin, index, &self.root));
        if self.statement == expected {
            return Ok(());
        }
        Err(MapLeafError::Statement { origin: origin.to_owned(), index, expected, got: self.statement })
    }

    /// Verifies that the registry with this `key` made this leaf for `index` of log `origin`.
    ///
    /// That it stands there is for the log's own proof to show.
    ///
    /// # Errors
    /// [`MapLeafError`].
    pub fn verify(&self, origin: &str, index: u64, key: &PublicKey) -> Result<(), MapLeafError> {
        self.verify_statement(origin, index)?;
        let expected = key.id();
        if self.registry != expected {
            return Err(MapLeafError::Registry { index, expected, got: self.registry });
        }
        let statement = statement(origin, index, &self.root);
        key.verify(&statement, &self.signature).map_err(|_| MapLeafError::Signature { index, key: *key })
    }
}

/// A leaf of either sort, told apart by its kind byte.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Entry {
    /// An owner record's, kinds 1 to 6 and 8.
    Record(Leaf),
    /// The registry's, kind 7.
    Map(MapLeaf),
}

impl Entry {
    /// Reads 162 bytes.
    ///
    /// # Errors
    /// [`LeafError`] for another length, an unknown version or kind.
    pub fn decode(bytes: &[u8]) -> Result<Self, LeafError> {
        match leaf::split(bytes)? {
            (MAP_KIND, [statement, registry, root], signature) => {
                Ok(Self::Map(MapLeaf { statement, registry, root, signature }))
            }
            _ => Leaf::decode(bytes).map(Self::Record),
        }
    }

    /// The 162 bytes.
    pub fn encode(&self) -> [u8; LEAF_LEN] {
        match self {
            Self::Record(leaf) => leaf.encode(),
            Self::Map(leaf) => leaf.encode(),
        }
    }

    /// The leaf's hash in the log, `H(0x00 | leaf)`.
    pub fn hash(&self) -> Digest {
        merkle::leaf_hash(&self.encode())
    }
}
