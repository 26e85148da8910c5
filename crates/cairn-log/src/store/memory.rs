//! A store and a disk in memory that fail on demand, for tests of whoever keeps something there.
//!
//! It tells written from durable: [`FaultyStore::crash`] gives what a machine
//! would find again after losing power, which no real disk shows so readily. Files are
//! kept as a file system keeps them, bytes and names apart, so that a rename without a flush shows.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use super::{Change, Entry, Store, StoreError};
use crate::files::{Disk, OpenFile};

/// How an operation fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Nothing was done.
    Before,
    /// It was done, and reported as failed all the same.
    After,
}

/// A file's bytes, whatever its name.
#[derive(Debug, Clone, Default)]
struct Inode {
    written: Vec<u8>,
    durable: Vec<u8>,
}

#[derive(Debug, Default)]
struct Inner {
    written: BTreeMap<Vec<u8>, Vec<u8>>,
    durable: BTreeMap<Vec<u8>, Vec<u8>>,
    inodes: Vec<Inode>,
    names: BTreeMap<String, usize>,
    durable_names: BTreeMap<String, usize>,
    operations: u64,
    flushes: u64,
    fail: Option<(u64, Fault)>,
}

/// The store and its files. Clones share one content, so a test keeps a handle on what it gave away.
#[derive(Debug, Clone, Default)]
pub struct FaultyStore(Arc<Mutex<Inner>>);

impl FaultyStore {
    /// An empty store that does not fail.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes the `nth` operation from now (0: the next), of the store or on a file, fail.
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

    /// Flushes of the store so far.
    pub fn flushes(&self) -> u64 {
        self.inner().flushes
    }

    /// A store with what was durable: what is found after a crash.
    pub fn crash(&self) -> Self {
        let inner = self.inner();
        let inodes = inner.inodes.iter().map(|i| Inode { written: i.durable.clone(), durable: i.durable.clone() });
        Self(Arc::new(Mutex::new(Inner {
            written: inner.durable.clone(),
            durable: inner.durable.clone(),
            inodes: inodes.collect(),
            names: inner.durable_names.clone(),
            durable_names: inner.durable_names.clone(),
            ..Inner::default()
        })))
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

    /// Changes a file behind the owner's back; tells whether it was there.
    pub fn tamper_file(&self, path: &str, change: impl FnOnce(&mut Vec<u8>)) -> bool {
        let mut inner = self.inner();
        let Some(inode) = inner.names.get(path).copied() else { return false };
        let inode = &mut inner.inodes[inode];
        change(&mut inode.written);
        inode.durable = inode.written.clone();
        true
    }

    /// Removes an entry behind the owner's back; tells whether it was there.
    pub fn remove_entry(&self, key: &[u8]) -> bool {
        let mut inner = self.inner();
        inner.durable.remove(key);
        inner.written.remove(key).is_some()
    }

    /// All keys.
    pub fn keys(&self) -> Vec<Vec<u8>> {
        self.inner().written.keys().cloned().collect()
    }

    /// All files' paths.
    pub fn paths(&self) -> Vec<String> {
        self.inner().names.keys().cloned().collect()
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn perform<T>(&self, operation: &'static str, act: impl FnOnce(&mut Inner) -> T) -> Result<T, StoreError> {
        let mut inner = self.inner();
        let due = inner.fail.filter(|(at, _)| *at == inner.operations).map(|(_, fault)| fault);
        inner.operations += 1;
        if due == Some(Fault::Before) {
            return Err(error(operation, "injected"));
        }
        let result = act(&mut inner);
        if due == Some(Fault::After) { Err(error(operation, "injected")) } else { Ok(result) }
    }
}

fn error(operation: &'static str, cause: &str) -> StoreError {
    StoreError { operation, place: "memory".into(), cause: cause.into() }
}

impl Store for FaultyStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        self.perform("get", |inner| inner.written.get(key).cloned())
    }

