//! A store in memory that fails on demand, for tests of whoever keeps something in a store.
//!
//! It tells written from durable: [`FaultyStore::crash`] gives what a machine
//! would find again after losing power, which no real disk shows so readily.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use super::{Entry, Store, StoreError};

/// How an operation fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Nothing was done.
    Before,
    /// It was done, and reported as failed all the same.
    After,
}

#[derive(Debug, Default)]
struct Inner {
    written: BTreeMap<Vec<u8>, Vec<u8>>,
    durable: BTreeMap<Vec<u8>, Vec<u8>>,
    operations: u64,
    flushes: u64,
    fail: Option<(u64, Fault)>,
}

/// The store. Clones share one content, so a test keeps a handle on what it gave away.
#[derive(Debug, Clone, Default)]
pub struct FaultyStore(Arc<Mutex<Inner>>);

impl FaultyStore {
    /// An empty store that does not fail.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes the `nth` operation from now (0: the next) fail.
    pub fn fail_at(&self, nth: u64, fault: Fault) {
        let mut inner = self.inner();
        inner.fail = Some((inner.operations + nth, fault));
    }

    /// Takes back a fault that has not come due.
    pub fn heal(&self) {
        self.inner().fail = None;
    }

    /// Operations so far.
    pub fn operations(&self) -> u64 {
        self.inner().operations
    }

    /// Flushes so far.
    pub fn flushes(&self) -> u64 {
        self.inner().flushes
    }

    /// A store with what was durable: what is found after a crash.
    pub fn crash(&self) -> Self {
        let durable = self.inner().durable.clone();
        Self(Arc::new(Mutex::new(Inner { written: durable.clone(), durable, ..Inner::default() })))
    }

    /// Changes a stored value behind the owner's back; tells whether the key was there.
    pub fn tamper(&self, key: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> bool {
        let mut inner = self.inner();
        let Some(value) = inner.written.get_mut(key) else { return false };
        change(value);
        let value = value.clone();
        inner.durable.insert(key.to_vec(), value);
        true
    }

    /// Removes an entry behind the owner's back; tells whether it was there.
    pub fn remove(&self, key: &[u8]) -> bool {
        let mut inner = self.inner();
        inner.durable.remove(key);
        inner.written.remove(key).is_some()
    }

    /// All keys.
    pub fn keys(&self) -> Vec<Vec<u8>> {
        self.inner().written.keys().cloned().collect()
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn perform<T>(&self, operation: &'static str, act: impl FnOnce(&mut Inner) -> T) -> Result<T, StoreError> {
        let mut inner = self.inner();
        let due = inner.fail.filter(|(at, _)| *at == inner.operations).map(|(_, fault)| fault);
        inner.operations += 1;
        let failed = || StoreError { operation, place: "memory".into(), cause: "injected".into() };
        if due == Some(Fault::Before) {
            return Err(failed());
        }
        let result = act(&mut inner);
        if due == Some(Fault::After) { Err(failed()) } else { Ok(result) }
    }
}

impl Store for FaultyStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        self.perform("get", |inner| inner.written.get(key).cloned())
    }

    fn put(&self, batch: Vec<Entry>) -> Result<(), StoreError> {
        self.perform("put", |inner| inner.written.extend(batch))
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.perform("flush", |inner| {
            inner.flushes += 1;
            inner.durable = inner.written.clone();
        })
    }

    fn scan(&self, prefix: &[u8], from: &[u8], limit: usize) -> Result<Vec<Entry>, StoreError> {
        let start = [prefix, from].concat();
        self.perform("scan", |inner| {
            (inner.written.range(start..))
                .take_while(|(key, _)| key.starts_with(prefix))
                .take(limit)
                .map(|(key, value)| (key.clone(), value.clone()))
                .collect()
        })
    }
}
