//! How the registry's store is laid out: keys by prefix, numbers big-endian so
//! that they sort, and a format version that is checked before anything is read.

use crate::digest::Digest;

/// Value of [`FORMAT`] that this release reads and writes.
pub(super) const FORMAT_VERSION: &str = "cairn-registry-store/1";

pub(super) const FORMAT: &[u8] = b"meta/format";
pub(super) const ORIGIN: &[u8] = b"meta/origin";
pub(super) const REGISTRY_KEY: &[u8] = b"meta/key";
/// Size (u64) and root of the last tree that was, or was about to be, signed.
pub(super) const SIGNED: &[u8] = b"meta/signed";

/// index -> leaf, 162 bytes.
pub(super) const LEAVES: &[u8] = b"leaf/";
/// SHA-256 of the scene's name, index -> nothing.
pub(super) const SCENES: &[u8] = b"scene/";

pub(super) fn leaf(index: u64) -> Vec<u8> {
    [LEAVES, &index.to_be_bytes()].concat()
}

/// SHA-256(PAE) -> envelope JSON, countersigned.
pub(super) fn envelope(record: &Digest) -> Vec<u8> {
    [b"envelope/", &record.as_bytes()[..]].concat()
}

/// SHA-256(PAE) -> index.
pub(super) fn index_of(record: &Digest) -> Vec<u8> {
    [b"index/", &record.as_bytes()[..]].concat()
}

/// nonce -> index of the record that used it.
pub(super) fn nonce(nonce: &Digest) -> Vec<u8> {
    [b"nonce/", &nonce.as_bytes()[..]].concat()
}

/// Key id -> index of the revocation or rotation that ended it.
pub(super) fn retired(owner: &Digest) -> Vec<u8> {
    [b"retired/", &owner.as_bytes()[..]].concat()
}

/// Prefix of a scene's entries.
pub(super) fn scene(scene: &str) -> Vec<u8> {
    [SCENES, Digest::of(scene).as_bytes()].concat()
}

pub(super) fn number(bytes: &[u8]) -> Option<u64> {
    bytes.try_into().ok().map(u64::from_be_bytes)
}

pub(super) fn signed(size: u64, root: &Digest) -> Vec<u8> {
    [&size.to_be_bytes()[..], root.as_bytes()].concat()
}

pub(super) fn parse_signed(bytes: &[u8]) -> Option<(u64, Digest)> {
    let (size, root) = bytes.split_first_chunk::<8>()?;
    Some((u64::from_be_bytes(*size), Digest::try_from(root).ok()?))
}
