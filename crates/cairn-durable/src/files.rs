//! Files that are there whole or not at all, made of a [`Disk`]'s operations: replaced atomically, or gone on with at
//! a known length.

use std::collections::BTreeSet;

use crate::disk::{Disk, OpenFile};
use crate::error::DurableError;

/// Files made of a [`Disk`]'s operations.
pub struct Files {
    disk: Box<dyn Disk>,
}

impl Files {
    /// Files on `disk`.
    pub fn new(disk: Box<dyn Disk>) -> Self {
        Self { disk }
    }

    /// As [`Disk::read`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, DurableError> {
        self.disk.read(path, limit)
    }

    /// `length` bytes of a file from `offset` on; `None` where there is no such file.
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn read_at(&self, path: &str, offset: u64, length: usize) -> Result<Option<Vec<u8>>, DurableError> {
        self.disk.open(path)?.map(|file| file.read_at(offset, length)).transpose()
    }

    /// Names in a folder; see [`Disk::list`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn list(&self, folder: &str) -> Result<Vec<String>, DurableError> {
        self.disk.list(folder)
    }

    /// As [`Disk::open`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError> {
        self.disk.open(path)
    }

    /// Continues the file that is to become `path` at `offset` and forgets what was behind it. It is
    /// not durable, and not there under its name, before [`Files::complete`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn draft(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        self.disk.write(&fresh(path), offset, bytes)
    }

    /// Gives a file its name once it is complete; durable on return.
    ///
    /// # Errors
    /// [`DurableError`]; then it has its name or not.
    pub fn complete(&self, path: &str) -> Result<(), DurableError> {
        self.disk.sync(&fresh(path))?;
        self.adopt(path)
    }

    /// Writes and flushes what is to become `path`, which stays what it is before [`Files::adopt`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn prepare(&self, path: &str, bytes: &[u8]) -> Result<(), DurableError> {
        self.disk.write(&fresh(path), 0, bytes)?;
        self.disk.sync(&fresh(path))
    }

    /// Gives what was prepared its name; durable on return.
    ///
    /// # Errors
    /// [`DurableError`]; then it has its name or not.
    pub fn adopt(&self, path: &str) -> Result<(), DurableError> {
        self.disk.rename(&fresh(path), path)?;
        self.disk.sync_folder(folder(path))
    }

    /// Removes what [`Files::draft`] wrote.
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn discard(&self, path: &str) -> Result<(), DurableError> {
        self.disk.remove(&fresh(path))
    }

    /// Replaces files, durably on return; after a crash each is the old one or the new one, whole.
    ///
    /// All are flushed before the first is renamed.
    ///
    /// # Errors
    /// [`DurableError`]; then any number of the first files may have been replaced.
    pub fn replace(&self, files: &[(String, Vec<u8>)]) -> Result<(), DurableError> {
        let fresh: Vec<String> = files.iter().map(|(path, _)| fresh(path)).collect();
        for (path, (_, bytes)) in fresh.iter().zip(files) {
            self.disk.write(path, 0, bytes)?;
        }
        self.disk.sync_files(&fresh)?;
        let mut folders = BTreeSet::new();
        for (fresh, (path, _)) in fresh.iter().zip(files) {
            self.disk.rename(fresh, path)?;
            folders.insert(folder(path));
        }
        self.disk.sync_folders(&folders.into_iter().collect::<Vec<_>>())
    }

    /// Goes on with a file at `offset`, what was behind it forgotten; durable on return.
    ///
    /// # Errors
    /// [`DurableError`]; then anything may stand behind `offset`.
    pub fn append(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        self.disk.write(path, offset, bytes)?;
        self.disk.sync(path)?;
        // Only a new file has a new name.
        if offset == 0 { self.disk.sync_folder(folder(path)) } else { Ok(()) }
    }

    /// As [`Disk::remove`].
    ///
    /// # Errors
    /// [`DurableError`].
    pub fn remove(&self, path: &str) -> Result<(), DurableError> {
        self.disk.remove(path)
    }
}

/// The name that a file has until it is complete. No other path ends so.
fn fresh(path: &str) -> String {
    format!("{path}.new")
}

fn folder(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}
