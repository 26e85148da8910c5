//! The store on disk: one sled tree.
//!
//! The only file that names sled. Sled's own background flush is off: data
//! becomes durable when we say so, and an acknowledgement always follows a flush of ours.

use std::{
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use super::{Entry, Store, StoreError};

/// Sled gives up its own file lock a moment after the last handle is dropped, from another thread.
const OPEN_TRIES: u32 = 50;
const OPEN_PAUSE: Duration = Duration::from_millis(20);

/// A sled database.
#[derive(Debug)]
pub struct DiskStore {
    db: sled::Db,
    folder: PathBuf,
}

impl DiskStore {
    /// Opens the database in `folder`, made where absent.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let config = sled::Config::new().path(folder).flush_every_ms(None).cache_capacity(64 << 20);
        let mut tries = 1;
        loop {
            match config.open() {
                Ok(db) => return Ok(Self { db, folder: folder.into() }),
                Err(sled::Error::Io(e)) if tries < OPEN_TRIES && e.to_string().contains("lock") => {
                    tries += 1;
                    thread::sleep(OPEN_PAUSE);
                }
                Err(e) => return Err(error("open", folder, &e)),
            }
        }
    }

    fn error(&self, operation: &'static str, cause: &sled::Error) -> StoreError {
        error(operation, &self.folder, cause)
    }
}

fn error(operation: &'static str, folder: &Path, cause: &sled::Error) -> StoreError {
    StoreError { operation, place: folder.display().to_string(), cause: cause.to_string() }
}

impl Store for DiskStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        Ok(self.db.get(key).map_err(|e| self.error("get", &e))?.map(|value| value.to_vec()))
    }

    fn put(&self, entries: Vec<Entry>) -> Result<(), StoreError> {
        let mut batch = sled::Batch::default();
        for (key, value) in entries {
            batch.insert(key, value);
        }
        self.db.apply_batch(batch).map_err(|e| self.error("put", &e))
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.db.flush().map(drop).map_err(|e| self.error("flush", &e))
    }

    fn scan(&self, prefix: &[u8], from: &[u8], limit: usize) -> Result<Vec<Entry>, StoreError> {
        let start = [prefix, from].concat();
        let mut found = Vec::new();
        for entry in self.db.range(start..) {
            let (key, value) = entry.map_err(|e| self.error("scan", &e))?;
            if found.len() == limit || !key.starts_with(prefix) {
                break;
            }
            found.push((key.to_vec(), value.to_vec()));
        }
        Ok(found)
    }
}
