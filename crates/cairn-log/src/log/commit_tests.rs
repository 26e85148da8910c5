//! Who shares a round with whom, and what is left when a writer panics.

use std::sync::{
    Barrier,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use super::*;
use crate::{
    format::{
        key::OwnerKey,
        record::{Digests, Identity, OwnerRecord, RecordKind, Seen, VERSION},
    },
    log::{
        Registry,
        store::{Entry, FaultyStore, Store, StoreError},
    },
};

fn open(store: &Gated, found: &FaultyStore) -> Registry {
    let key = OwnerKey::from_seed(&[200; 32]);
    Registry::open_store(Box::new(store.clone()), Box::new(found.clone()), key, "cairn.example/log").unwrap()
}

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

    fn put(&self, batch: Vec<Change>) -> Result<(), StoreError> {
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

    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError> {
        self.inner.range(from, to, limit)
    }
}

fn take(registry: &Registry, envelope: &Envelope) -> Result<Receipt, RegistryError> {
    registry.submit(SignedRecord::open(envelope.clone())?)
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
        identity: Identity::numbered(1, "Ada"),
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
fn a_round_that_does_not_end_keeps_nobody_else_waiting() {
    let store = Gated::default();
    let registry = open(&store, &store.inner);
    let envelopes = [1, 2, 3].map(|number| sealed(&registry, number));
    assert!(registry.writing_for().is_none());
    store.armed.store(true, Ordering::SeqCst);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| take(&registry, &envelopes[0]));
        store.entered.0.wait();
        assert!(registry.writing_for().is_some());
        let waiting = scope.spawn(|| take(&registry, &envelopes[1]));
        while lock(&registry.shared.queue).waiting.is_empty() {
            std::thread::yield_now();
        }
        let turn = scope.spawn(|| registry.shared.turn().map(drop));
        registry.stop_writing("its disk does not answer");
        assert!(matches!(turn.join().unwrap(), Err(RegistryError::Halted { .. })));
        for refused in [waiting.join().unwrap(), take(&registry, &envelopes[2])] {
            assert!(matches!(&refused, Err(RegistryError::Halted { cause }) if cause.contains("disk")), "{refused:?}");
        }
        // Should the disk answer after all, what it took is in the log.
        store.entered.1.wait();
        assert_eq!(first.join().unwrap().unwrap().index, 0);
    });
    assert!(registry.writing_for().is_none());
}

#[test]
fn a_writer_that_panics_leaves_nobody_waiting() {
    let store = Gated::default();
    let registry = open(&store, &store.inner);
    take(&registry, &sealed(&registry, 1)).unwrap();
    store.panics.store(true, Ordering::SeqCst);
    std::thread::scope(|scope| {
        let writers = [2, 3, 4].map(|number| {
            let registry = &registry;
            scope.spawn(move || take(registry, &sealed(registry, number)))
        });
        let ends = writers.map(|writer| writer.join());
        assert!(ends.iter().any(Result::is_err), "one of them was the writer");
        for end in ends.into_iter().flatten() {
            assert!(matches!(end, Err(RegistryError::Halted { .. })), "{end:?}");
        }
    });
    store.panics.store(false, Ordering::SeqCst);
    let refused = take(&registry, &sealed(&registry, 5)).unwrap_err();
    assert!(matches!(refused, RegistryError::Halted { .. }), "{refused}");
    assert_eq!(registry.size(), 2);
    drop(registry);
    let found = Gated { inner: store.inner.crash(), ..Gated::default() };
    let registry = open(&found, &found.inner);
    assert_eq!(take(&registry, &sealed(&registry, 5)).unwrap().index, 2);
}

#[test]
fn those_who_wait_during_a_flush_share_the_next() {
    let store = Gated::default();
    let registry = open(&store, &store.inner);
    let before = store.flushes.load(Ordering::SeqCst);
    store.armed.store(true, Ordering::SeqCst);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| take(&registry, &sealed(&registry, 1)).unwrap());
        store.entered.0.wait();
        let same = sealed(&registry, 9);
        let mut envelopes: Vec<_> = (2..=8).map(|number| sealed(&registry, number)).collect();
        envelopes.extend([same.clone(), same]);
        let others: Vec<_> = (envelopes.into_iter())
            .map(|envelope| {
                let registry = &registry;
                scope.spawn(move || take(registry, &envelope).unwrap())
            })
            .collect();
        while lock(&registry.shared.queue).waiting.len() < 9 {
            std::thread::yield_now();
        }
        // Not published while its flush has not returned.
        assert_eq!(registry.size(), 0);
        store.entered.1.wait();
        assert_eq!(first.join().unwrap().index, 0);
        let mut indices: Vec<_> = others.into_iter().map(|t| t.join().unwrap()).map(|r| (r.index, r.size)).collect();
        indices.sort_unstable();
        indices.dedup();
        // Two map leaves: behind the first record, and behind the eight that shared a round.
        assert_eq!(indices, (2..=9).map(|index| (index, 11)).collect::<Vec<_>>());
    });
    // The rounds themselves: a receipt is made after its round, and may stand under the next one's checkpoint.
    let is_map = |index: &u64| matches!(registry.entry(*index), Ok(crate::log::LogEntry::Map { .. }));
    assert_eq!((0..registry.size()).filter(is_map).collect::<Vec<_>>(), [1, 10]);
    assert_eq!(store.flushes.load(Ordering::SeqCst) - before, 2);
}

#[test]
fn submitters_and_whoever_wants_the_turn_for_something_else_all_get_it() {
    const EACH: u8 = 20;
    let store = Gated::default();
    let registry = open(&store, &store.inner);
    let done = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for submitter in 0..8_u8 {
            let (registry, done) = (&registry, &done);
            scope.spawn(move || {
                for number in 0..EACH {
                    take(registry, &sealed(registry, submitter * EACH + number + 1)).unwrap();
                    done.fetch_add(1, Ordering::SeqCst);
                }
            });
        }
        for _ in 0..2 {
            scope.spawn(|| {
                while done.load(Ordering::SeqCst) < 8 * u64::from(EACH) {
                    // Map leaves are not to be erased, and asked for all the same: it takes the turn.
                    for index in 0..registry.size() {
                        let _ = registry.erase_index(index);
                    }
                }
            });
        }
    });
    let records = (0..registry.size()).filter(|index| registry.leaf(*index).is_ok()).count();
    assert_eq!(records, 8 * usize::from(EACH));
    assert!(registry.check().unwrap().is_empty());
    assert!(lock(&registry.shared.queue).waiting.is_empty());
}
