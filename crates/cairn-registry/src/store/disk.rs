//! The store on disk: one sled tree.
//!
//! The only file that names sled. Sled's own background flush is off: data
//! becomes durable when we say so, and an acknowledgement always follows a flush of ours.
//!
//! Sled 0.34's `flush` is not enough for that: on Linux it ends in `sync_file_range`, which leaves the
//! file's size and the drive's cache alone, and it never syncs the blob files that large values go to
//! (sled 0.34.7, pagecache/iobuf.rs and pagecache/blob_io.rs). So ours goes on to `fsync` the files themselves.

use std::{
    collections::HashSet,
    ffi::OsString,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    thread,
    time::Duration,
};

use super::{Change, Entry, Store, StoreError};

/// Sled gives up its own file lock a moment after the last handle is dropped, from another thread.
const OPEN_TRIES: u32 = 50;
const OPEN_PAUSE: Duration = Duration::from_millis(20);

/// A sled database.
#[derive(Debug)]
pub struct DiskStore {
    db: sled::Db,
    folder: PathBuf,
    /// Sled's log file, opened once more: `fsync` is about the file, not the handle.
    log: File,
    /// Blob files that are synced; sled never changes one.
    synced_blobs: Mutex<HashSet<OsString>>,
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
                Ok(db) => return Self::opened(db, folder),
                Err(sled::Error::Io(e)) if tries < OPEN_TRIES && e.to_string().contains("lock") => {
                    tries += 1;
                    thread::sleep(OPEN_PAUSE);
                }
                Err(e) => return Err(error("open", folder, &e)),
            }
        }
    }

    fn opened(db: sled::Db, folder: &Path) -> Result<Self, StoreError> {
        let failed = |e: io::Error| error("open", folder, &e);
        let log = File::options().read(true).write(true).open(folder.join("db")).map_err(failed)?;
        let store = Self { db, folder: folder.into(), log, synced_blobs: Mutex::default() };
        store.sync_files().map_err(failed)?;
        // The names of the folder and of what sled made in it.
        sync_folder(folder).and_then(|()| folder.parent().map_or(Ok(()), sync_folder)).map_err(failed)?;
        Ok(store)
    }

    fn sync_files(&self) -> io::Result<()> {
        let mut synced = self.synced_blobs.lock().unwrap_or_else(PoisonError::into_inner);
        let blobs = self.folder.join("blobs");
        let mut fresh = Vec::new();
        for entry in fs::read_dir(&blobs)? {
            let name = entry?.file_name();
            if !synced.contains(&name) {
                match File::open(blobs.join(&name)) {
                    Ok(file) => file.sync_all()?,
                    // Sled removes blobs that nothing points to any more.
                    Err(e) if e.kind() == io::ErrorKind::NotFound => continue,
                    Err(e) => return Err(e),
                }
                fresh.push(name);
            }
        }
        if !fresh.is_empty() {
            sync_folder(&blobs)?;
            synced.extend(fresh);
        }
        self.log.sync_all()
    }

    fn error(&self, operation: &'static str, cause: &sled::Error) -> StoreError {
        error(operation, &self.folder, cause)
    }
}

/// A new name in a folder survives a power cut only once the folder is synced.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

fn error(operation: &'static str, folder: &Path, cause: &dyn std::error::Error) -> StoreError {
    StoreError { operation, place: folder.display().to_string(), cause: cause.to_string() }
}

impl Store for DiskStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        Ok(self.db.get(key).map_err(|e| self.error("get", &e))?.map(|value| value.to_vec()))
    }

    fn put(&self, changes: Vec<Change>) -> Result<(), StoreError> {
        let mut batch = sled::Batch::default();
        for (key, value) in changes {
            match value {
                Some(value) => batch.insert(key, value),
                None => batch.remove(key),
            }
        }
        self.db.apply_batch(batch).map_err(|e| self.error("put", &e))
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.db.flush().map_err(|e| self.error("flush", &e))?;
        self.sync_files().map_err(|e| error("flush", &self.folder, &e))
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
