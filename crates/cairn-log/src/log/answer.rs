//! Complete answers, put together from the log and its map at one moment.

use super::{Registry, RegistryError, State, commit::StoredBuckets, reload::inconsistent};
use crate::format::{
    answer::{self, Answer, AsOf, Format, List, ListedRecord, MapPart, Source},
    checkpoint::Checkpoint,
    digest::Digest,
    leaf::LEAF_LEN,
    map::MapKey,
    merkle,
};

impl Registry {
    /// Who contributed to a scene, or to one photograph of it (by its SHA-256), with the proofs that each record is in the
    /// log and none is left out. Under the newest checkpoint; where `as_of` names an older one of this log (a signed
    /// note), with the proof that the one goes on from the other.
    ///
    /// Nothing is written while the lists are put together: log and map have to be of one moment. Envelopes and proofs are
    /// fetched afterwards, since what stands in the log stays there.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for an `as_of` that is none of this log's; [`RegistryError::Answer`] for more
    /// records than an answer holds, or more than about `most` bytes of them.
    pub fn answer(
        &self,
        scene: &str,
        view: Option<&Digest>,
        as_of: Option<&str>,
        most: usize,
    ) -> Result<Answer, RegistryError> {
        let mut answer = self.outline(scene, view, as_of)?;
        let Some(size) = answer.map.as_ref().map(|map| map.index + 1) else { return Ok(answer) };
        let mut bytes = 0;
        for record in &mut answer.records {
            record.envelope = match self.stored(record.index) {
                Ok(stored) => Some(stored.envelope),
                Err(RegistryError::Erased { .. }) => None,
                Err(e) => return Err(e),
            };
            record.inclusion = self.prove_inclusion(record.index, size)?;
            // Base64 and what stands around it: what it will be, and not much more.
            bytes += 2048 + record.envelope.as_ref().map_or(0, |e| e.payload.len() * 4 / 3);
            if bytes > most {
                return Err(answer::AnswerGap::TooLarge { limit: most }.into());
            }
        }
        Ok(answer)
    }

    /// The answer without the records' envelopes and proofs.
    fn outline(&self, scene: &str, view: Option<&Digest>, as_of: Option<&str>) -> Result<Answer, RegistryError> {
        let _turn = self.turn()?;
        let state = self.read();
        let size = state.size;
        let as_of = as_of.map(|note| self.going_on_from(&state, note)).transpose()?;
        let map = match size.checked_sub(1) {
            None => None,
            Some(index) => Some(MapPart { index, leaf: self.leaf_of(index)?, inclusion: state.proven(index, size)? }),
        };
        let source = AtOneMoment { registry: self, state: &state };
        let (lists, records) = answer::collect(&answer::asked_key(scene, view), &source)?;
        let cosigned = state.cosigned.as_ref().filter(|(cosigned, _)| *cosigned == size);
        Ok(Answer {
            format: Format::V2,
            origin: self.origin.clone(),
            scene: scene.to_owned(),
            view: view.copied(),
            checkpoint: cosigned.map_or(&state.checkpoint, |(_, note)| note).clone(),
            as_of,
            map,
            lists,
            records,
        })
    }

    fn going_on_from(&self, state: &State, note: &str) -> Result<AsOf, RegistryError> {
        let known = Checkpoint::verify(note, &self.verifier()?);
        let known = known.map_err(|e| inconsistent("the checkpoint asked for", e.to_string()))?;
        super::reload::extends(&state.tree, state.size, &known)?;
        // Every log goes on from the empty one: that needs no proof, and has none.
        let consistency = match known.size {
            0 => Vec::new(),
            from => merkle::prove_consistency(&state.tree, from, state.size)?,
        };
        Ok(AsOf { checkpoint: note.to_owned(), consistency })
    }

    fn leaf_of(&self, index: u64) -> Result<[u8; LEAF_LEN], RegistryError> {
        let leaf = self.leaf_bytes(index)?;
        let length = leaf.len();
        leaf.try_into().map_err(|_| inconsistent(&format!("leaf {index}"), format!("{length} bytes")))
    }
}

/// The log and its map while nobody writes.
struct AtOneMoment<'a> {
    registry: &'a Registry,
    state: &'a State,
}

impl Source for AtOneMoment<'_> {
    type Error = RegistryError;

    fn list(&self, key: &MapKey) -> Result<List, RegistryError> {
        let buckets = StoredBuckets(self.registry.store.as_ref());
        let (_, proof) = self.state.map.prove(&buckets, key)?;
        let most = answer::MAX_RECORDS + 1;
        let entries = self.registry.entries_below(key, self.state.size, 0, most)?;
        if entries.len() == most {
            return Err(answer::AnswerGap::TooMany.into());
        }
        Ok(List { key: *key, entries, proof })
    }

    fn record(&self, index: u64) -> Result<ListedRecord, RegistryError> {
        Ok(ListedRecord { index, leaf: self.registry.leaf_of(index)?, inclusion: Vec::new(), envelope: None })
    }
}
