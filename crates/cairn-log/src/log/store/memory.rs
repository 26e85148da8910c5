//! A store and a disk in memory that fail on demand, for tests of code that keeps something there.
//!
//! The files are [`FaultyDisk`]'s; the rows beside them are counted, failed and lost in a crash in one sequence with them.

use std::{
    collections::BTreeMap,
    ops::Deref,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use cairn_durable::{Disk, DurableError, FaultyDisk, OpenFile};

use super::{Change, Entry, Store, StoreError};

#[derive(Debug, Default)]
struct Rows {
    written: BTreeMap<Vec<u8>, Vec<u8>>,
    durable: BTreeMap<Vec<u8>, Vec<u8>>,
    flushes: u64,
}

/// The store and its files. Clones share one content, so a test keeps a handle on what it gave away.
///
/// It derefs to its disk, for [`FaultyDisk::fail_at`], [`FaultyDisk::heal`] and the like.
#[derive(Debug, Clone, Default)]
pub struct FaultyStore {
    disk: FaultyDisk,
    rows: Arc<Mutex<Rows>>,
}

impl Deref for FaultyStore {
    type Target = FaultyDisk;

    fn deref(&self) -> &FaultyDisk {
        &self.disk
    }
}

impl FaultyStore {
    /// An empty store that does not fail.
    pub fn new() -> Self {
        Self::default()
    }

    /// Flushes of the store so far.
    pub fn flushes(&self) -> u64 {
        self.rows().flushes
    }

    /// A store with what was durable: what is found after a crash.
    pub fn crash(&self) -> Self {
        let durable = self.rows().durable.clone();
        let rows = Rows { written: durable.clone(), durable, flushes: 0 };
        Self { disk: self.disk.crash(), rows: Arc::new(Mutex::new(rows)) }
    }

    /// Changes a stored value behind the owner's back; tells whether the key was there.
    pub fn tamper(&self, key: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> bool {
        let mut rows = self.rows();
        let Some(value) = rows.written.get_mut(key) else { return false };
        change(value);
        let value = value.clone();
        rows.durable.insert(key.to_vec(), value);
        true
    }

    /// Removes an entry behind the owner's back; tells whether it was there.
    pub fn remove_entry(&self, key: &[u8]) -> bool {
        let mut rows = self.rows();
        rows.durable.remove(key);
        rows.written.remove(key).is_some()
    }

    /// All keys.
    pub fn keys(&self) -> Vec<Vec<u8>> {
        self.rows().written.keys().cloned().collect()
    }

    fn rows(&self) -> MutexGuard<'_, Rows> {
        self.rows.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn act<T>(&self, operation: &'static str, act: impl FnOnce(&mut Rows) -> T) -> Result<T, StoreError> {
        Ok(self.disk.perform(operation, || act(&mut self.rows()))?)
    }
}

impl Store for FaultyStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        self.act("get", |rows| rows.written.get(key).cloned())
    }

    fn put(&self, batch: Vec<Change>) -> Result<(), StoreError> {
        self.act("put", |rows| {
            for (key, value) in batch {
                match value {
                    Some(value) => rows.written.insert(key, value),
                    None => rows.written.remove(&key),
                };
            }
        })
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.act("flush", |rows| {
            rows.flushes += 1;
            rows.durable = rows.written.clone();
        })
    }

    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError> {
        self.act("range", |rows| {
            (rows.written.range(from.to_vec()..))
                .take_while(|(key, _)| to.is_none_or(|to| key.as_slice() < to))
                .take(limit)
                .map(|(key, value)| (key.clone(), value.clone()))
                .collect()
        })
    }
}

impl Disk for FaultyStore {
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, DurableError> {
        self.disk.read(path, limit)
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, DurableError> {
        self.disk.list(folder)
    }

    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError> {
        self.disk.open(path)
    }

    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        self.disk.write(path, offset, bytes)
    }

    fn sync(&self, path: &str) -> Result<(), DurableError> {
        self.disk.sync(path)
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), DurableError> {
        self.disk.rename(from, to)
    }

    fn sync_folder(&self, path: &str) -> Result<(), DurableError> {
        self.disk.sync_folder(path)
    }

    fn remove(&self, path: &str) -> Result<(), DurableError> {
        self.disk.remove(path)
    }
}
