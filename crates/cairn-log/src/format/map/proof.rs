//! Proofs that a key has a value in a map, or none.
//!
//! At every depth a node is empty, one key's leaf or an inner node, and the three are hashed apart; so
//! under one root a key's path ends in one way only, and nobody can prove both that
//! a key has a value and that it has none, nor two values.

use serde::{Deserialize, Serialize};

use super::{EMPTY, MAX_DEPTH, MapKey, leaf_hash, node_hash};
use crate::format::{digest::Digest, serial};

/// The way from a map's root to where a key's path ends, and what stands there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapProof {
    /// The subtrees beside the path, from the root down; base64 in JSON.
    #[serde(serialize_with = "serial::hashes", deserialize_with = "serial::hashes_up_to::<MAX_DEPTH, _>")]
    pub siblings: Vec<Digest>,
    /// What stands at the end of the path.
    pub end: ProofEnd,
}

/// What stands where a key's path ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ProofEnd {
    /// The key's own leaf: it has a value.
    Own,
    /// Nothing: the key has no value.
    Empty,
    /// Another key's leaf, alone in its subtree: the key has no value.
    Other {
        /// The other key.
        key: MapKey,
        /// Its value; base64 in JSON.
        #[serde(with = "serial::hash")]
        value: Digest,
    },
}

/// Why a proof proves nothing about a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapProofError {
    /// More siblings than a key has bits.
    #[error("map proof with {got} siblings, a key has {limit} bits", limit = MAX_DEPTH)]
    TooLong {
        /// How many there are.
        got: usize,
    },
    /// An inner node with one empty side and one key or none: no map has that, it would be collapsed.
    #[error("map proof, sibling {depth}: the path ends beside an empty subtree, where it would have ended higher up")]
    NotCollapsed {
        /// The last sibling's depth.
        depth: usize,
    },
    /// The proof is of the other sort than what it is to prove.
    #[error("map proof of key {key}: it is one of {got}, where {expected} is to be proven")]
    WrongSort {
        /// The key.
        key: MapKey,
        /// `membership` or `absence`.
        expected: &'static str,
        /// `membership` or `absence`.
        got: &'static str,
    },
    /// The key's own leaf, offered as another's.
    #[error("map proof of key {key}: the leaf offered as another key's is its own")]
    OwnLeafAsOther {
        /// The key.
        key: MapKey,
    },
    /// The other key would not stand on this path.
    #[error("map proof of key {key}: the other key {other} shares {shared} bits with it, the path has {depth}")]
    OtherPath {
        /// The key.
        key: MapKey,
        /// The key whose leaf is offered.
        other: MapKey,
        /// How many leading bits they share.
        shared: usize,
        /// How deep the path goes.
        depth: usize,
    },
    /// The proof leads to another root.
    #[error("map proof of key {key} leads to root {got}, expected {expected}")]
    RootMismatch {
        /// The key.
        key: MapKey,
        /// The root claimed.
        expected: Digest,
        /// The root computed.
        got: Digest,
    },
}

impl MapProofError {
    /// A stable name, for reports.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::TooLong { .. } => "map.proof.too_long",
            Self::NotCollapsed { .. } => "map.proof.not_collapsed",
            Self::WrongSort { .. } => "map.proof.wrong_sort",
            Self::OwnLeafAsOther { .. } => "map.proof.own_leaf_as_other",
            Self::OtherPath { .. } => "map.proof.other_path",
            Self::RootMismatch { .. } => "map.proof.root_mismatch",
        }
    }
}

impl MapProof {
    /// Verifies that `key` has this `value` in the map with this `root`, or, with `None`, that it has no value there.
    ///
    /// # Errors
    /// [`MapProofError`].
    pub fn verify(&self, key: &MapKey, value: Option<Digest>, root: &Digest) -> Result<(), MapProofError> {
        let depth = self.siblings.len();
        if depth > MAX_DEPTH {
            return Err(MapProofError::TooLong { got: depth });
        }
        if self.siblings.last() == Some(&EMPTY) {
            return Err(MapProofError::NotCollapsed { depth: depth - 1 });
        }
        let mut hash = self.end_hash(key, value)?;
        for (depth, sibling) in self.siblings.iter().enumerate().rev() {
            hash = if key.bit(depth) { node_hash(sibling, &hash) } else { node_hash(&hash, sibling) };
        }
        if hash != *root {
            return Err(MapProofError::RootMismatch { key: *key, expected: *root, got: hash });
        }
        Ok(())
    }

    /// Hash of what stands at the end of the path, where it fits the claim.
    fn end_hash(&self, key: &MapKey, value: Option<Digest>) -> Result<Digest, MapProofError> {
        let (membership, absence) = ("membership", "absence");
        match (self.end, value) {
            (ProofEnd::Own, Some(value)) => Ok(leaf_hash(key, &value)),
            (ProofEnd::Own, None) => Err(MapProofError::WrongSort { key: *key, expected: absence, got: membership }),
            (ProofEnd::Empty | ProofEnd::Other { .. }, Some(_)) => {
                Err(MapProofError::WrongSort { key: *key, expected: membership, got: absence })
            }
            (ProofEnd::Empty, None) => Ok(EMPTY),
            (ProofEnd::Other { key: other, value }, None) => {
                if other == *key {
                    return Err(MapProofError::OwnLeafAsOther { key: *key });
                }
                let (shared, depth) = (key.shared_bits(&other), self.siblings.len());
                if shared < depth {
                    return Err(MapProofError::OtherPath { key: *key, other, shared, depth });
                }
                Ok(leaf_hash(&other, &value))
            }
        }
    }
}
