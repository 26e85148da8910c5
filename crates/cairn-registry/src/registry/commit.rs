//! Group commit: submissions that wait together are written and flushed together.
//!
//! There is no writer thread. The first submitter who finds nobody writing takes
//! all that waits and writes it; those who come meanwhile wait for the next round. A flush
//! costs milliseconds, so under load a round carries many records.

use std::{
    mem,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use super::{
    Receipt, Registry, RegistryError, layout,
    reload::{inconsistent, index_of, stored},
    submit::{Admitted, Candidate, Planned},
};
use crate::{checkpoint::Checkpoint, digest::Digest, dsse::Envelope, store::Entry};

type Outcome = Result<Receipt, RegistryError>;

/// Submissions that wait, and whether somebody is writing.
#[derive(Default)]
pub(super) struct Queue {
    waiting: Vec<Waiting>,
    busy: bool,
}

struct Waiting {
    candidate: Candidate,
    slot: Arc<Mutex<Option<Outcome>>>,
}

/// Where a submission of this round ends up.
struct Placed {
    index: u64,
    resubmitted: bool,
    envelope: Envelope,
}

/// What a round writes.
#[derive(Default)]
struct Batch {
    entries: Vec<Entry>,
    leaves: Vec<(u64, Vec<u8>)>,
    planned: Planned,
    kept: Vec<Envelope>,
}

/// One writer's turn. However it ends, nobody is left waiting.
struct Turn<'a> {
    registry: &'a Registry,
    batch: Vec<Waiting>,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        for waiting in &self.batch {
            let mut slot = lock(&waiting.slot);
            if slot.is_none() {
                let cause = self.registry.halt("the writer panicked");
                *slot = Some(Err(RegistryError::Halted { cause }));
            }
        }
        lock(&self.registry.queue).busy = false;
        self.registry.wake.notify_all();
    }
}

impl Registry {
    /// Takes a record into the log. Blocks until it is durable and published.
    ///
    /// The same record again gives its old index, so a submitter whose connection broke asks again. A record that was refused
    /// or failed left no trace, except after [`RegistryError::Store`] and [`RegistryError::Halted`]: then it may be in the log
    /// after the next start; submit it again.
    ///
    /// # Errors
    /// [`RegistryError`]; nothing is acknowledged that is not flushed.
    pub fn submit(&self, envelope: &Envelope) -> Result<Receipt, RegistryError> {
        let candidate = Candidate::check(envelope, &self.origin)?;
        let slot = Arc::new(Mutex::new(None));
        let mut queue = lock(&self.queue);
        queue.waiting.push(Waiting { candidate, slot: slot.clone() });
        loop {
            if let Some(outcome) = lock(&slot).take() {
                return outcome;
            }
            if queue.busy {
                queue = self.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
                continue;
            }
            queue.busy = true;
            let turn = Turn { registry: self, batch: mem::take(&mut queue.waiting) };
            drop(queue);
            let outcomes = self.write_round(&turn.batch);
            for (waiting, outcome) in turn.batch.iter().zip(outcomes) {
                *lock(&waiting.slot) = Some(outcome);
            }
            drop(turn);
            queue = lock(&self.queue);
        }
    }

    fn write_round(&self, round: &[Waiting]) -> Vec<Outcome> {
        if let Some(cause) = self.halted() {
            return round.iter().map(|_| Err(RegistryError::Halted { cause: cause.clone() })).collect();
        }
        let size = self.size();
        let mut batch = Batch::default();
        let placed: Vec<_> = round.iter().map(|w| self.place(&w.candidate, size, &mut batch)).collect();
        let written = if batch.leaves.is_empty() { Ok(()) } else { self.write_batch(size, batch) };
        let outcomes = placed.into_iter().map(|placed| {
            let placed = placed?;
            match &written {
                Ok(()) => self.receipt(placed),
                // A record that was in the log before does not depend on this round's luck.
                Err(_) if placed.index < size => self.receipt(placed),
                Err(e) => Err(e.again()),
            }
        });
        outcomes.collect()
    }

    /// Finds the record's place in the log, old or new.
    fn place(&self, candidate: &Candidate, size: u64, batch: &mut Batch) -> Result<Placed, RegistryError> {
        let digest = candidate.leaf.record;
        if let Some((index, _)) = batch.planned.records.get(&digest) {
            let envelope = batch.kept[(index - size) as usize].clone();
            return Ok(Placed { index: *index, resubmitted: true, envelope });
        }
        if let Some(index) = index_of(self.store.as_ref(), &digest)? {
            let envelope = stored(self.store.as_ref(), index)?.envelope;
            return Ok(Placed { index, resubmitted: true, envelope });
        }
        let admitted = self.admit(candidate, &self.read().tree, size, &batch.planned)?;
        let index = size + batch.leaves.len() as u64;
        batch.add(index, candidate, &admitted);
        Ok(Placed { index, resubmitted: false, envelope: admitted.envelope })
    }

