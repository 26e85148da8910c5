//! What an operating system offers for files, one call an operation, so that every write, flush and rename can be
//! made to fail in a test.

use crate::error::DurableError;

/// What the operating system does with files. Paths are relative, with `/` between their parts.
///
/// Contract: what a returned [`Disk::sync`] covers MUST survive a crash under every name that a returned
/// [`Disk::sync_folder`] covers; what neither covers may be there, in part or in whole, or not.
pub trait Disk: Send + Sync {
    /// The bytes of a file; none where there is no such file.
    ///
    /// # Errors
    /// [`DurableError`], also for a file of more than `limit` bytes, before it is read.
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, DurableError>;

    /// Names in a folder, in no order; none where there is no such folder.
    ///
    /// # Errors
    /// [`DurableError`].
    fn list(&self, folder: &str) -> Result<Vec<String>, DurableError>;

    /// A file held open; none where there is no such file.
    ///
    /// # Errors
    /// [`DurableError`].
    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError>;

    /// Cuts the file off at `offset`, or makes it where it is absent, folders included, and writes behind that.
    ///
    /// # Errors
    /// [`DurableError`], also for a file shorter than `offset`.
    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError>;

    /// Flushes a file's bytes and length.
    ///
    /// # Errors
    /// [`DurableError`].
    fn sync(&self, path: &str) -> Result<(), DurableError>;

    /// Flushes several files, at the same time where that is cheaper: a file system flushes a group
    /// for the price of one.
    ///
    /// # Errors
    /// [`DurableError`], of the first that failed; others may be flushed or not.
    fn sync_files(&self, paths: &[String]) -> Result<(), DurableError> {
        paths.iter().try_for_each(|path| self.sync(path))
    }

    /// Flushes the names in several folders, as [`Disk::sync_files`] does files.
    ///
    /// # Errors
    /// As [`Disk::sync_files`].
    fn sync_folders(&self, paths: &[&str]) -> Result<(), DurableError> {
        paths.iter().try_for_each(|path| self.sync_folder(path))
    }

    /// Gives a file another name, in place of what had it.
    ///
    /// # Errors
    /// [`DurableError`].
    fn rename(&self, from: &str, to: &str) -> Result<(), DurableError>;

    /// Flushes the names in a folder (the empty path: the root).
    ///
    /// # Errors
    /// [`DurableError`].
    fn sync_folder(&self, path: &str) -> Result<(), DurableError>;

    /// Removes a file, or a folder with all in it; absence is no error.
    ///
    /// # Errors
    /// [`DurableError`].
    fn remove(&self, path: &str) -> Result<(), DurableError>;
}

/// A file that is read at many places. What it was opened on stays readable after it lost its name.
pub trait OpenFile: Send + Sync {
    /// Its length, bytes.
    ///
    /// # Errors
    /// [`DurableError`].
    fn size(&self) -> Result<u64, DurableError>;

    /// At most `length` bytes from `offset` on, fewer where the file ends before.
    ///
    /// # Errors
    /// [`DurableError`].
    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, DurableError>;
}
