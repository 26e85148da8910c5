//! The store on disk: one sled tree.
//!
//! The only file that names sled. Sled's own background flush is off: data
//! becomes durable when we say so, and an acknowledgement always follows a flush of ours.
//!
//! Sled 0.34's `flush` is not enough for that: on Linux it ends in `sync_file_range`, which leaves the
//! file's size and the drive's cache alone, and it never syncs the blob files that large values go to
//! (sled 0.34.7, pagecache/iobuf.rs and pagecache/blob_io.rs). So ours goes on to flush the files themselves.

use std::{
    collections::HashSet,
    ffi::OsString,
    fs::{self, File, TryLockError},
    io,
    ops::Bound,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    thread,
    time::Duration,
};

use cairn_durable::sync_folder;

use super::{Change, Entry, Store, StoreError};

/// Sled gives up its own file lock a moment after the last handle is dropped, from another thread.
const OPEN_TRIES: u32 = 50;
const OPEN_PAUSE: Duration = Duration::from_millis(20);

/// A sled database.
#[derive(Debug)]
pub struct DiskStore {
    db: sled::Db,
    folder: PathBuf,
    /// Sled's log file, opened once more: a flush is about the file, not the handle.
    log: File,
    /// Blob files that are synced; sled never changes one.
    synced_blobs: Mutex<HashSet<OsString>>,
}

impl DiskStore {
    /// Opens the database in `folder`, made where absent.
    ///
    /// A new one is made under another name and renamed once it is whole: sled writes a new database in several steps, and
    /// does not open one again whose making was cut short.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        if !folder.try_exists().map_err(|e| error("open", folder, &e))? {
            Self::make(folder)?;
        }
        Self::opened(Self::open_sled(folder)?, folder).map_err(|e| error("open", folder, &e))
    }

    fn make(folder: &Path) -> Result<(), StoreError> {
        let mut name = folder.as_os_str().to_owned();
        name.push(".new");
        let new = PathBuf::from(name);
        let failed = |e: io::Error| StoreError::new("make", new.display(), e);
        cairn_durable::remove(&new)?;
        drop(Self::opened(Self::open_sled(&new)?, &new).map_err(failed)?);
        // Sled writes for a moment after the last handle is dropped, and by name: it must be through before the rename.
        await_closed(&new.join("db")).map_err(failed)?;
        Ok(cairn_durable::rename(&new, folder)?)
    }

    fn open_sled(folder: &Path) -> Result<sled::Db, StoreError> {
        remove_half_snapshots(folder).map_err(|e| error("open", folder, &e))?;
        let config = sled::Config::new().path(folder).flush_every_ms(None).cache_capacity(64 << 20);
        let mut tries = 1;
        loop {
            match config.open() {
                Err(sled::Error::Io(e)) if tries < OPEN_TRIES && e.to_string().contains("lock") => {
                    tries += 1;
                    thread::sleep(OPEN_PAUSE);
                }
                opened => return opened.map_err(|e| error("open", folder, &e)),
            }
        }
    }

    fn opened(db: sled::Db, folder: &Path) -> io::Result<Self> {
        let log = File::options().read(true).write(true).open(folder.join("db"))?;
        let store = Self { db, folder: folder.into(), log, synced_blobs: Mutex::default() };
        store.sync_files()?;
        // The names of the folder and of what sled made in it.
        sync_folder(folder)?;
        folder.parent().map_or(Ok(()), sync_folder)?;
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
        // `fdatasync`: the length as well, where it changed. Where it did not the file system's journal is spared.
        self.log.sync_data()
    }

    fn error(&self, operation: &'static str, cause: &sled::Error) -> StoreError {
        error(operation, &self.folder, cause)
    }
}

/// Sled writes for a moment after its last handle is dropped, and holds its lock until then.
pub(crate) fn await_closed(db: &Path) -> io::Result<()> {
    let file = File::open(db)?;
    for _ in 0..250 {
        match file.try_lock() {
            Ok(()) => return file.unlock(),
            Err(TryLockError::WouldBlock) => thread::sleep(OPEN_PAUSE),
            Err(TryLockError::Error(e)) => return Err(e),
        }
    }
    Err(io::Error::new(io::ErrorKind::TimedOut, "the store does not close"))
}

/// Sled writes a snapshot of its page table at each start as `snap.<lsn>.generating`, and renames it once it is whole. One
/// that was cut short it takes for a snapshot, finds it corrupt and never opens the database again (sled 0.34.7, config.rs,
/// `get_snapshot_files`). Without it sled goes on from the one before, or from the log.
fn remove_half_snapshots(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with("snap.") && name.ends_with(".generating") {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn error(operation: &'static str, folder: &Path, cause: &dyn std::error::Error) -> StoreError {
    StoreError::new(operation, folder.display(), cause)
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

    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError> {
        let (from, to) = (Bound::Included(from), to.map_or(Bound::Unbounded, Bound::Excluded));
        let entries = self.db.range::<&[u8], _>((from, to)).take(limit);
        let entries = entries.map(|entry| entry.map(|(key, value)| (key.to_vec(), value.to_vec())));
        entries.collect::<Result<_, _>>().map_err(|e| self.error("range", &e))
    }
}
