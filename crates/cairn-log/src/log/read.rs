//! What the log's readers ask for: entries, records, proofs, tiles.

use super::{Registry, RegistryError, State, layout, reload, reload::inconsistent};
use crate::format::{
    digest::Digest,
    dsse::Envelope,
    heir::{Ending, Heir, heir},
    key::PublicKey,
    leaf::Leaf,
    map::{MapEntry, MapKey},
    map_leaf::{Entry, MapLeaf},
    merkle::{self, ProofError},
    packs::{self, Slot},
    proof::TlogProof,
    record::{OwnerRecord, RecordKind},
    tile::{TILE_WIDTH, TileKind, TilePath, encode_entries},
};

/// A record as the log keeps it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredRecord {
    /// Its place in the log.
    pub index: u64,
    /// Its leaf.
    pub leaf: Leaf,
    /// Its envelope with the registry's signature.
    pub envelope: Envelope,
    /// What the envelope says, its owner's signature verified.
    pub record: OwnerRecord,
}

/// An entry of the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LogEntry {
    /// A record.
    Record(Box<StoredRecord>),
    /// What is left of a record that was erased.
    Erased {
        /// Its place in the log.
        index: u64,
        /// Its leaf.
        leaf: Leaf,
        /// The keys under which the map lists it.
        keys: Vec<MapKey>,
    },
    /// The registry's word on the map over all that stands before.
    Map {
        /// Its place in the log.
        index: u64,
        /// The leaf.
        leaf: MapLeaf,
    },
}

impl LogEntry {
    /// Its place in the log.
    pub const fn index(&self) -> u64 {
        match self {
            Self::Record(stored) => stored.index,
            Self::Erased { index, .. } | Self::Map { index, .. } => *index,
        }
    }
}

impl Registry {
    /// Proof that entry `index` lies in the tree of `size` entries.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index or size that is not there; [`RegistryError::Inconsistent`] for a damaged tile.
    pub fn prove_inclusion(&self, index: u64, size: u64) -> Result<Vec<Digest>, RegistryError> {
        let state = self.read();
        reached(size, &state)?;
        state.proven(index, size)
    }

    /// The evidence that entry `index` is in the log, under the newest checkpoint, or the newest cosigned one where that
    /// holds it.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index that is not there.
    pub fn tlog_proof(&self, index: u64) -> Result<TlogProof, RegistryError> {
        let state = self.read();
        let cosigned = state.cosigned.as_ref().filter(|(size, _)| index < *size);
        let (size, checkpoint) = match cosigned {
            Some((size, note)) => (*size, note.clone()),
            None => (state.size, state.checkpoint.clone()),
        };
        let hashes = state.proven(index, size)?;
        Ok(TlogProof { extra: None, index, hashes, checkpoint })
    }

    /// Proof that the tree of `to` entries begins with the tree of `from` entries.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for `from` 0 or beyond `to`, or a size that is not there.
    pub fn prove_consistency(&self, from: u64, to: u64) -> Result<Vec<Digest>, RegistryError> {
        let state = self.read();
        reached(to, &state)?;
        let proof = merkle::prove_consistency(&state.tree, from, to)?;
        let (first, second) = (merkle::root_at(&state.tree, from)?, merkle::root_at(&state.tree, to)?);
        state.hold_to_signed(to, &second)?;
        merkle::verify_consistency(from, to, &proof, &first, &second).map_err(|e| rotten(&e))?;
        Ok(proof)
    }

    /// Record `index`, its envelope re-verified.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`], [`RegistryError::Erased`];
    /// [`RegistryError::Inconsistent`] where leaf and envelope do not belong together.
    pub fn record(&self, index: u64) -> Result<StoredRecord, RegistryError> {
        match self.entry(index)? {
            LogEntry::Record(stored) => Ok(*stored),
            LogEntry::Erased { .. } => Err(RegistryError::Erased { index }),
            LogEntry::Map { .. } => Err(RegistryError::NotARecord { index }),
        }
    }