    /// Writes, flushes, and only then signs.
    fn write_batch(&self, size: u64, batch: Batch) -> Result<(), RegistryError> {
        let result = self.make_durable(size, batch).and_then(|(new_size, root)| {
            let note = Checkpoint::new(&self.origin, new_size, root).sign(&self.key)?;
            let mut state = self.write();
            state.size = new_size;
            state.checkpoint = note.to_string();
            Ok(())
        });
        result.inspect_err(|e| drop(self.halt(&e.to_string())))
    }

    fn make_durable(&self, size: u64, mut batch: Batch) -> Result<(u64, Digest), RegistryError> {
        let (new_size, root) = {
            let mut state = self.write();
            for (_, leaf) in &batch.leaves {
                state.tree.push(crate::merkle::leaf_hash(leaf));
            }
            (state.tree.size(), state.tree.root())
        };
        debug_assert_eq!(new_size, size + batch.leaves.len() as u64);
        batch.entries.push((layout::SIGNED.to_vec(), layout::signed(new_size, &root)));
        self.store.put(batch.entries)?;
        self.store.flush()?;
        // Read again before signing: a signature over leaves that the store does not give back could never be honoured.
        for (index, leaf) in &batch.leaves {
            if self.store.get(&layout::leaf(*index))?.as_ref() != Some(leaf) {
                return Err(inconsistent(
                    &format!("leaf {index}"),
                    "reads back differently from what was written".into(),
                ));
            }
        }
        Ok((new_size, root))
    }

    fn receipt(&self, placed: Placed) -> Outcome {
        let state = self.read();
        let inclusion = state.tree.prove_inclusion(placed.index, state.size)?;
        let leaf_hash = state.tree.leaf(placed.index);
        let no_such = RegistryError::NoSuchRecord { index: placed.index, size: state.size };
        Ok(Receipt {
            index: placed.index,
            leaf_hash: leaf_hash.ok_or(no_such)?,
            durable: true,
            resubmitted: placed.resubmitted,
            checkpoint: state.checkpoint.clone(),
            size: state.size,
            inclusion,
            envelope: placed.envelope,
        })
    }

    /// Stops all writing; the first cause stays.
    fn halt(&self, cause: &str) -> String {
        self.write().halted.get_or_insert_with(|| cause.to_owned()).clone()
    }
}

impl Batch {
    fn add(&mut self, index: u64, candidate: &Candidate, admitted: &Admitted) {
        let (record, leaf) = (&candidate.record, candidate.leaf.encode().to_vec());
        let digest = candidate.leaf.record;
        let place = index.to_be_bytes().to_vec();
        self.entries.extend([
            (layout::leaf(index), leaf.clone()),
            (layout::envelope(&digest), admitted.envelope.to_json().into_bytes()),
            (layout::index_of(&digest), place.clone()),
            (layout::nonce(&record.nonce), place.clone()),
            ([layout::scene(&record.scene), place.clone()].concat(), Vec::new()),
        ]);
        self.leaves.push((index, leaf));
        self.planned.records.insert(digest, (index, record.owner_key));
        self.planned.nonces.insert(record.nonce, index);
        if let Some(ended) = admitted.retires.map(|owner| owner.id()) {
            self.entries.push((layout::retired(&ended), place));
            self.planned.retired.insert(ended, index);
        }
        self.kept.push(admitted.envelope.clone());
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Barrier,
        atomic::{AtomicBool, AtomicU64, Ordering},
    };

    use super::*;
    use crate::{
        keys::OwnerKey,
        record::{Digests, Identity, OwnerRecord, RecordKind, Seen, VERSION},
        store::{FaultyStore, Store, StoreError},
    };

    /// Holds the first flush after arming until it is let go; counts flushes.
    #[derive(Clone, Default)]
    struct Gated {
        inner: FaultyStore,
        armed: Arc<AtomicBool>,
        entered: Arc<Gate>,
        flushes: Arc<AtomicU64>,
        panics: Arc<AtomicBool>,
    }

    struct Gate(Barrier, Barrier);

    impl Default for Gate {
        fn default() -> Self {
            Self(Barrier::new(2), Barrier::new(2))
        }
    }

