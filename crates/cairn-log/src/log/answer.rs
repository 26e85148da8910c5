//! Complete answers, put together from the log and its map at one moment.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeSet,
};

use super::{
    commit::StoredBuckets,
    error::{RegistryError, inconsistent},
    read, reload,
    shared::{Shared, State},
};
use crate::format::{
    answer::{self, Answer, AsOf, Format, List, ListedRecord, MapPart, Source},
    checkpoint::Checkpoint,
    digest::Digest,
    leaf::LEAF_LEN,
    map::MapKey,
    merkle,
    record::OwnerRecord,
};

/// As [`super::Registry::answer`].
pub(super) fn answer(
    shared: &Shared,
    scene: &str,
    view: Option<&Digest>,
    as_of: Option<&str>,
    most: usize,
) -> Result<Answer, RegistryError> {
    loop {
        let (outline, heard) = outline(shared, scene, view, as_of, most)?;
        let answer = filled(shared, outline, most)?;
        // A record that was erased meanwhile says nothing any more, and asks for fewer lists.
        let is_erased = |record: &ListedRecord| record.envelope.is_none() && heard.contains(&record.index);
        if !answer.records.iter().any(is_erased) {
            return Ok(answer);
        }
    }
}

/// The answer with the records' envelopes and proofs.
fn filled(shared: &Shared, mut answer: Answer, most: usize) -> Result<Answer, RegistryError> {
    let Some(size) = answer.map.as_ref().map(|map| map.index + 1) else { return Ok(answer) };
    let mut bytes = 0;
    for record in &mut answer.records {
        record.envelope = match read::stored(shared, record.index) {
            Ok(stored) => Some(stored.envelope),
            Err(RegistryError::Erased { .. }) => None,
            Err(e) => return Err(e),
        };
        record.inclusion = read::prove_inclusion(shared, record.index, size)?;
        // Base64 and what stands around it: what it will be, and not much more.
        bytes += 2048 + record.envelope.as_ref().map_or(0, |e| e.payload.len() * 4 / 3);
        if bytes > most {
            return Err(answer::AnswerGap::TooLarge { limit: most }.into());
        }
    }
    Ok(answer)
}

/// The answer without the records' envelopes and proofs, and the records whose words it rests on, by their indices.
fn outline(
    shared: &Shared,
    scene: &str,
    view: Option<&Digest>,
    as_of: Option<&str>,
    most: usize,
) -> Result<(Answer, BTreeSet<u64>), RegistryError> {
    let _turn = shared.turn()?;
    let state = shared.read();
    let size = state.size;
    let as_of = as_of.map(|note| going_on_from(shared, &state, note)).transpose()?;
    let map = match size.checked_sub(1) {
        None => None,
        Some(index) => Some(MapPart { index, leaf: leaf_of(shared, index)?, inclusion: state.proven(index, size)? }),
    };
    let source = AtOneMoment { shared, state: &state, heard: RefCell::default(), most, read: Cell::new(0) };
    let (lists, records) = answer::collect(&answer::asked_key(scene, view), &source)?;
    let cosigned = state.cosigned.as_ref().filter(|(cosigned, _)| *cosigned == size);
    let answer = Answer {
        format: Format::V3,
        origin: shared.origin.clone(),
        scene: scene.to_owned(),
        view: view.copied(),
        checkpoint: cosigned.map_or(&state.checkpoint, |(_, note)| note).clone(),
        as_of,
        map,
        lists,
        records,
        shares: None,
    };
    Ok((answer, source.heard.into_inner()))
}

fn going_on_from(shared: &Shared, state: &State, note: &str) -> Result<AsOf, RegistryError> {
    let known = Checkpoint::verify(note, &shared.verifier()?);
    let known = known.map_err(|e| inconsistent("the checkpoint asked for", e.to_string()))?;
    reload::extends(&state.tree, state.size, &known)?;
    // Every log goes on from the empty one: that needs no proof, and has none.
    let consistency = match known.size {
        0 => Vec::new(),
        from => merkle::prove_consistency(&state.tree, from, state.size)?,
    };
    Ok(AsOf { checkpoint: note.to_owned(), consistency })
}

fn leaf_of(shared: &Shared, index: u64) -> Result<[u8; LEAF_LEN], RegistryError> {
    let leaf = read::leaf_bytes(shared, index)?;
    let length = leaf.len();
    leaf.try_into().map_err(|_| inconsistent(&format!("leaf {index}"), format!("{length} bytes")))
}

/// The log and its map while nobody writes.
struct AtOneMoment<'a> {
    shared: &'a Shared,
    state: &'a State,
    /// Records that said something.
    heard: RefCell<BTreeSet<u64>>,
    /// Most bytes of the answer.
    most: usize,
    /// Bytes of the envelopes that were read, each of which the answer will hold.
    read: Cell<usize>,
}

impl Source for AtOneMoment<'_> {
    type Error = RegistryError;

    fn list(&self, key: &MapKey) -> Result<List, RegistryError> {
        let buckets = StoredBuckets(self.shared.store.as_ref());
        let (_, proof) = self.state.map.prove(&buckets, key)?;
        let most = answer::MAX_RECORDS + 1;
        let entries = read::entries_below(self.shared, key, self.state.size, 0, most)?;
        if entries.len() == most {
            return Err(answer::AnswerGap::TooMany.into());
        }
        Ok(List { key: *key, entries, proof })
    }

    fn record(&self, index: u64) -> Result<ListedRecord, RegistryError> {
        Ok(ListedRecord { index, leaf: leaf_of(self.shared, index)?, inclusion: Vec::new(), envelope: None })
    }

    fn said(&self, index: u64) -> Result<Option<OwnerRecord>, RegistryError> {
        let Some(read::Said { record, bytes }) = read::said(self.shared, index)? else { return Ok(None) };
        if self.heard.borrow_mut().insert(index) {
            self.read.set(self.read.get() + bytes);
        }
        // Writers wait meanwhile: no more is read than can be answered with.
        if self.read.get() > self.most {
            return Err(answer::AnswerGap::TooLarge { limit: self.most }.into());
        }
        Ok(Some(record))
    }
}
