//! Which key a contributor's name stands for, as curators say: what makes a claim confirmed.

use cairn_log::format::heir::same_owner;
use cairn_log::format::map::MapKey;
use cairn_log::{Digest, LogEntry, PublicKey, Registry, StoredRecord};

use crate::error::EngineError;
use crate::records::corrections;

/// A binding that counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bound {
    /// Its place in the log.
    pub index: u64,
    /// The key that it names; none where it was erased.
    pub key: Option<PublicKey>,
}

/// Of the bindings of a contributor's name in a scene that stand the newest, as complete answers have it. Only curators
/// enter them, so a name has few.
///
/// # Errors
/// The registry's.
pub fn newest(registry: &Registry, scene: &str, contributor: &str) -> Result<Option<Bound>, EngineError> {
    let listed = registry.listed(&MapKey::binding(scene, contributor), 0, usize::MAX)?;
    for entry in listed.iter().rev() {
        if corrections::is_upheld(registry, &registry.leaf(entry.index)?.record)? {
            let key = match registry.entry(entry.index)? {
                LogEntry::Record(stored) => stored.record.identity.key,
                LogEntry::Erased { .. } | LogEntry::Map { .. } => None,
            };
            return Ok(Some(Bound { index: entry.index, key }));
        }
    }
    Ok(None)
}

/// The binding by which a claim's or contribution's name stands for its owner's key, or for one that rotations join with
/// it; none where it is unconfirmed, and for records that give no credit.
///
/// # Errors
/// The registry's.
pub fn confirmed_by(registry: &Registry, stored: &StoredRecord) -> Result<Option<u64>, EngineError> {
    let record = &stored.record;
    if !record.kind.credits() {
        return Ok(None);
    }
    let Some(Bound { index, key: Some(key) }) = newest(registry, &record.scene, &record.identity.contributor)? else {
        return Ok(None);
    };
    Ok(one_owner(registry, &stored.leaf.owner, &key.id())?.then_some(index))
}

/// Whether two keys, by their ids, are one owner's as the log has it today.
///
/// # Errors
/// The registry's.
pub fn one_owner(registry: &Registry, one: &Digest, other: &Digest) -> Result<bool, EngineError> {
    Ok(same_owner(one, other, registry.size(), |key| registry.ending_of(key))?)
}

#[cfg(test)]
#[path = "bindings_tests.rs"]
mod tests;
