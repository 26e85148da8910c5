//! Plain files that are there whole or not at all: tiles, checkpoints and packs of envelopes.
//!
//! Two layers. [`Disk`] is what an operating system offers, one call an operation, so
//! that every write, flush and rename can be made to fail in a test ([`crate::store::FaultyStore`]
//! is one, [`RealDisk`] the other). [`Files`] is made of those: replacing a file atomically,
//! going on with one at a known length.

mod real;

use std::collections::BTreeSet;

use crate::store::StoreError;

pub use real::RealDisk;

/// What the operating system does with files. Paths are relative, with `/` between their parts.
///
/// Contract: what a returned [`Disk::sync`] covers MUST survive a crash under every name that a returned
/// [`Disk::sync_folder`] covers; what neither covers may be there, in part or in whole, or not.
pub trait Disk: Send + Sync {
    /// The bytes of a file; none where there is no such file.
    ///
    /// # Errors
    /// [`StoreError`], also for a file of more than `limit` bytes, before it is read.
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError>;

    /// At most `length` bytes from `offset` on, fewer where the file ends before; none where there is no such file.
    ///
    /// # Errors
    /// [`StoreError`].
    fn read_at(&self, path: &str, offset: u64, length: usize) -> Result<Option<Vec<u8>>, StoreError>;

    /// A file held open; none where there is no such file.
    ///
    /// # Errors
    /// [`StoreError`].
    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, StoreError>;

    /// Cuts the file off at `offset`, or makes it where it is absent, folders included, and writes behind that.
    ///
    /// # Errors
    /// [`StoreError`], also for a file shorter than `offset`.
    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), StoreError>;

    /// Flushes a file's bytes and length.
    ///
    /// # Errors
    /// [`StoreError`].
    fn sync(&self, path: &str) -> Result<(), StoreError>;

    /// Flushes several files. At the same time where that is cheaper: a file system flushes a group for the price of one.
    ///
    /// # Errors
    /// [`StoreError`], of the first that failed; others may be flushed or not.
    fn sync_files(&self, paths: &[String]) -> Result<(), StoreError> {
        paths.iter().try_for_each(|path| self.sync(path))
    }

    /// Flushes the names in several folders, as [`Disk::sync_files`] does files.
    ///
    /// # Errors
    /// As [`Disk::sync_files`].
    fn sync_folders(&self, paths: &[&str]) -> Result<(), StoreError> {
        paths.iter().try_for_each(|path| self.sync_folder(path))
    }

    /// Gives a file another name, in place of what had it.
    ///
    /// # Errors
    /// [`StoreError`].
    fn rename(&self, from: &str, to: &str) -> Result<(), StoreError>;

    /// Flushes the names in a folder (the empty path: the root).
    ///
    /// # Errors
    /// [`StoreError`].
    fn sync_folder(&self, path: &str) -> Result<(), StoreError>;

    /// Removes a file, or a folder with all in it; absence is no error.
    ///
    /// # Errors
    /// [`StoreError`].
    fn remove(&self, path: &str) -> Result<(), StoreError>;
}

/// A file that is read at many places. What it was opened on stays readable after it lost its name.
pub trait OpenFile: Send + Sync {
    /// Its length, bytes.
    ///
    /// # Errors
    /// [`StoreError`].
    fn size(&self) -> Result<u64, StoreError>;

    /// At most `length` bytes from `offset` on, fewer where the file ends before.
    ///
    /// # Errors
    /// [`StoreError`].
    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, StoreError>;
}

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
    /// [`StoreError`].
    pub fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        self.disk.read(path, limit)
    }

    /// As [`Disk::read_at`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read_at(&self, path: &str, offset: u64, length: usize) -> Result<Option<Vec<u8>>, StoreError> {
        self.disk.read_at(path, offset, length)
    }

    /// As [`Disk::open`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, StoreError> {
        self.disk.open(path)
    }

    /// Goes on with the file that is to become `path` at `offset`, what was behind it forgotten. Not durable, and not there
    /// under its name, before [`Files::complete`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn draft(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), StoreError> {
        self.disk.write(&fresh(path), offset, bytes)
    }

    /// Gives a file its name once it is complete; durable on return.
    ///
    /// # Errors
    /// [`StoreError`]; then it has its name or not.
    pub fn complete(&self, path: &str) -> Result<(), StoreError> {
        self.disk.sync(&fresh(path))?;
        self.adopt(path)
    }

    /// Writes and flushes what is to become `path`, which stays what it is before [`Files::adopt`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn prepare(&self, path: &str, bytes: &[u8]) -> Result<(), StoreError> {
        self.disk.write(&fresh(path), 0, bytes)?;
        self.disk.sync(&fresh(path))
    }

    /// Gives what was prepared its name; durable on return.
    ///
    /// # Errors
    /// [`StoreError`]; then it has its name or not.
    pub fn adopt(&self, path: &str) -> Result<(), StoreError> {
        self.disk.rename(&fresh(path), path)?;
        self.disk.sync_folder(folder(path))
    }

    /// Removes what [`Files::draft`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn discard(&self, path: &str) -> Result<(), StoreError> {
        self.disk.remove(&fresh(path))
    }

    /// Replaces files, durably on return; after a crash each is the old one or the new one, whole.
    ///
    /// All are flushed before the first is renamed.
    ///
    /// # Errors
    /// [`StoreError`]; then any number of the first files may have been replaced.
    pub fn replace(&self, files: &[(String, Vec<u8>)]) -> Result<(), StoreError> {
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
    /// [`StoreError`]; then anything may stand behind `offset`.
    pub fn append(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), StoreError> {
        self.disk.write(path, offset, bytes)?;
        self.disk.sync(path)?;
        // Only a new file has a new name.
        if offset == 0 { self.disk.sync_folder(folder(path)) } else { Ok(()) }
    }

    /// As [`Disk::remove`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn remove(&self, path: &str) -> Result<(), StoreError> {
        self.disk.remove(path)
    }
}

/// The name that a file has until it is complete. No path of a log ends so.
fn fresh(path: &str) -> String {
    format!("{path}.new")
}

fn folder(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}
