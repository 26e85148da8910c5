//! Which records credit a contributor with what is seen: look-ups by the map's lists, a bounded number for each answer.

use std::collections::BTreeMap;

use cairn_log::format::map::MapKey;
use cairn_log::{Digest, LogEntry, Registry};

use crate::error::EngineError;
use crate::records::{bindings, corrections};

/// Entries of one list that are looked at, at most: anybody may claim anything.
const MAX_LISTED: usize = 64;
/// Records that are looked at for one answer, at most.
const MAX_RECORDS: usize = 1024;
/// Photographs whose lists are looked at for one answer, at most.
const MAX_PHOTOGRAPHS: usize = 4096;

/// A record that credits a contributor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crediting {
    /// Its place in the log.
    pub index: u64,
    /// Whether a curator bound this contributor's name to its owner's key, or to one that rotations join with it.
    pub confirmed: bool,
}

/// The records that credit a contributor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Credits {
    /// By log index.
    pub records: Vec<Crediting>,
    /// Whether there may be others, which were not looked at: a complete answer has them.
    pub may_be_more: bool,
}

/// Looks records up for one answer about a scene.
pub struct LookUp<'a> {
    registry: &'a Registry,
    scene: &'a str,
    /// Owners' key ids of the records that were looked at and credit somebody.
    owners: BTreeMap<u64, Option<Digest>>,
    photographs_left: usize,
}

impl<'a> LookUp<'a> {
    /// In this log, about this scene.
    pub fn new(registry: &'a Registry, scene: &'a str) -> Self {
        Self { registry, scene, owners: BTreeMap::new(), photographs_left: MAX_PHOTOGRAPHS }
    }

    /// The claims and contributions that stand and list one of these photographs, or are in the contributor's name.
    ///
    /// # Errors
    /// The registry's.
    pub fn of(&mut self, contributor: &str, photographs: &[Digest]) -> Result<Credits, EngineError> {
        let mut credits = Credits::default();
        let looked_at = photographs.len().min(self.photographs_left);
        self.photographs_left -= looked_at;
        credits.may_be_more = looked_at < photographs.len();
        let views = photographs[..looked_at].iter().map(|photograph| MapKey::view(self.scene, photograph));
        let lists: Vec<MapKey> = std::iter::once(MapKey::contributor(self.scene, contributor)).chain(views).collect();
        let mut found = BTreeMap::new();
        for list in lists {
            let entries = self.registry.listed(&list, 0, MAX_LISTED + 1)?;
            credits.may_be_more |= entries.len() > MAX_LISTED;
            for entry in entries.iter().take(MAX_LISTED) {
                if self.owners.len() >= MAX_RECORDS && !self.owners.contains_key(&entry.index) {
                    credits.may_be_more = true;
                    break;
                }
                if let Some(owner) = self.owner_of(entry.index)? {
                    found.insert(entry.index, owner);
                }
            }
        }
        let bound = bindings::newest(self.registry, self.scene, contributor)?.and_then(|bound| bound.key);
        for (index, owner) in found {
            let confirmed = match bound {
                Some(key) => bindings::one_owner(self.registry, &owner, &key.id())?,
                None => false,
            };
            credits.records.push(Crediting { index, confirmed });
        }
        Ok(credits)
    }

    /// The key id of a record's owner, where it credits them and stands.
    fn owner_of(&mut self, index: u64) -> Result<Option<Digest>, EngineError> {
        if let Some(known) = self.owners.get(&index) {
            return Ok(*known);
        }
        let owner = match self.registry.entry(index)? {
            LogEntry::Record(stored) if stored.record.kind.credits() => {
                let is_upheld = corrections::is_upheld(self.registry, &stored.leaf.record)?;
                is_upheld.then_some(stored.leaf.owner)
            }
            LogEntry::Record(_) | LogEntry::Erased { .. } | LogEntry::Map { .. } => None,
        };
        self.owners.insert(index, owner);
        Ok(owner)
    }
}

#[cfg(test)]
#[path = "credits_tests.rs"]
mod tests;
