//! What the registry needs of a store: four operations, so that every one of
//! them can be made to fail in a test.
//!
//! Contract: a [`Store::put`] MUST be atomic: after a crash either all of its
//! entries are there or none. What a returned [`Store::flush`] covers MUST survive
//! a crash of the process and of the machine. Batches MUST NOT be reordered: where
//! a later one survived, so did the earlier.

mod disk;
mod lock;
mod memory;

pub use disk::DiskStore;
pub(crate) use disk::sync_folder;
pub use lock::{Holder, StoreLock};
pub use memory::{Fault, FaultyStore};

/// A key and its value.
pub type Entry = (Vec<u8>, Vec<u8>);

/// A key and the value that it gets; none takes the key away.
pub type Change = (Vec<u8>, Option<Vec<u8>>);

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

    /// Entries whose key begins with `prefix`, in ascending order of keys, from `prefix | from` on, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    fn scan(&self, prefix: &[u8], from: &[u8], limit: usize) -> Result<Vec<Entry>, StoreError>;
}

/// A store that failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("store at {place}: {operation} failed: {cause}")]
pub struct StoreError {
    /// `open`, `lock`, `get`, `put`, `flush`, `scan`, or what was done with a file.
    pub operation: &'static str,
    /// The folder or file, or `memory`.
    pub place: String,
    /// What was said.
    pub cause: String,
}
