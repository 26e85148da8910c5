//! What the registry needs of a store: four operations, so that every one of
//! them can be made to fail in a test.
//!
//! Contract: a [`Store::put`] MUST be atomic: after a crash either all of its
//! entries are there or none. What a returned [`Store::flush`] covers MUST survive
//! a crash of the process and of the machine. Batches MUST NOT be reordered: where
//! a later one survived, so did the earlier.
//!
//! [`DiskStore`] is sled. [`TieredStore`] keeps a store small by moving what only accumulates into sorted files.

mod disk;
#[cfg(any(test, feature = "testing"))]
mod memory;
mod tiered;

pub use disk::DiskStore;
pub(crate) use disk::await_closed;
#[cfg(any(test, feature = "testing"))]
pub use memory::FaultyStore;
pub use tiered::{Cold, KnownFile, TieredStore};

use cairn_durable::DurableError;

/// A key and its value.
pub type Entry = (Vec<u8>, Vec<u8>);

/// A key and the value that it gets; none takes the key away.
pub type Change = (Vec<u8>, Option<Vec<u8>>);

impl From<DurableError> for StoreError {
    fn from(error: DurableError) -> Self {
        let (operation, path, cause) = match error {
            DurableError::Io { operation, path, cause } => (operation, path, cause.to_string()),
            DurableError::TooLarge { ref path, .. } => ("read", path.clone(), error.to_string()),
            DurableError::Locked { ref path, .. } => ("lock", path.clone(), error.to_string()),
        };
        Self::new(operation, path.display(), cause)
    }
}

/// An ordered map of bytes that can be written durably.
pub trait Store: Send + Sync {
    /// The value of a key.
    ///
    /// # Errors
    /// [`StoreError`] where the store cannot tell.
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError>;

    /// Makes all changes or none; durable only after [`Store::flush`].
    ///
    /// # Errors
    /// [`StoreError`]; afterwards the changes may be there or not.
    fn put(&self, batch: Vec<Change>) -> Result<(), StoreError>;

    /// Makes everything written so far durable.
    ///
    /// # Errors
    /// [`StoreError`]; afterwards what was not durable before may be so or not.
    fn flush(&self) -> Result<(), StoreError>;

    /// Entries whose key is `from` or greater and, where there is a bound, less than `to`; ascending, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError>;

    /// Entries whose key begins with `prefix`, in ascending order of keys, from `prefix | from` on, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    fn scan(&self, prefix: &[u8], from: &[u8], limit: usize) -> Result<Vec<Entry>, StoreError> {
        let end = successor(prefix);
        self.range(&[prefix, from].concat(), end.as_deref(), limit)
    }

    /// Puts in order what writing left behind, while others read and write. Takes seconds where there is much; `stop`
    /// is asked now and then, and ends it early with nothing lost.
    ///
    /// # Errors
    /// [`StoreError`]; nothing is lost, and the next call tries again.
    fn tidy(&self, _stop: &dyn Fn() -> bool) -> Result<(), StoreError> {
        Ok(())
    }

    /// Files whose bytes never change, with the digests that they had when they were written.
    fn known_files(&self) -> Vec<KnownFile> {
        Vec::new()
    }
}

/// The smallest key that is greater than every key with this prefix; none where there is no such key.
pub(crate) fn successor(prefix: &[u8]) -> Option<Vec<u8>> {
    let at = prefix.iter().rposition(|byte| *byte != 0xff)?;
    let mut end = prefix[..=at].to_vec();
    end[at] += 1;
    Some(end)
}

/// A store that failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("store at {place}: {operation} failed: {cause}")]
pub struct StoreError {
    /// `open`, `lock`, `get`, `put`, `flush`, `range`, or what was done with a file.
    pub operation: &'static str,
    /// The folder or file, or `memory`.
    pub place: String,
    /// What was said.
    pub cause: String,
}

impl StoreError {
    pub(crate) fn new(operation: &'static str, place: impl ToString, cause: impl ToString) -> Self {
        Self { operation, place: place.to_string(), cause: cause.to_string() }
    }
}
