//! What the log's readers ask for: entries, records, proofs, tiles.

use super::{
    error::{RegistryError, inconsistent},
    layout, reload,
    shared::{Shared, State},
};
use crate::format::{
    digest::Digest,
    dsse::Envelope,
    heir::Ending,
    leaf::Leaf,
    map::{MapEntry, MapKey},
    map_leaf::{Entry, MapLeaf},
    merkle::{self, ProofError},
    packs::{self, Slot},
    record::{OwnerRecord, RecordKind},
    signed::SignedRecord,
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

    /// The record, where it is one that was not erased.
    fn into_record(self) -> Result<StoredRecord, RegistryError> {
        match self {
            Self::Record(stored) => Ok(*stored),
            Self::Erased { index, .. } => Err(RegistryError::Erased { index }),
            Self::Map { index, .. } => Err(RegistryError::NotARecord { index }),
        }
    }
}

/// As [`super::Registry::prove_inclusion`].
pub(super) fn prove_inclusion(shared: &Shared, index: u64, size: u64) -> Result<Vec<Digest>, RegistryError> {
    let state = shared.read();
    reached(size, &state)?;
    state.proven(index, size)
}

/// As [`super::Registry::record`].
pub(super) fn record(shared: &Shared, index: u64) -> Result<StoredRecord, RegistryError> {
    entry(shared, index)?.into_record()
}

/// As [`super::Registry::entry`].
pub(super) fn entry(shared: &Shared, index: u64) -> Result<LogEntry, RegistryError> {
    let size = shared.size();
    if index >= size {
        return Err(RegistryError::NoSuchRecord { index, size });
    }
    stored_entry(shared, index)
}

/// As [`super::Registry::listed`], for the log's first `size` entries.
pub(super) fn entries_below(
    shared: &Shared,
    key: &MapKey,
    size: u64,
    from: u64,
    limit: usize,
) -> Result<Vec<MapEntry>, RegistryError> {
    let prefix = layout::map_entries(key);
    let rows = shared.store.scan(&prefix, &from.to_be_bytes(), limit)?;
    let entries = rows.iter().map(|(row, value)| {
        let index = row.strip_prefix(prefix.as_slice()).and_then(layout::number);
        match (index, Digest::try_from(value.as_slice())) {
            (Some(index), Ok(leaf_hash)) => Ok(MapEntry { index, leaf_hash }),
            _ => Err(inconsistent("map", format!("entry {row:?} of {} bytes", value.len()))),
        }
    });
    entries.filter(|entry| entry.as_ref().map_or(true, |entry| entry.index < size)).collect()
}

/// As [`super::Registry::tile`].
pub(super) fn tile(shared: &Shared, path: &TilePath) -> Result<Option<Vec<u8>>, RegistryError> {
    let size = {
        let state = shared.read();
        if path.kind != TileKind::Entries {
            return state.tree.tile(path, state.size);
        }
        state.size
    };
    let held = TilePath::in_tree(path.kind, path.index, size).filter(|held| path.width <= held.width);
    let Some(first) = held.and_then(|held| held.first()) else { return Ok(None) };
    let leaves = (first..first + u64::from(path.width)).map(|index| leaf_bytes(shared, index));
    let leaves = leaves.collect::<Result<Vec<_>, _>>()?;
    let bundle = encode_entries(leaves.iter().map(Vec::as_slice));
    bundle.map(Some).map_err(|e| inconsistent(&path.to_string(), e.to_string()))
}

/// As [`super::Registry::find`].
pub(super) fn find(shared: &Shared, record: &Digest) -> Result<Option<u64>, RegistryError> {
    let size = shared.size();
    Ok(index_of(shared, record)?.filter(|index| *index < size))
}

/// Index of the revocation or rotation that ended the key with this id, as far as the log is written.
pub(super) fn ended_id(shared: &Shared, owner: &Digest) -> Result<Option<u64>, RegistryError> {
    let size = shared.size();
    let index = reload::number_at(shared.store.as_ref(), &layout::retired(owner), || format!("end of key {owner}"))?;
    Ok(index.filter(|index| *index < size))
}

/// How the key with this id ended, as far as the log is written.
pub(super) fn ending(shared: &Shared, key: &Digest) -> Result<Option<Ending>, RegistryError> {
    ended_id(shared, key)?.map(|index| ending_at(shared, index)).transpose()
}

/// How the record at `index`, a revocation or rotation, ends a key.
pub(super) fn ending_at(shared: &Shared, index: u64) -> Result<Ending, RegistryError> {
    let leaf = record_leaf(shared, index)?;
    Ok(Ending { index, to: (leaf.kind == RecordKind::Rotation).then_some(leaf.owner) })
}

