//! Which records credit a contributor with what is seen: look-ups by the map's lists, a bounded number for each answer.

use std::collections::BTreeMap;

use cairn_log::format::map::MapKey;
use cairn_log::{Digest, LogEntry, Registry};

use crate::error::EngineError;
use crate::records::{bindings, corrections};

/// Entries of one list that are looked at, at most: anybody may claim anything.
const MAX_LISTED: usize = 64;
/// Entries of one list that are gone through for those of the key that the name is bound to, at most: their leaves alone.
const MAX_SCANNED: usize = 4096;
/// Leaves that are gone through for one answer, at most.
const MAX_LEAVES: usize = 16_384;
/// Records that are looked at for one answer, at most; as many of keys that names are bound to, and as many others.
const MAX_RECORDS: usize = 1024;
/// Photographs whose lists are looked at for one answer, at most.
const MAX_PHOTOGRAPHS: usize = 4096;

/// A record that credits a contributor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crediting {
    /// Its place in the log.
    pub index: u64,
    /// Whether it is in this contributor's name, and a curator bound that to its owner's key, or to one that rotations join
    /// with it.
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
    /// What the records say that were looked at; none of those that credit no contributor.
    known: BTreeMap<u64, Option<Said>>,
    photographs_left: usize,
    leaves_left: usize,
    /// Of keys that names are bound to.
    bound_records_left: usize,
    other_records_left: usize,
}

/// What a record says that credits its owner and stands.
#[derive(Clone)]
struct Said {
    /// Its owner's key id.
    owner: Digest,
    /// The contributor in whose name it is.
    name: String,
}

/// The key that a contributor's name is bound to, and which others are of one owner with it.
struct BoundKey<'a> {
    registry: &'a Registry,
    id: Digest,
    known: BTreeMap<Digest, bool>,
}

/// The entries of a list that are to be looked at, by log index, in two parts.
#[derive(Default)]
struct Listed {
    /// Those of the key that the name is bound to.
    bound: Vec<u64>,
    /// The others.
    others: Vec<u64>,
    /// Whether the list has more.
    has_more: bool,
}

impl<'a> LookUp<'a> {
    /// In this log, about this scene.
    pub fn new(registry: &'a Registry, scene: &'a str) -> Self {
        Self {
            registry,
            scene,
            known: BTreeMap::new(),
            photographs_left: MAX_PHOTOGRAPHS,
            leaves_left: MAX_LEAVES,
            bound_records_left: MAX_RECORDS,
            other_records_left: MAX_RECORDS,
        }
    }

    /// The claims and contributions that stand and list one of these photographs, or are in the contributor's name. Those
    /// of the key that the name is bound to come first, so that a crowd of others cannot hide them.
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
        let bound = bindings::newest(self.registry, self.scene, contributor)?.and_then(|bound| bound.key);
        let mut bound = bound.map(|key| BoundKey { registry: self.registry, id: key.id(), known: BTreeMap::new() });
        let mut found = BTreeMap::new();
        for list in lists {
            let listed = self.listed(&list, bound.as_mut())?;
            credits.may_be_more |= listed.has_more;
            let bound = listed.bound.iter().map(|index| (*index, true));
            for (index, is_bound) in bound.chain(listed.others.iter().map(|index| (*index, false))) {
                let left = if is_bound { &mut self.bound_records_left } else { &mut self.other_records_left };
                if !self.known.contains_key(&index) {
                    if *left == 0 {
                        credits.may_be_more = true;
                        continue;
                    }
                    *left -= 1;
                }
                if let Some(said) = self.said(index)? {
                    found.insert(index, said);
                }
            }
        }
        for (index, Said { owner, name }) in found {
            // The same rule as for the record alone: a curator confirms its own name.
            let confirmed = match bound.as_mut().filter(|_| name == contributor) {
                Some(bound) => bound.is_of(&owner)?,
                None => false,
            };
            credits.records.push(Crediting { index, confirmed });
        }
        Ok(credits)
    }

    /// Which entries of a list are to be looked at.
    fn listed(&mut self, list: &MapKey, mut bound: Option<&mut BoundKey<'_>>) -> Result<Listed, EngineError> {
        let scanned = if bound.is_some() { MAX_SCANNED.min(self.leaves_left) } else { 0 };
        let entries = self.registry.listed(list, 0, scanned.max(MAX_LISTED) + 1)?;
        let mut listed = Listed { has_more: entries.len() > MAX_LISTED, ..Listed::default() };
        for (at, entry) in entries.iter().take(scanned.max(MAX_LISTED)).enumerate() {
            let is_bound = match bound.as_deref_mut().filter(|_| at < scanned) {
                Some(bound) => {
                    self.leaves_left -= 1;
                    bound.is_of(&self.registry.leaf(entry.index)?.owner)?
                }
                None => false,
            };
            let of = if is_bound { &mut listed.bound } else { &mut listed.others };
            if of.len() < MAX_LISTED {
                of.push(entry.index);
            }
        }
        // Together no more than of a list whose name is bound to no key.
        listed.others.truncate(MAX_LISTED - listed.bound.len());
        Ok(listed)
    }

    /// What a record says, where it credits its owner and stands.
    fn said(&mut self, index: u64) -> Result<Option<Said>, EngineError> {
        if let Some(known) = self.known.get(&index) {
            return Ok(known.clone());
        }
        let said = match self.registry.entry(index)? {
            LogEntry::Record(stored) if stored.record.kind.credits() => {
                let is_upheld = corrections::is_upheld(self.registry, &stored.leaf.record)?;
                is_upheld.then_some(Said { owner: stored.leaf.owner, name: stored.record.identity.contributor })
            }
            LogEntry::Record(_) | LogEntry::Erased { .. } | LogEntry::Map { .. } => None,
        };
        self.known.insert(index, said.clone());
        Ok(said)
    }
}

impl BoundKey<'_> {
    /// Whether the key with this id is the bound one, or rotations join the two.
    fn is_of(&mut self, owner: &Digest) -> Result<bool, EngineError> {
        if let Some(known) = self.known.get(owner) {
            return Ok(*known);
        }
        let is_of = bindings::one_owner(self.registry, owner, &self.id)?;
        self.known.insert(*owner, is_of);
        Ok(is_of)
    }
}

#[cfg(test)]
#[path = "credits_tests.rs"]
mod tests;
