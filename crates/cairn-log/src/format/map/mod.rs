//! The verifiable map: which records are about a scene, a view, a key or a
//! record, so that an answer can prove that it leaves none out.
//!
//! Everything here follows from the log by public functions: [`keys_of`] gives the keys under
//! which a record is listed, a key's value is the RFC 6962 root over its
//! [`MapEntry`]s in log order ([`list_root`]), and the map is a sparse binary
//! Merkle tree over the keys' bits, most significant first:
//!
//! - an empty subtree is 32 zero bytes;
//! - a subtree with exactly one key is `SHA-256(0x02 | key | value)`, wherever it stands;
//! - any other is `SHA-256(0x03 | left | right)`.
//!
//! So the tree is as deep as the keys need and no deeper, and a [`MapProof`] of a map of n keys holds about log2(n)
//! hashes. Its root goes into the log as a leaf of the registry's ([`crate::format::map_leaf`]).
//!
//! [`MapTree`] keeps a whole map in memory. The registry's own tree, whose keys lie in its store, is
//! `log::map::BucketMap`.

mod list;
mod proof;
mod tree;

use serde::{Deserialize, Serialize};

pub use list::{ListError, ListState, MapEntry, list_root};
pub use proof::{MapProof, MapProofError, ProofEnd};
pub use tree::MapTree;

use crate::format::{
    digest::Digest,
    record::{OwnerRecord, RecordKind},
};

/// What stands for an empty subtree, and so for the root of an empty map.
pub const EMPTY: Digest = Digest::from_bytes([0; Digest::LEN]);

/// Most siblings on a path: one a bit of the key.
pub const MAX_DEPTH: usize = 256;

/// A key of the map: `SHA-256(label | 0x00 | fields)`, each field behind its length as u64, big-endian.
///
/// Ordered as its bytes are, which is the order of the tree's leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MapKey(Digest);

impl MapKey {
    /// All records about a scene: label `cairn map scene v1`.
    pub fn scene(scene: &str) -> Self {
        Self::of("cairn map scene v1", &[scene.as_bytes()])
    }

    /// Records whose `views` list a photograph of a scene, by its SHA-256: label `cairn map view v1`.
    pub fn view(scene: &str, photograph: &Digest) -> Self {
        Self::of("cairn map view v1", &[scene.as_bytes(), photograph.as_bytes()])
    }

    /// Revocations and rotations that ended an owner key, by its id: label `cairn map ended v1`.
    pub fn ended(key_id: &Digest) -> Self {
        Self::of("cairn map ended v1", &[key_id.as_bytes()])
    }

    /// Records whose `replaces` names a record, by its digest: label `cairn map about v1`.
    pub fn about(record: &Digest) -> Self {
        Self::of("cairn map about v1", &[record.as_bytes()])
    }

    /// Bindings of a contributor's name in a scene: label `cairn map binding v1`.
    pub fn binding(scene: &str, contributor: &str) -> Self {
        Self::of("cairn map binding v1", &[scene.as_bytes(), contributor.as_bytes()])
    }

    /// Claims and contributions in a contributor's name about a scene: label `cairn map contributor v1`.
    pub fn contributor(scene: &str, contributor: &str) -> Self {
        Self::of("cairn map contributor v1", &[scene.as_bytes(), contributor.as_bytes()])
    }

    /// Takes 32 bytes as a key.
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(Digest::from_bytes(bytes))
    }

    /// The 32 bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        self.0.as_bytes()
    }

    fn of(label: &str, fields: &[&[u8]]) -> Self {
        let lengths: Vec<[u8; 8]> = fields.iter().map(|field| (field.len() as u64).to_be_bytes()).collect();
        let mut parts: Vec<&[u8]> = vec![label.as_bytes(), &[0]];
        for (length, field) in lengths.iter().zip(fields) {
            parts.extend([length.as_slice(), field]);
        }
        Self(Digest::of_parts(&parts))
    }

    /// Bit `depth`, most significant first: which way the path goes at that depth.
    pub(crate) fn bit(&self, depth: usize) -> bool {
        self.as_bytes()[depth / 8] >> (7 - depth % 8) & 1 == 1
    }

    /// How many leading bits two keys share, 256 where they are one.
    fn shared_bits(&self, other: &Self) -> usize {
        let differ = self.as_bytes().iter().zip(other.as_bytes()).position(|(a, b)| a != b);
        differ.map_or(MAX_DEPTH, |at| at * 8 + (self.as_bytes()[at] ^ other.as_bytes()[at]).leading_zeros() as usize)
    }
}

impl std::fmt::Display for MapKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// The keys under which a record is listed: ascending, each once.
///
/// `replaced_owner` is the key id of the owner of the record that `replaces` names, which that record's leaf carries
/// ([`crate::format::leaf::Leaf::owner`]): a rotation ends that key. It is needed for rotations only.
pub fn keys_of(record: &OwnerRecord, replaced_owner: Option<Digest>) -> Vec<MapKey> {
    let mut keys = vec![MapKey::scene(&record.scene)];
    keys.extend(record.views.iter().flatten().map(|photograph| MapKey::view(&record.scene, photograph)));
    let ended = match record.kind {
        RecordKind::Revocation => Some(record.owner_key.id()),
        RecordKind::Rotation => replaced_owner,
        RecordKind::Claim
        | RecordKind::Contribution
        | RecordKind::Training
        | RecordKind::Dispute
        | RecordKind::Binding => None,
    };
    let (scene, contributor) = (&record.scene, &record.identity.contributor);
    keys.extend((record.kind == RecordKind::Binding).then(|| MapKey::binding(scene, contributor)));
    keys.extend(record.kind.credits().then(|| MapKey::contributor(scene, contributor)));
    keys.extend(ended.map(|id| MapKey::ended(&id)));
    keys.extend(record.replaces.map(|digest| MapKey::about(&digest)));
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// Hash of a subtree that holds exactly one key.
pub(crate) fn leaf_hash(key: &MapKey, value: &Digest) -> Digest {
    Digest::of_parts(&[&[2], key.as_bytes(), value.as_bytes()])
}

/// Hash of a subtree that holds more.
pub(crate) fn node_hash(left: &Digest, right: &Digest) -> Digest {
    Digest::of_parts(&[&[3], left.as_bytes(), right.as_bytes()])
}