pub(super) fn index_of(shared: &Shared, record: &Digest) -> Result<Option<u64>, RegistryError> {
    reload::number_at(shared.store.as_ref(), &layout::index_of(record), || format!("index of {record}"))
}

/// As [`super::Registry::record`], for an index that the caller knows to be there.
pub(super) fn stored(shared: &Shared, index: u64) -> Result<StoredRecord, RegistryError> {
    stored_entry(shared, index)?.into_record()
}

/// What a record says, and how large that is.
pub(super) struct Said {
    /// The body.
    pub(super) record: OwnerRecord,
    /// Bytes of its envelope.
    pub(super) bytes: usize,
}

/// What the record at `index` says, none where it was erased; its signatures are not verified again.
pub(super) fn said(shared: &Shared, index: u64) -> Result<Option<Said>, RegistryError> {
    let refuse = |what: String| inconsistent(&format!("record {index}"), what);
    match slot(shared, index)? {
        Slot::Record(json) => {
            let envelope = Envelope::parse(&json).map_err(|e| refuse(e.to_string()))?;
            let record = OwnerRecord::parse(&envelope.payload).map_err(|e| refuse(e.to_string()))?;
            Ok(Some(Said { record, bytes: json.len() }))
        }
        Slot::Erased(_) => Ok(None),
        Slot::MapLeaf => Err(refuse("its envelope is missing".into())),
    }
}

/// The leaf of a record, erased or not.
pub(super) fn record_leaf(shared: &Shared, index: u64) -> Result<Leaf, RegistryError> {
    match decoded_leaf(shared, index)? {
        Entry::Record(leaf) => Ok(leaf),
        Entry::Map(_) => Err(RegistryError::NotARecord { index }),
    }
}

/// Entry `index` with everything verified that one entry can tell about itself.
pub(super) fn stored_entry(shared: &Shared, index: u64) -> Result<LogEntry, RegistryError> {
    let place = format!("record {index}");
    let leaf = match decoded_leaf(shared, index)? {
        Entry::Record(leaf) => leaf,
        Entry::Map(leaf) => {
            leaf.verify(&shared.origin, index, &shared.key.public())
                .map_err(|e| inconsistent(&place, e.to_string()))?;
            return Ok(LogEntry::Map { index, leaf });
        }
    };
    let json = match slot(shared, index)? {
        Slot::Record(json) => json,
        Slot::Erased(keys) => return Ok(LogEntry::Erased { index, leaf, keys }),
        Slot::MapLeaf => return Err(inconsistent(&place, "its envelope is missing".into())),
    };
    let signed = SignedRecord::parse(&json).map_err(|e| inconsistent(&place, e.to_string()))?;
    let (envelope, record, again) = signed.into_parts();
    if again != leaf {
        return Err(inconsistent(&place, "the leaf is not this envelope's".into()));
    }
    Ok(LogEntry::Record(Box::new(StoredRecord { index, leaf, envelope, record })))
}

fn decoded_leaf(shared: &Shared, index: u64) -> Result<Entry, RegistryError> {
    Entry::decode(&leaf_bytes(shared, index)?).map_err(|e| inconsistent(&format!("leaf {index}"), e.to_string()))
}

pub(super) fn leaf_bytes(shared: &Shared, index: u64) -> Result<Vec<u8>, RegistryError> {
    reload::leaf_bytes(shared.store.as_ref(), &shared.files, index)
}

fn slot(shared: &Shared, index: u64) -> Result<Slot, RegistryError> {
    let width = u64::from(TILE_WIDTH);
    let (path, at) = (layout::pack(index / width), (index % width) as usize);
    let read_at = |offset, length| -> Result<Vec<u8>, RegistryError> {
        let bytes = shared.files.read_at(&path, offset, length)?;
        bytes.ok_or_else(|| inconsistent(&path, "the file is missing".into()))
    };
    let slot = packs::nth(at, read_at).map_err(|e| match e {
        RegistryError::Pack(e) => inconsistent(&path, e.to_string()),
        other => other,
    })?;
    slot.ok_or_else(|| inconsistent(&path, format!("it ends before its entry {at}")))
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

    pub(super) fn hold_to_signed(&self, size: u64, root: &Digest) -> Result<(), RegistryError> {
        if size == self.size && *root != self.root {
            return Err(inconsistent(
                "tiles",
                format!("they give root {root} at size {size}, {} was signed", self.root),
            ));
        }
        Ok(())
    }
}

pub(super) fn rotten(e: &ProofError) -> RegistryError {
    inconsistent("tiles", format!("a proof made of them does not verify: {e}"))
}

pub(super) fn reached(size: u64, state: &State) -> Result<(), RegistryError> {
    if size > state.size {
        return Err(ProofError::IndexBeyondSize { index: size, size: state.size }.into());
    }
    Ok(())
}
