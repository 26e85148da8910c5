//! One user per folder: a lock file that names its holder.
//!
//! The lock is the operating system's (`flock`), so it goes with the process that held it, however that ended. The
//! process id inside only serves the message.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};

use crate::error::DurableError;

/// Bytes of the lock file that are read: a process id has fewer.
const MAX_PID_BYTES: u64 = 32;

/// A held lock; let go when dropped.
#[derive(Debug)]
pub struct LockFile {
    _file: File,
}

impl LockFile {
    /// Takes the lock `path`, a file that is made where absent, and writes the process id into it.
    ///
    /// # Errors
    /// [`DurableError::Locked`] names the holder; [`DurableError::Io`].
    pub fn take(path: &Path) -> Result<Self, DurableError> {
        let failed = DurableError::io("lock", path);
        let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        let mut file = opened.map_err(&failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(held(path, file)),
            Err(TryLockError::Error(e)) => return Err(failed(e)),
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(&failed)?;
        writeln!(file, "{}", std::process::id()).map_err(failed)?;
        Ok(Self { _file: file })
    }

    /// Checks that no process holds the lock `path`, and leaves the file as it is.
    ///
    /// # Errors
    /// [`DurableError::Locked`] names the holder. A file that is absent or cannot be opened counts as free.
    pub fn must_be_free(path: &Path) -> Result<(), DurableError> {
        let Ok(file) = File::open(path) else { return Ok(()) };
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Err(held(path, file)),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
        }
    }
}

fn held(path: &Path, file: File) -> DurableError {
    let mut pid = String::new();
    // The holder may be between taking the lock and writing its id: then it is unknown.
    let _ = file.take(MAX_PID_BYTES).read_to_string(&mut pid);
    let pid = if pid.trim().is_empty() { "unknown" } else { pid.trim() };
    DurableError::Locked { path: PathBuf::from(path), pid: pid.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_holder_is_refused_and_the_first_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("LOCK");
        LockFile::must_be_free(&path).unwrap();
        assert!(!path.exists());
        let held = LockFile::take(&path).unwrap();
        let own = std::process::id().to_string();
        for refused in [LockFile::take(&path).unwrap_err(), LockFile::must_be_free(&path).unwrap_err()] {
            assert!(matches!(&refused, DurableError::Locked { pid, .. } if *pid == own), "{refused}");
        }
        drop(held);
        LockFile::must_be_free(&path).unwrap();
        LockFile::take(&path).unwrap();
    }
}