    impl Store for Gated {
        fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
            self.inner.get(key)
        }

        fn put(&self, batch: Vec<Entry>) -> Result<(), StoreError> {
            assert!(!self.panics.load(Ordering::SeqCst), "a store that panics");
            self.inner.put(batch)
        }

        fn flush(&self) -> Result<(), StoreError> {
            if self.armed.swap(false, Ordering::SeqCst) {
                self.entered.0.wait();
                self.entered.1.wait();
            }
            self.flushes.fetch_add(1, Ordering::SeqCst);
            self.inner.flush()
        }

        fn scan(&self, prefix: &[u8], from: &[u8], limit: usize) -> Result<Vec<Entry>, StoreError> {
            self.inner.scan(prefix, from, limit)
        }
    }

    fn sealed(registry: &Registry, number: u8) -> Envelope {
        let owner = OwnerKey::from_seed(&[number; 32]);
        let head = registry.head().unwrap();
        let record = OwnerRecord {
            version: VERSION,
            kind: RecordKind::Contribution,
            origin: registry.origin().into(),
            scene: "fern".into(),
            scene_salt: Digest::of("salt"),
            identity: Identity { number: 1, contributor: "Ada".into() },
            owner_key: owner.public(),
            digests: Digests { photographs: Some(Digest::of("photographs")), ..Digests::default() },
            seed: None,
            purpose: "credit".into(),
            nonce: registry.nonce("fern", &owner.public()).unwrap(),
            seen: Seen { size: head.size, root: head.root },
            replaces: None,
            views: None,
        };
        record.seal(&owner).unwrap()
    }

    #[test]
    fn a_writer_that_panics_leaves_nobody_waiting() {
        let store = Gated::default();
        let key = OwnerKey::from_seed(&[200; 32]);
        let registry = Registry::open_store(Box::new(store.clone()), key.clone(), "cairn.example/log").unwrap();
        registry.submit(&sealed(&registry, 1)).unwrap();
        store.panics.store(true, Ordering::SeqCst);
        std::thread::scope(|scope| {
            let writers = [2, 3, 4].map(|number| {
                let registry = &registry;
                scope.spawn(move || registry.submit(&sealed(registry, number)))
            });
            let ends = writers.map(|writer| writer.join());
            assert!(ends.iter().any(Result::is_err), "one of them was the writer");
            for end in ends.into_iter().flatten() {
                assert!(matches!(end, Err(RegistryError::Halted { .. })), "{end:?}");
            }
        });
        store.panics.store(false, Ordering::SeqCst);
        let refused = registry.submit(&sealed(&registry, 5)).unwrap_err();
        assert!(matches!(refused, RegistryError::Halted { .. }), "{refused}");
        assert_eq!(registry.size(), 1);
        drop(registry);
        let registry = Registry::open_store(Box::new(store.inner.crash()), key, "cairn.example/log").unwrap();
        assert_eq!(registry.submit(&sealed(&registry, 5)).unwrap().index, 1);
    }

    #[test]
    fn those_who_wait_during_a_flush_share_the_next() {
        let store = Gated::default();
        let registry =
            Registry::open_store(Box::new(store.clone()), OwnerKey::from_seed(&[200; 32]), "cairn.example/log")
                .unwrap();
        let before = store.flushes.load(Ordering::SeqCst);
        store.armed.store(true, Ordering::SeqCst);
        std::thread::scope(|scope| {
            let first = scope.spawn(|| registry.submit(&sealed(&registry, 1)).unwrap());
            store.entered.0.wait();
            let same = sealed(&registry, 9);
            let mut envelopes: Vec<_> = (2..=8).map(|number| sealed(&registry, number)).collect();
            envelopes.extend([same.clone(), same]);
            let others: Vec<_> = (envelopes.into_iter())
                .map(|envelope| {
                    let registry = &registry;
                    scope.spawn(move || registry.submit(&envelope).unwrap())
                })
                .collect();
            while lock(&registry.queue).waiting.len() < 9 {
                std::thread::yield_now();
            }
            // Not published while its flush has not returned.
            assert_eq!(registry.size(), 0);
            store.entered.1.wait();
            assert_eq!(first.join().unwrap().size, 1);
            let mut indices: Vec<_> =
                others.into_iter().map(|t| t.join().unwrap()).map(|r| (r.index, r.size)).collect();
            indices.sort_unstable();
            indices.dedup();
            assert_eq!(indices, (1..=8).map(|index| (index, 9)).collect::<Vec<_>>());
        });
        assert_eq!(store.flushes.load(Ordering::SeqCst) - before, 2);
    }
}
