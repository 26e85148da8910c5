//! One writer per store: a lock file that names its holder.
//!
//! The lock is the operating system's (`flock`), so it goes with the process that
//! held it, however that ended; the process id inside only serves the message.

use std::{
    fs::{File, OpenOptions},
    io::{Read as _, Seek as _, Write as _},
    path::{Path, PathBuf},
};

use fs4::{FileExt, TryLockError};

use super::StoreError;

/// A held lock; let go when dropped.
#[derive(Debug)]
pub struct StoreLock {
    _file: File,
}

/// Who holds the lock that was asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Holder {
    /// The lock file.
    pub path: PathBuf,
    /// The holder's process id, as far as the file tells.
    pub pid: String,
}

impl StoreLock {
    /// Takes the lock `folder/LOCK`; `Ok(Err(holder))` where another has it.
    ///
    /// # Errors
    /// [`StoreError`] where the file cannot be made, locked or written.
    pub fn take(folder: &Path) -> Result<Result<Self, Holder>, StoreError> {
        let path = folder.join("LOCK");
        let failed = |e: std::io::Error| StoreError {
            operation: "lock",
            place: path.display().to_string(),
            cause: e.to_string(),
        };
        let mut file =
            (OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path)).map_err(failed)?;
        match FileExt::try_lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut pid = String::new();
                // The holder may be between taking the lock and writing its id.
                file.take(32).read_to_string(&mut pid).map_err(failed)?;
                let pid = if pid.trim().is_empty() { "unknown".into() } else { pid.trim().into() };
                return Ok(Err(Holder { path, pid }));
            }
            Err(TryLockError::Error(e)) => return Err(failed(e)),
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(failed)?;
        writeln!(file, "{}", std::process::id()).map_err(failed)?;
        Ok(Ok(Self { _file: file }))
    }
}