    fn put(&self, batch: Vec<Change>) -> Result<(), StoreError> {
        self.perform("put", |inner| {
            for (key, value) in batch {
                match value {
                    Some(value) => inner.written.insert(key, value),
                    None => inner.written.remove(&key),
                };
            }
        })
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.perform("flush", |inner| {
            inner.flushes += 1;
            inner.durable = inner.written.clone();
        })
    }

    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError> {
        self.perform("range", |inner| {
            (inner.written.range(from.to_vec()..))
                .take_while(|(key, _)| to.is_none_or(|to| key.as_slice() < to))
                .take(limit)
                .map(|(key, value)| (key.clone(), value.clone()))
                .collect()
        })
    }
}

impl Disk for FaultyStore {
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let read = self.perform("read", |inner| Some(inner.inodes[*inner.names.get(path)?].written.clone()))?;
        match read {
            Some(bytes) if bytes.len() as u64 > limit => Err(error("read", "too large")),
            read => Ok(read),
        }
    }

    fn read_at(&self, path: &str, offset: u64, length: usize) -> Result<Option<Vec<u8>>, StoreError> {
        let read = self.read(path, u64::MAX)?;
        Ok(read.map(|bytes| bytes.into_iter().skip(offset as usize).take(length).collect()))
    }

    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, StoreError> {
        let inode = self.perform("open", |inner| inner.names.get(path).copied())?;
        Ok(inode.map(|inode| Box::new(OpenInode { store: self.clone(), inode }) as Box<dyn OpenFile>))
    }

    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), StoreError> {
        self.perform("write", |inner| {
            let next = inner.inodes.len();
            let inode = *inner.names.entry(path.to_owned()).or_insert(next);
            if inode == next {
                inner.inodes.push(Inode::default());
            }
            let written = &mut inner.inodes[inode].written;
            let offset = usize::try_from(offset).ok().filter(|at| *at <= written.len());
            let offset = offset.ok_or_else(|| error("write", "shorter than the offset"))?;
            written.truncate(offset);
            written.extend_from_slice(bytes);
            Ok(())
        })?
    }

    fn sync(&self, path: &str) -> Result<(), StoreError> {
        self.perform("flush", |inner| {
            let inode = *inner.names.get(path).ok_or_else(|| error("flush", "no such file"))?;
            inner.inodes[inode].durable = inner.inodes[inode].written.clone();
            Ok(())
        })?
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), StoreError> {
        self.perform("rename", |inner| {
            let inode = inner.names.remove(from).ok_or_else(|| error("rename", "no such file"))?;
            inner.names.insert(to.to_owned(), inode);
            Ok(())
        })?
    }

    fn sync_folder(&self, path: &str) -> Result<(), StoreError> {
        self.perform("flush the folder", |inner| {
            let inside = |name: &String| name.rsplit_once('/').map_or("", |(folder, _)| folder) == path;
            inner.durable_names.retain(|name, _| !inside(name));
            let names = inner.names.iter().filter(|(name, _)| inside(name)).map(|(name, inode)| (name.clone(), *inode));
            inner.durable_names.extend(names);
        })
    }

    fn remove(&self, path: &str) -> Result<(), StoreError> {
        self.perform("remove", |inner| {
            let below = format!("{path}/");
            inner.names.retain(|name, _| name != path && !name.starts_with(&below));
        })
    }
}

/// A file held open: its bytes, whatever becomes of its name.
struct OpenInode {
    store: FaultyStore,
    inode: usize,
}

impl OpenFile for OpenInode {
    fn size(&self) -> Result<u64, StoreError> {
        self.store.perform("size", |inner| inner.inodes[self.inode].written.len() as u64)
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, StoreError> {
        self.store.perform("read", |inner| {
            inner.inodes[self.inode].written.iter().skip(offset as usize).take(length).copied().collect()
        })
    }
}
