//! Group commit: submissions that wait together are written and flushed together.
//!
//! There is no writer thread. The first submitter who finds nobody writing takes
//! all that waits and writes it; those who come meanwhile wait for the next round. A flush
//! costs milliseconds, so under load a round carries many records.
//!
//! A round's order is what a crash at any moment leaves right: envelopes into their pack, flushed; then leaves,
//! indices, the map's rows and the size and root that are about to be signed, all in one write of the store, flushed,
//! and at the same time the anchor, where there is one; only then the signature. Envelopes that no leaf speaks of are
//! overwritten by the next round, or taken in by the next start where the anchor speaks of them.

use std::{
    collections::BTreeMap,
    mem,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Instant,
};

use super::{
    anchor::{Anchor, Round},
    error::{RegistryError, inconsistent},
    layout,
    nonce::NONCE_LIFETIME,
    read,
    shared::{Outcome, Placed, Shared, State, Turn, Waiting, Writer, lock},
    submit::{self, Admitted, Planned},
};
use crate::{
    format::{
        checkpoint::Checkpoint,
        digest::Digest,
        dsse::Envelope,
        leaf::Leaf,
        map::{MapEntry, MapKey, keys_of},
        map_leaf::MapLeaf,
        merkle::{self, leaf_hash},
        packs::Slot,
        proof::TlogProof,
        signed::SignedRecord,
        tile::TILE_WIDTH,
    },
    log::{
        map::{Buckets, Row, Staged},
        store::{Change, Store, StoreError},
    },
};

/// What a submitter gets once the record is durable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    /// The record's place in the log.
    pub index: u64,
    /// Hash of its leaf.
    pub leaf_hash: Digest,
    /// Always true: a receipt exists only behind a flush.
    pub durable: bool,
    /// Whether this record was in the log before this submission.
    pub resubmitted: bool,
    /// A signed checkpoint that covers the record.
    pub checkpoint: String,
    /// The checkpoint's size.
    pub size: u64,
    /// Proof that the leaf lies in the tree of that size.
    pub inclusion: Vec<Digest>,
    /// The envelope with the registry's signature.
    pub envelope: Envelope,
}

impl Receipt {
    /// The evidence that the record is in the log, to be kept beside its envelope.
    pub fn tlog_proof(&self) -> TlogProof {
        TlogProof {
            extra: None,
            index: self.index,
            hashes: self.inclusion.clone(),
            checkpoint: self.checkpoint.clone(),
        }
    }
}

/// What a round writes.
#[derive(Default)]
pub(super) struct Batch {
    entries: Vec<Change>,
    /// Leaves and what their packs hold, in order.
    pub(super) leaves: Vec<(Vec<u8>, Slot)>,
    pub(super) map: BTreeMap<MapKey, Vec<MapEntry>>,
    planned: Planned,
    kept: Vec<Envelope>,
    /// Where its envelopes are in their pack already: what it must come to.
    found: Option<Round>,
}

/// As [`super::Registry::submit`].
pub(super) fn submit(shared: &Shared, candidate: SignedRecord) -> Result<Receipt, RegistryError> {
    submit::check_origin(shared, &candidate)?;
    let slot = Arc::new(Mutex::new(None));
    let mut queue = lock(&shared.queue);
    queue.waiting.push(Waiting { candidate, slot: slot.clone() });
    loop {
        if let Some(outcome) = lock(&slot).take() {
            drop(queue);
            return receipt(shared, outcome?);
        }
        if queue.busy.is_some() {
            // The round that is being written may never end; this submission is in none.
            if let Some(cause) = shared.halted()
                && queue.leave(&slot)
            {
                return Err(RegistryError::Halted { cause });
            }
            queue = shared.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
            continue;
        }
        queue.busy = Some(Instant::now());
        let mut turn = Turn { shared, batch: mem::take(&mut queue.waiting) };
        drop(queue);
        let outcomes = write_round(shared, &turn.batch);
        // Out of the turn: whoever wakes early takes an outcome away, and must not look like one who got none.
        for (waiting, outcome) in mem::take(&mut turn.batch).iter().zip(outcomes) {
            *lock(&waiting.slot) = Some(outcome);
        }
        drop(turn);
        queue = lock(&shared.queue);
    }
}

