//! One witness a folder: two that sign with one key from two memories would cosign two histories.
//!
//! The lock is the operating system's, so it goes with the process that held it, however that ended; the process id inside
//! only serves the message.

use std::{
    fs::{File, OpenOptions},
    io::{self, Read as _, Seek as _, Write as _},
    path::Path,
};

use fs4::{FileExt, TryLockError};

/// A held lock; let go when dropped.
#[derive(Debug)]
pub(crate) struct FolderLock {
    _file: File,
}

impl FolderLock {
    /// Takes `folder/LOCK`.
    ///
    /// # Errors
    /// [`io::ErrorKind::WouldBlock`] names the holder.
    pub(crate) fn take(folder: &Path) -> io::Result<Self> {
        let path = folder.join("LOCK");
        let failed = |e: io::Error| io::Error::new(e.kind(), format!("cannot lock {}: {e}", path.display()));
        let mut file =
            (OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path)).map_err(failed)?;
        match FileExt::try_lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut pid = String::new();
                // The holder may be between taking the lock and writing its id.
                file.take(32).read_to_string(&mut pid).map_err(failed)?;
                let holder = if pid.trim().is_empty() { "unknown" } else { pid.trim() };
                let what = format!("{} is held by process {holder}; stop it, or use another folder", path.display());
                return Err(io::Error::new(io::ErrorKind::WouldBlock, what));
            }
            Err(TryLockError::Error(e)) => return Err(failed(e)),
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(failed)?;
        writeln!(file, "{}", std::process::id()).map_err(failed)?;
        Ok(Self { _file: file })
    }
}