    /// Entry `index`, whatever it is, a record's envelope re-verified.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`]; [`RegistryError::Inconsistent`] where what is kept of it does not belong together.
    pub fn entry(&self, index: u64) -> Result<LogEntry, RegistryError> {
        let size = self.size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size });
        }
        self.stored_entry(index)
    }

    /// The records, of one scene or all, in the log's order; erased ones are left out.
    ///
    /// # Errors
    /// As [`Registry::record`].
    pub fn records(&self, scene: Option<&str>) -> Result<Vec<StoredRecord>, RegistryError> {
        let entries = self.page(scene, 0, usize::MAX)?;
        let records = entries.into_iter().filter_map(|entry| match entry {
            LogEntry::Record(stored) => Some(*stored),
            LogEntry::Erased { .. } | LogEntry::Map { .. } => None,
        });
        Ok(records.collect())
    }

    /// At most `limit` of the entries with index `from` or more: those about one scene (records, erased or not), or all.
    ///
    /// # Errors
    /// As [`Registry::entry`].
    pub fn page(&self, scene: Option<&str>, from: u64, limit: usize) -> Result<Vec<LogEntry>, RegistryError> {
        let Some(scene) = scene else {
            return (from..self.size()).take(limit).map(|index| self.stored_entry(index)).collect();
        };
        let listed = self.listed(&MapKey::scene(scene), from, limit)?;
        listed.iter().map(|entry| self.stored_entry(entry.index)).collect()
    }

    /// At most `limit` of a map key's entries with index `from` or more.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn listed(&self, key: &MapKey, from: u64, limit: usize) -> Result<Vec<MapEntry>, RegistryError> {
        self.entries_below(key, self.size(), from, limit)
    }

    /// As [`Registry::listed`], for the log's first `size` entries.
    pub(super) fn entries_below(
        &self,
        key: &MapKey,
        size: u64,
        from: u64,
        limit: usize,
    ) -> Result<Vec<MapEntry>, RegistryError> {
        let prefix = layout::map_entries(key);
        let rows = self.store.scan(&prefix, &from.to_be_bytes(), limit)?;
        let entries = rows.iter().map(|(row, value)| {
            let index = row.strip_prefix(prefix.as_slice()).and_then(layout::number);
            match (index, Digest::try_from(value.as_slice())) {
                (Some(index), Ok(leaf_hash)) => Ok(MapEntry { index, leaf_hash }),
                _ => Err(inconsistent("map", format!("entry {row:?} of {} bytes", value.len()))),
            }
        });
        entries.filter(|entry| entry.as_ref().map_or(true, |entry| entry.index < size)).collect()
    }

    /// The bytes of a tile or of a bundle of entries (leaves), as monitors fetch them; none where the log does not
    /// hold all of it.
    ///
    /// # Errors
    /// [`RegistryError::Store`]; [`RegistryError::Inconsistent`] where a leaf is missing.
    pub fn tile(&self, path: &TilePath) -> Result<Option<Vec<u8>>, RegistryError> {
        let size = {
            let state = self.read();
            if path.kind != TileKind::Entries {
                return state.tree.tile(path, state.size);
            }
            state.size
        };
        let held = TilePath::in_tree(path.kind, path.index, size).filter(|held| path.width <= held.width);
        let Some(first) = held.and_then(|held| held.first()) else { return Ok(None) };
        let leaves = (first..first + u64::from(path.width)).map(|index| self.leaf_bytes(index));
        let leaves = leaves.collect::<Result<Vec<_>, _>>()?;
        let bundle = encode_entries(leaves.iter().map(Vec::as_slice));
        bundle.map(Some).map_err(|e| inconsistent(&path.to_string(), e.to_string()))
    }

    /// Index of the record with this digest (SHA-256 of its PAE), if the log holds it.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn find(&self, record: &Digest) -> Result<Option<u64>, RegistryError> {
        let size = self.size();
        Ok(self.index_of(record)?.filter(|index| *index < size))
    }

    /// Index of the revocation or rotation that ended the key `owner`, if the log holds one.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn ended(&self, owner: &PublicKey) -> Result<Option<u64>, RegistryError> {
        self.ended_id(&owner.id())
    }

    /// As [`Registry::ended`], of the key with this id.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn ended_id(&self, owner: &Digest) -> Result<Option<u64>, RegistryError> {
        let size = self.size();
        let index = reload::number_at(self.store.as_ref(), &layout::retired(owner), || format!("end of key {owner}"))?;
        Ok(index.filter(|index| *index < size))
    }

    /// Who speaks for the key with this id today: itself, or what rotations put in its place.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn heir(&self, owner: &Digest) -> Result<Heir, RegistryError> {
        heir(owner, self.size(), |key| self.ending(key))
    }

    /// How the key with this id ended, as far as the log is written.
    pub(super) fn ending(&self, key: &Digest) -> Result<Option<Ending>, RegistryError> {
        let Some(index) = self.ended_id(key)? else { return Ok(None) };
        let leaf = self.record_leaf(index)?;
        Ok(Some(Ending { index, to: (leaf.kind == RecordKind::Rotation).then_some(leaf.owner) }))
    }

    /// The leaf of the record at `index`, erased or not: its kind, its digest and its owner's key id.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`], [`RegistryError::Inconsistent`].
    pub fn leaf(&self, index: u64) -> Result<Leaf, RegistryError> {
        let size = self.size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size });
        }
        self.record_leaf(index)
    }

    /// What names a record in `replaces`, in the log's order, erased or not: where it stands, and its kind.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn about(&self, record: &Digest) -> Result<Vec<(u64, RecordKind)>, RegistryError> {
        let listed = self.listed(&MapKey::about(record), 0, usize::MAX)?;
        listed.iter().map(|entry| Ok((entry.index, self.record_leaf(entry.index)?.kind))).collect()
    }

    /// Re-reads everything: each leaf, its hash in the tree, its envelope, both signatures, its indices. Gives what is wrong,
    /// nothing where all is well.
    ///
    /// # Errors
    /// [`RegistryError::Store`] where the store cannot be read.
    pub fn check(&self) -> Result<Vec<RegistryError>, RegistryError> {
        let size = self.size();
        let mut faults = Vec::new();
        for index in 0..size {
            match self.check_entry(index) {
                Ok(()) => {}
                Err(RegistryError::Store(e)) => return Err(e.into()),
                Err(fault) => faults.push(fault),
            }
        }
        Ok(faults)
    }

    fn check_entry(&self, index: u64) -> Result<(), RegistryError> {
        let fault = |what: String| Err(inconsistent(&format!("record {index}"), what));
        let (entry, expected) = (self.stored_entry(index)?, self.read().tree.leaf(index)?);
        let (got, digest) = match &entry {
            LogEntry::Record(stored) => (stored.leaf.hash(), Some(stored.leaf.record)),
            LogEntry::Erased { leaf, .. } => (leaf.hash(), Some(leaf.record)),
            LogEntry::Map { leaf, .. } => (leaf.hash(), None),
        };
        if expected != got {
            return fault(format!("leaf hash {got}, the tree holds {expected}"));
        }
        if let LogEntry::Record(stored) = &entry
            && stored.envelope.signature_by(&self.key.public()).is_none()
        {
            return fault("the registry's signature is missing or does not verify".into());
        }
        let Some(digest) = digest else { return Ok(()) };
        match self.index_of(&digest)? {
            Some(found) if found == index => Ok(()),
            found => fault(format!("the index by digest says {found:?}")),
        }
    }

    pub(super) fn index_of(&self, record: &Digest) -> Result<Option<u64>, RegistryError> {
        reload::number_at(self.store.as_ref(), &layout::index_of(record), || format!("index of {record}"))
    }

    /// As [`Registry::record`], for an index that the caller knows to be there.
    pub(super) fn stored(&self, index: u64) -> Result<StoredRecord, RegistryError> {
        match self.stored_entry(index)? {
            LogEntry::Record(stored) => Ok(*stored),
            LogEntry::Erased { .. } => Err(RegistryError::Erased { index }),
            LogEntry::Map { .. } => Err(RegistryError::NotARecord { index }),
        }
    }

    /// The leaf of a record, erased or not.
    pub(super) fn record_leaf(&self, index: u64) -> Result<Leaf, RegistryError> {
        match self.decoded_leaf(index)? {
            Entry::Record(leaf) => Ok(leaf),
            Entry::Map(_) => Err(RegistryError::NotARecord { index }),
        }
    }

    /// Entry `index` with everything verified that one entry can tell about itself.
    fn stored_entry(&self, index: u64) -> Result<LogEntry, RegistryError> {
        let place = format!("record {index}");
        let leaf = match self.decoded_leaf(index)? {
            Entry::Record(leaf) => leaf,
            Entry::Map(leaf) => {
                leaf.verify(&self.origin, index, &self.key.public())
                    .map_err(|e| inconsistent(&place, e.to_string()))?;
                return Ok(LogEntry::Map { index, leaf });
            }
        };
        let json = match self.slot(index)? {
            Slot::Record(json) => json,
            Slot::Erased(keys) => return Ok(LogEntry::Erased { index, leaf, keys }),
            Slot::MapLeaf => return Err(inconsistent(&place, "its envelope is missing".into())),
        };
        let envelope = Envelope::parse(&json).map_err(|e| inconsistent(&place, e.to_string()))?;
        let opened = OwnerRecord::open(&envelope).and_then(|(record, signature)| {
            let again = Leaf::of_opened(&envelope, &record, &signature.sig)?;
            Ok((record, again))
        });
        let (record, again) = opened.map_err(|e| inconsistent(&place, e.to_string()))?;
        if again != leaf {
            return Err(inconsistent(&place, "the leaf is not this envelope's".into()));
        }
        Ok(LogEntry::Record(Box::new(StoredRecord { index, leaf, envelope, record })))
    }

    fn decoded_leaf(&self, index: u64) -> Result<Entry, RegistryError> {
        Entry::decode(&self.leaf_bytes(index)?).map_err(|e| inconsistent(&format!("leaf {index}"), e.to_string()))
    }

    pub(super) fn leaf_bytes(&self, index: u64) -> Result<Vec<u8>, RegistryError> {
        reload::leaf_bytes(self.store.as_ref(), &self.files, index)
    }

    fn slot(&self, index: u64) -> Result<Slot, RegistryError> {
        let width = u64::from(TILE_WIDTH);
        let (path, at) = (layout::pack(index / width), (index % width) as usize);
        let read_at = |offset, length| -> Result<Vec<u8>, RegistryError> {
            let bytes = self.files.read_at(&path, offset, length)?;
            bytes.ok_or_else(|| inconsistent(&path, "the file is missing".into()))
        };
        let slot = packs::nth(at, read_at).map_err(|e| match e {
            RegistryError::Pack(e) => inconsistent(&path, e.to_string()),
            other => other,
        })?;
        slot.ok_or_else(|| inconsistent(&path, format!("it ends before its entry {at}")))
    }
}

impl State {
    /// A proof of inclusion that was verified: hashes come from files, and a proof made of rotten ones would speak against
    /// this log in its own name.
    pub(super) fn proven(&self, index: u64, size: u64) -> Result<Vec<Digest>, RegistryError> {
        let proof = merkle::prove_inclusion(&self.tree, index, size)?;
        let root = merkle::root_at(&self.tree, size)?;
        self.hold_to_signed(size, &root)?;
        merkle::verify_inclusion(&self.tree.leaf(index)?, index, size, &proof, &root).map_err(|e| rotten(&e))?;
        Ok(proof)
    }

    fn hold_to_signed(&self, size: u64, root: &Digest) -> Result<(), RegistryError> {
        if size == self.size && *root != self.root {
            return Err(inconsistent(
                "tiles",
                format!("they give root {root} at size {size}, {} was signed", self.root),
            ));
        }
        Ok(())
    }
}

fn rotten(e: &ProofError) -> RegistryError {
    inconsistent("tiles", format!("a proof made of them does not verify: {e}"))
}

fn reached(size: u64, state: &State) -> Result<(), RegistryError> {
    if size > state.size {
        return Err(ProofError::IndexBeyondSize { index: size, size: state.size }.into());
    }
    Ok(())
}