fn write_round(shared: &Shared, round: &[Waiting]) -> Vec<Outcome> {
    if let Some(cause) = shared.halted() {
        return round.iter().map(|_| Err(RegistryError::Halted { cause: cause.clone() })).collect();
    }
    let size = shared.size();
    let mut writer = lock(&shared.writer);
    let mut batch = Batch::default();
    let placed: Vec<_> = round.iter().map(|w| place(shared, &w.candidate, size, &writer, &mut batch)).collect();
    let written = if batch.leaves.is_empty() { Ok(()) } else { write_batch(shared, size, &mut writer, batch) };
    drop(writer);
    let outcomes = placed.into_iter().map(|placed| {
        let placed = placed?;
        match &written {
            Ok(()) => Ok(placed),
            // A record that was in the log before does not depend on this round's luck.
            Err(_) if placed.index < size => Ok(placed),
            Err(e) => Err(e.again()),
        }
    });
    outcomes.collect()
}

/// Finds the record's place in the log, old or new.
fn place(
    shared: &Shared,
    candidate: &SignedRecord,
    size: u64,
    writer: &Writer,
    batch: &mut Batch,
) -> Result<Placed, RegistryError> {
    let digest = candidate.leaf().record;
    if let Some((index, _)) = batch.planned.records.get(&digest) {
        let envelope = batch.kept[(index - size) as usize].clone();
        return Ok(Placed { index: *index, resubmitted: true, envelope });
    }
    if let Some(index) = read::index_of(shared, &digest)? {
        let envelope = read::stored(shared, index)?.envelope;
        return Ok(Placed { index, resubmitted: true, envelope });
    }
    let admitted = submit::admit(shared, candidate, &shared.read().tree, size, writer, &batch.planned)?;
    let index = size + batch.leaves.len() as u64;
    batch.add(index, candidate, &admitted);
    Ok(Placed { index, resubmitted: false, envelope: admitted.envelope })
}

/// Writes, flushes, and only then signs.
pub(super) fn write_batch(shared: &Shared, size: u64, writer: &mut Writer, batch: Batch) -> Result<(), RegistryError> {
    commit(shared, size, writer, batch).inspect_err(|e| drop(shared.halt(&e.to_string())))
}

fn commit(shared: &Shared, size: u64, writer: &mut Writer, mut batch: Batch) -> Result<(), RegistryError> {
    let staged = close_with_the_map(shared, size, &mut batch)?;
    let (new_size, root) = {
        let mut state = shared.write();
        for (leaf, _) in &batch.leaves {
            state.tree.push(leaf_hash(leaf));
        }
        let new_size = size + batch.leaves.len() as u64;
        (new_size, merkle::root_at(&state.tree, new_size)?)
    };
    let signed = Checkpoint::new(&shared.origin, new_size, root);
    let envelopes = || match &batch.found {
        Some(round) => round.comes_to(&signed, size),
        None => append_to_packs(shared, size, writer.pack_length, &batch.leaves),
    };
    let pack_length = beside_anchor(shared, envelopes, |anchor| anchor.prepare(&signed))?;
    // Somebody may have stopped the log meanwhile, who knows better what it is.
    if let Some(cause) = shared.halted() {
        return Err(RegistryError::Halted { cause });
    }
    batch.entries.push((layout::SIGNED.to_vec(), Some(layout::signed(new_size, &root))));
    let rows = || Ok(shared.store.put(batch.entries).and_then(|()| shared.store.flush())?);
    beside_anchor(shared, rows, Anchor::adopt)?;
    read_back(shared, size, &batch.leaves)?;
    let note = signed.sign(&shared.key)?;
    writer.pack_length = pack_length;
    writer.used.extend(batch.planned.nonces);
    writer.used.retain(|_, index| new_size - *index <= NONCE_LIFETIME);
    let mut state = shared.write();
    state.map.apply(&staged);
    state.size = new_size;
    state.root = root;
    state.checkpoint = note.to_string();
    Ok(())
}

