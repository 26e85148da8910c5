//! A disk in memory that fails on demand, for tests of code that keeps files.
//!
//! It tells written from durable: [`FaultyDisk::crash`] gives what a machine would find again after losing power, which
//! no real disk shows so readily. Bytes and names are kept apart, as a file system keeps them, so that a rename without
//! a flush shows.

use std::{
    collections::BTreeMap,
    io,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use crate::disk::{Disk, OpenFile};
use crate::error::DurableError;

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
    inodes: Vec<Inode>,
    names: BTreeMap<String, usize>,
    durable_names: BTreeMap<String, usize>,
    operations: u64,
    fail: Option<(u64, Fault)>,
}

/// A disk in memory. Clones share one content, so a test keeps a handle on what it gave away.
#[derive(Debug, Clone, Default)]
pub struct FaultyDisk(Arc<Mutex<Inner>>);

impl FaultyDisk {
    /// An empty disk that does not fail.
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

    /// A disk with what was durable: what is found after a crash.
    pub fn crash(&self) -> Self {
        let inner = self.inner();
        let inodes = inner.inodes.iter().map(|i| Inode { written: i.durable.clone(), durable: i.durable.clone() });
        Self(Arc::new(Mutex::new(Inner {
            inodes: inodes.collect(),
            names: inner.durable_names.clone(),
            durable_names: inner.durable_names.clone(),
            ..Inner::default()
        })))
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

    /// All files' paths.
    pub fn paths(&self) -> Vec<String> {
        self.inner().names.keys().cloned().collect()
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts an operation of the caller's, does it, and fails it where its turn has come: so a store beside the files
    /// fails in one sequence with them.
    ///
    /// # Errors
    /// [`DurableError::Io`] where it was made to fail ([`FaultyDisk::fail_at`]).
    pub fn perform<T>(&self, operation: &'static str, act: impl FnOnce() -> T) -> Result<T, DurableError> {
        self.perform_on(operation, |_| act())
    }

    fn perform_on<T>(&self, operation: &'static str, act: impl FnOnce(&mut Inner) -> T) -> Result<T, DurableError> {
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

fn error(operation: &'static str, cause: &str) -> DurableError {
    DurableError::io(operation, Path::new("memory"))(io::Error::other(cause.to_owned()))
}

impl Disk for FaultyDisk {
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, DurableError> {
        let read = self.perform_on("read", |inner| Some(inner.inodes[*inner.names.get(path)?].written.clone()))?;
        match read {
            Some(bytes) if bytes.len() as u64 > limit => Err(error("read", "too large")),
            read => Ok(read),
        }
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, DurableError> {
        self.perform_on("list", |inner| {
            let inside = |name: &String| Some(name.strip_prefix(folder)?.strip_prefix('/')?.to_owned());
            inner.names.keys().filter_map(inside).collect()
        })
    }

    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError> {
        let inode = self.perform_on("open", |inner| inner.names.get(path).copied())?;
        Ok(inode.map(|inode| Box::new(OpenInode { disk: self.clone(), inode }) as Box<dyn OpenFile>))
    }

    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        self.perform_on("write", |inner| {
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

    fn sync(&self, path: &str) -> Result<(), DurableError> {
        self.perform_on("flush", |inner| {
            let inode = *inner.names.get(path).ok_or_else(|| error("flush", "no such file"))?;
            inner.inodes[inode].durable = inner.inodes[inode].written.clone();
            Ok(())
        })?
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), DurableError> {
        self.perform_on("rename", |inner| {
            let inode = inner.names.remove(from).ok_or_else(|| error("rename", "no such file"))?;
            inner.names.insert(to.to_owned(), inode);
            Ok(())
        })?
    }

    fn sync_folder(&self, path: &str) -> Result<(), DurableError> {
        self.perform_on("flush the folder", |inner| {
            let inside = |name: &String| name.rsplit_once('/').map_or("", |(folder, _)| folder) == path;
            inner.durable_names.retain(|name, _| !inside(name));
            let names = inner.names.iter().filter(|(name, _)| inside(name)).map(|(name, inode)| (name.clone(), *inode));
            inner.durable_names.extend(names);
        })
    }

    fn remove(&self, path: &str) -> Result<(), DurableError> {
        self.perform_on("remove", |inner| {
            let below = format!("{path}/");
            inner.names.retain(|name, _| name != path && !name.starts_with(&below));
        })
    }
}

/// A file held open: its bytes, whatever becomes of its name.
struct OpenInode {
    disk: FaultyDisk,
    inode: usize,
}

impl OpenFile for OpenInode {
    fn size(&self) -> Result<u64, DurableError> {
        self.disk.perform_on("size", |inner| inner.inodes[self.inode].written.len() as u64)
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, DurableError> {
        self.disk.perform_on("read", |inner| {
            inner.inodes[self.inode].written.iter().skip(offset as usize).take(length).copied().collect()
        })
    }
}
