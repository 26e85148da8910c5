//! Filling a log with made-up entries, for benchmarks: what ten million records cost to find, prove and start up on
//! has nothing to do with what ten million signatures cost to make.
//!
//! What comes out is a log like any other of whose records only the leaves are left: every record counts as erased, and
//! its owner's signature, which nobody checks without the envelope, is noise. It goes through the same commit.
//! So that no such log is taken for a real one, its origin has to say what it is.

use super::{
    Registry, RegistryError,
    commit::{Batch, lock},
};
use crate::format::{
    leaf::Leaf,
    map::{MapEntry, MapKey},
    packs::Slot,
};

/// What the origin of a log that may be filled begins with.
pub const ORIGIN_PREFIX: &str = "cairn.bench/";

impl Registry {
    /// Appends erased records in one batch, durable on return: for each its leaf and its map keys.
    ///
    /// # Errors
    /// [`RegistryError::WrongOrigin`] for a log that is not a benchmark's, [`RegistryError::Halted`], [`RegistryError::Store`].
    pub fn fill(&self, records: impl Iterator<Item = (Leaf, Vec<MapKey>)>) -> Result<(), RegistryError> {
        if !self.origin.starts_with(ORIGIN_PREFIX) {
            let expected = format!("{ORIGIN_PREFIX}...");
            return Err(RegistryError::WrongOrigin { expected, got: self.origin.clone() });
        }
        let _turn = self.turn()?;
        if let Some(cause) = self.halted() {
            return Err(RegistryError::Halted { cause });
        }
        let (size, mut batch) = (self.size(), Batch::default());
        for (index, (leaf, keys)) in (size..).zip(records) {
            batch.index(index, &leaf);
            for key in &keys {
                batch.map.entry(*key).or_default().push(MapEntry { index, leaf_hash: leaf.hash() });
            }
            batch.leaves.push((leaf.encode().to_vec(), Slot::Erased(keys)));
        }
        self.write_batch(size, &mut lock(&self.writer), batch)
    }
}