/// Does a part of a round, and at the same time, where there is an anchor, something with that: a file system flushes
/// both for the price of one.
fn beside_anchor<T>(
    shared: &Shared,
    part: impl FnOnce() -> Result<T, RegistryError>,
    act: impl FnOnce(&Anchor) -> Result<(), StoreError> + Send,
) -> Result<T, RegistryError> {
    let Some(anchor) = &shared.anchor else { return part() };
    let (done, anchored) = thread::scope(|scope| {
        let anchored = scope.spawn(|| act(anchor));
        (part(), anchored.join())
    });
    let done = done?;
    anchored.map_err(|_| RegistryError::Halted { cause: "the anchor's writer panicked".into() })??;
    Ok(done)
}

/// Takes in a round that a crash left in the packs after the anchor was told of it.
///
/// # Errors
/// [`RegistryError::RolledBack`] where its envelopes do not come to what was about to be signed; [`RegistryError::Store`].
pub(super) fn take_up(shared: &Shared, round: Round) -> Result<(), RegistryError> {
    let (size, mut writer, mut batch) = (shared.size(), lock(&shared.writer), Batch::default());
    for envelope in &round.envelopes {
        let placed = SignedRecord::open(envelope.clone()).map_err(RegistryError::from).and_then(|candidate| {
            submit::check_origin(shared, &candidate)?;
            place(shared, &candidate, size, &writer, &mut batch)
        });
        let problem = match placed {
            Ok(placed) if placed.resubmitted => "a record that is in the log before".into(),
            Ok(placed) if placed.envelope != *envelope => "a record with other signatures than it would get".into(),
            Ok(_) => continue,
            Err(e @ RegistryError::Store(_)) => return Err(e),
            Err(e) => e.to_string(),
        };
        return Err(round.refuse(size, &problem));
    }
    batch.found = Some(round);
    write_batch(shared, size, &mut writer, batch)
}

/// Works out the map with the batch's records in it, and appends its leaf.
fn close_with_the_map(shared: &Shared, size: u64, batch: &mut Batch) -> Result<Staged, RegistryError> {
    let staged = shared.read().map.stage(&StoredBuckets(shared.store.as_ref()), &batch.map)?;
    for (key, entries) in &batch.map {
        batch.entries.extend(entries.iter().map(|entry| entry_row(key, entry)));
    }
    batch.entries.extend(staged_rows(&staged));
    let index = size + batch.leaves.len() as u64;
    let leaf = MapLeaf::sign(&shared.origin, index, staged.root, &shared.key).encode().to_vec();
    batch.entries.push((layout::leaf(index), Some(leaf.clone())));
    batch.leaves.push((leaf, Slot::MapLeaf));
    Ok(staged)
}

/// The row that lists an entry under a map key.
pub(super) fn entry_row(key: &MapKey, entry: &MapEntry) -> Change {
    let row = [&layout::map_entries(key)[..], &entry.index.to_be_bytes()].concat();
    (row, Some(entry.leaf_hash.as_bytes().to_vec()))
}

/// The rows of the map that a batch changes.
pub(super) fn staged_rows(staged: &Staged) -> impl Iterator<Item = Change> {
    let lists = staged.rows.iter().map(|(key, list)| (layout::list(key), Some(list.clone())));
    lists.chain(staged.tops.iter().map(|(at, top)| (layout::top(*at), Some(top.encode().to_vec()))))
}

