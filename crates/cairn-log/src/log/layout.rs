//! How the registry's folder is laid out: the store's keys by prefix, numbers big-endian so
//! that they sort; the files' paths; and a format version that is checked before anything is read.
//!
//! ```text
//! working/            the store (sled): what cannot be fetched anew, and indices into the rest
//! working/runs/<N>    rows of the store that only accumulate, sorted, once there are many (`store::TieredStore`)
//! working.seal        digests of the store's files, while nobody has it open
//! public/checkpoint   what monitors read: checkpoint, tiles, bundles of leaves (C2SP tlog-tiles)
//! public/tile/...
//! envelopes/<N>       the records themselves, 256 log entries a file (`packs`)
//! ```
//!
//! A leaf stands in the store until the tile and the bundle that hold it are full and in files.

use crate::{
    format::{
        digest::Digest,
        key::PublicKey,
        map::MapKey,
        tile::{TilePath, index_path},
    },
    log::{
        map::first_key,
        store::{Change, Cold, successor},
    },
};

/// Value of [`FORMAT`] that this release reads and writes.
pub(super) const FORMAT_VERSION: &str = "cairn-log-store/4";

/// The lock file of the one writer.
pub(super) const LOCK: &str = "LOCK";
/// The store's folder.
pub(super) const WORKING: &str = "working";
/// Where rows of the store go that only accumulate.
pub(super) const RUNS: &str = "working/runs";
/// The store's folder while it is made again, and its runs.
pub(super) const REBUILT: &str = "working.rebuilt";
pub(super) const REBUILT_RUNS: &str = "working.rebuilt/runs";
/// Digests of the store's files.
pub(super) const SEAL: &str = "working.seal";
/// The published checkpoint.
pub(super) const CHECKPOINT: &str = "public/checkpoint";

pub(super) const FORMAT: &[u8] = b"meta/format";
pub(super) const ORIGIN: &[u8] = b"meta/origin";
pub(super) const REGISTRY_KEY: &[u8] = b"meta/key";
/// Size (u64) and root of the last tree that was, or was about to be, signed.
pub(super) const SIGNED: &[u8] = b"meta/signed";
/// Leaves (u64, a multiple of 256) that are in full tiles and bundles on disk.
pub(super) const FILED: &[u8] = b"meta/filed";

/// Size (u64) from which on nonces are good that were issued then; 0 or absent where all are that are not too old.
pub(super) const NONCES_FROM: &[u8] = b"meta/nonces-from";

/// index -> leaf, 162 bytes, from [`FILED`] on.
pub(super) const LEAVES: &[u8] = b"leaf/";
const INDEX: &[u8] = b"index/";
const ENTRIES: &[u8] = b"map/entry/";
/// What a list's row begins with; its key follows.
pub(super) const LISTS: &[u8] = b"map/list/";
const RETIRED: &[u8] = b"retired/";
/// index -> nonce that the record there used.
pub(super) const NONCES: &[u8] = b"nonce/";
/// bucket (u32) -> what stands at its root.
pub(super) const TOPS: &[u8] = b"map/top/";

pub(super) fn leaf(index: u64) -> Vec<u8> {
    [LEAVES, &index.to_be_bytes()].concat()
}

/// SHA-256(PAE) -> index.
pub(super) fn index_of(record: &Digest) -> Vec<u8> {
    [INDEX, &record.as_bytes()[..]].concat()
}

pub(super) fn nonce(index: u64) -> Vec<u8> {
    [NONCES, &index.to_be_bytes()].concat()
}

/// Key id -> index of the revocation or rotation that ended it.
pub(super) fn retired(owner: &Digest) -> Vec<u8> {
    [RETIRED, &owner.as_bytes()[..]].concat()
}

/// Rows of which there are as many as records, or more. Ascending.
pub(super) const COLD: &[Cold] = &[
    Cold { prefix: INDEX, looked_up: true },
    Cold { prefix: ENTRIES, looked_up: false },
    Cold { prefix: LISTS, looked_up: false },
    Cold { prefix: TOPS, looked_up: false },
    Cold { prefix: RETIRED, looked_up: true },
];

/// Cold rows from which on they go into a run: some thirty thousand records, 20 MiB.
pub(super) const ENOUGH: usize = 1 << 17;

/// Map key -> its list in compact form.
pub(super) fn list(key: &MapKey) -> Vec<u8> {
    [LISTS, key.as_bytes()].concat()
}

/// The rows of a bucket's lists: from the first on, and before the second.
pub(super) fn lists(bucket: u32) -> (Vec<u8>, Option<Vec<u8>>) {
    let first = |bucket: u32| first_key(bucket).map(|key| [LISTS, &key].concat());
    // A bucket that does not exist has no rows: from the end to the end.
    let from = first(bucket).or_else(|| successor(LISTS)).unwrap_or_default();
    (from, first(bucket + 1).or_else(|| successor(LISTS)))
}

pub(super) fn top(bucket: u32) -> Vec<u8> {
    [TOPS, &bucket.to_be_bytes()].concat()
}

/// Prefix of a map key's entries: then index -> leaf hash.
pub(super) fn map_entries(key: &MapKey) -> Vec<u8> {
    [ENTRIES, key.as_bytes()].concat()
}

/// A tile's or bundle's file.
pub(super) fn public(path: &TilePath) -> String {
    format!("public/{path}")
}

/// The file of the envelopes of 256 log entries.
pub(super) fn pack(number: u64) -> String {
    format!("envelopes/{}", index_path(number))
}

pub(super) fn number(bytes: &[u8]) -> Option<u64> {
    bytes.try_into().ok().map(u64::from_be_bytes)
}

pub(super) fn signed(size: u64, root: &Digest) -> Vec<u8> {
    [&size.to_be_bytes()[..], root.as_bytes()].concat()
}

/// A row that holds a number.
pub(super) fn numbered(key: Vec<u8>, number: u64) -> Change {
    (key, Some(number.to_be_bytes().to_vec()))
}

/// The rows that say whose store it is, and what was signed last.
pub(super) fn identity(origin: &str, key: &PublicKey, size: u64, root: &Digest) -> Vec<Change> {
    let put = |key: &[u8], value: Vec<u8>| (key.to_vec(), Some(value));
    vec![
        put(FORMAT, FORMAT_VERSION.into()),
        put(ORIGIN, origin.into()),
        put(REGISTRY_KEY, key.to_string().into()),
        put(SIGNED, signed(size, root)),
    ]
}

pub(super) fn parse_signed(bytes: &[u8]) -> Option<(u64, Digest)> {
    let (size, root) = bytes.split_first_chunk::<8>()?;
    Some((u64::from_be_bytes(*size), Digest::try_from(root).ok()?))
}
