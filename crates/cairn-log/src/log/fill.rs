//! Filling a log with made-up entries, for benchmarks: what ten million records cost to find, prove and start up on
//! has nothing to do with what ten million signatures cost to make.
//!
//! What comes out is a log like any other of whose records only the leaves are left: every record counts as erased, and
//! its owner's signature, which nobody checks without the envelope, is noise. It goes through the same commit.
//! So that no such log is taken for a real one, its origin has to say what it is.

use super::{
    commit::{self, Batch},
    error::RegistryError,
    shared::{Shared, lock},
};
use crate::format::{
    leaf::Leaf,
    map::{MapEntry, MapKey},
    packs::Slot,
};

/// What the origin of a log that may be filled begins with.
pub const ORIGIN_PREFIX: &str = "cairn.bench/";

/// As [`super::Registry::fill`].
pub(super) fn fill(shared: &Shared, records: impl Iterator<Item = (Leaf, Vec<MapKey>)>) -> Result<(), RegistryError> {
    if !shared.origin.starts_with(ORIGIN_PREFIX) {
        let expected = format!("{ORIGIN_PREFIX}...");
        return Err(RegistryError::WrongOrigin { expected, got: shared.origin.clone() });
    }
    let _turn = shared.turn()?;
    if let Some(cause) = shared.halted() {
        return Err(RegistryError::Halted { cause });
    }
    let (size, mut batch) = (shared.size(), Batch::default());
    for (index, (leaf, keys)) in (size..).zip(records) {
        batch.index(index, &leaf);
        for key in &keys {
            batch.map.entry(*key).or_default().push(MapEntry { index, leaf_hash: leaf.hash() });
        }
        batch.leaves.push((leaf.encode().to_vec(), Slot::Erased(keys)));
    }
    commit::write_batch(shared, size, &mut lock(&shared.writer), batch)
}