/// Appends frames to one pack or several; gives the length of the pack that the next entry goes into.
fn append_to_packs(shared: &Shared, size: u64, length: u64, leaves: &[(Vec<u8>, Slot)]) -> Result<u64, RegistryError> {
    let width = u64::from(TILE_WIDTH);
    let (mut index, mut offset, mut rest) = (size, length, leaves);
    while !rest.is_empty() {
        let room = (width - index % width) as usize;
        let (here, behind) = rest.split_at(room.min(rest.len()));
        let frames: Vec<u8> = here.iter().flat_map(|(_, slot)| slot.to_frame()).collect();
        shared.files.append(&layout::pack(index / width), offset, &frames)?;
        index += here.len() as u64;
        offset = if index.is_multiple_of(width) { 0 } else { offset + frames.len() as u64 };
        rest = behind;
    }
    Ok(offset)
}

/// A signature over leaves that the store does not give back could never be honoured.
fn read_back(shared: &Shared, size: u64, leaves: &[(Vec<u8>, Slot)]) -> Result<(), RegistryError> {
    let read = shared.store.scan(layout::LEAVES, &size.to_be_bytes(), leaves.len())?;
    for (at, (leaf, _)) in leaves.iter().enumerate() {
        let index = size + at as u64;
        if read.get(at).is_none_or(|(key, value)| *key != layout::leaf(index) || value != leaf) {
            let what = "reads back differently from what was written".into();
            return Err(inconsistent(&format!("leaf {index}"), what));
        }
    }
    Ok(())
}

fn receipt(shared: &Shared, placed: Placed) -> Result<Receipt, RegistryError> {
    let state: &State = &shared.read();
    Ok(Receipt {
        index: placed.index,
        leaf_hash: state.tree.leaf(placed.index)?,
        durable: true,
        resubmitted: placed.resubmitted,
        checkpoint: state.checkpoint.clone(),
        size: state.size,
        inclusion: state.proven(placed.index, state.size)?,
        envelope: placed.envelope,
    })
}

/// The map's buckets as the store keeps them.
pub(super) struct StoredBuckets<'a>(pub(super) &'a dyn Store);

impl Buckets for StoredBuckets<'_> {
    fn load(&self, bucket: u32) -> Result<Vec<Row>, StoreError> {
        let (from, to) = layout::lists(bucket);
        let rows = self.0.range(&from, to.as_deref(), usize::MAX)?.into_iter();
        rows.map(|(key, list)| Ok((list_key(&key)?, list))).collect()
    }
}

/// The map key of a list's row.
fn list_key(row: &[u8]) -> Result<MapKey, StoreError> {
    let key = row.strip_prefix(layout::LISTS).and_then(|key| key.try_into().ok());
    key.map(MapKey::from_bytes).ok_or_else(|| {
        let cause = format!("row {row:02x?} has no map key; restore the newest backup");
        StoreError::new("range", "the map's lists", cause)
    })
}

impl Batch {
    fn add(&mut self, index: u64, candidate: &SignedRecord, admitted: &Admitted) {
        let (record, leaf) = (candidate.record(), candidate.leaf().encode().to_vec());
        let digest = candidate.leaf().record;
        self.index(index, candidate.leaf());
        self.entries.push((layout::nonce(index), Some(record.nonce.as_bytes().to_vec())));
        for key in keys_of(record, admitted.replaced_owner) {
            self.map.entry(key).or_default().push(MapEntry { index, leaf_hash: leaf_hash(&leaf) });
        }
        self.leaves.push((leaf, Slot::Record(admitted.envelope.to_json().into_bytes())));
        self.planned.records.insert(digest, (index, record.owner_key));
        self.planned.nonces.insert(record.nonce, index);
        if let Some(ended) = admitted.retires {
            self.entries.push(layout::numbered(layout::retired(&ended), index));
            self.planned.retired.insert(ended, index);
        }
        self.kept.push(admitted.envelope.clone());
    }

    /// The rows of a record's leaf and of its index by digest.
    pub(super) fn index(&mut self, index: u64, leaf: &Leaf) {
        self.entries.push((layout::leaf(index), Some(leaf.encode().to_vec())));
        self.entries.push(layout::numbered(layout::index_of(&leaf.record), index));
    }
}

#[cfg(test)]
#[path = "commit_tests.rs"]
mod tests;
