//! What a witness remembers, on disk: small files that are replaced whole.
//!
//! Replacing writes beside, syncs, renames and syncs the folder: after a crash at any moment the file is the old one
//! or the new one, and once it has returned it is the new one. Each step is a method of [`Storage`], so that tests
//! can make each fail.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use cairn_durable::{LockFile, read_limited_if_there, sync_folder};

/// Folder of the files that say what was cosigned last, one a log.
pub(crate) const LOGS: &str = "logs";
/// Folder of the evidence of logs that contradict themselves.
pub(crate) const EVIDENCE: &str = "evidence";

/// Largest file that is read, bytes; the files hold notes of limited size.
const MAX_FILE_BYTES: u64 = 4 << 20;

/// Files in two folders, `logs` and `evidence`; names are `folder/file`.
///
/// Contract: what `write` and `sync` of a file and then `rename` and `sync_folder` were told MUST survive a power cut
/// once all four returned. The implementation sees to it that it has one user.
pub trait Storage: Send + Sync {
    /// The bytes of a file, if there is one.
    ///
    /// # Errors
    /// Where that cannot be told.
    fn read(&self, name: &str) -> io::Result<Option<Vec<u8>>>;

    /// The files of a folder, without its name.
    ///
    /// # Errors
    /// Where that cannot be told.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;

    /// Makes a file, or one that is there new.
    ///
    /// # Errors
    /// Where not all of it was written.
    fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()>;

    /// Flushes a file's bytes to the disk.
    ///
    /// # Errors
    /// Where that is not known to have happened.
    fn sync(&self, name: &str) -> io::Result<()>;

    /// Gives a file another name in its folder, in place of one that had it.
    ///
    /// # Errors
    /// Where it was not renamed.
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Flushes a folder's names to the disk.
    ///
    /// # Errors
    /// Where that is not known to have happened.
    fn sync_folder(&self, folder: &str) -> io::Result<()>;
}

/// Puts `bytes` in place of the file, whole and durable.
///
/// # Errors
/// The step that failed; what the file holds is then either the old or the new.
pub(crate) fn replace(storage: &dyn Storage, folder: &str, file: &str, bytes: &[u8]) -> io::Result<()> {
    let (name, beside) = (format!("{folder}/{file}"), format!("{folder}/{file}.new"));
    let failed = |step: &str, e: io::Error| io::Error::new(e.kind(), format!("cannot {step} {name}: {e}"));
    storage.write(&beside, bytes).map_err(|e| failed("write", e))?;
    storage.sync(&beside).map_err(|e| failed("sync", e))?;
    storage.rename(&beside, &name).map_err(|e| failed("replace", e))?;
    storage.sync_folder(folder).map_err(|e| failed("sync the folder of", e))
}

/// A folder of the disk, locked.
#[derive(Debug)]
pub struct FolderStorage {
    path: PathBuf,
    _lock: LockFile,
}

impl FolderStorage {
    /// Opens the folder, made where absent, as its only user.
    ///
    /// # Errors
    /// [`io::ErrorKind::WouldBlock`] names the process that holds it; whatever else the system refuses, with the path.
    pub fn open(path: &Path) -> io::Result<Self> {
        let failed = |e: io::Error| io::Error::new(e.kind(), format!("cannot open {}: {e}", path.display()));
        for folder in [LOGS, EVIDENCE] {
            fs::create_dir_all(path.join(folder)).map_err(failed)?;
        }
        let lock = LockFile::take(&path.join("LOCK"))?;
        sync_folder(path)?;
        if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            sync_folder(parent)?;
        }
        Ok(Self { path: path.to_owned(), _lock: lock })
    }
}

impl Storage for FolderStorage {
    fn read(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        Ok(read_limited_if_there(&self.path.join(name), MAX_FILE_BYTES)?)
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let entries = fs::read_dir(self.path.join(folder))?;
        entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
    }

    fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        File::create(self.path.join(name))?.write_all(bytes)
    }

    fn sync(&self, name: &str) -> io::Result<()> {
        // `fsync` is about the file, not the handle; some systems want one that may write.
        File::options().write(true).open(self.path.join(name))?.sync_all()
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.path.join(from), self.path.join(to))
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        Ok(sync_folder(&self.path.join(folder))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_replaced_and_the_folder_has_one_user() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/witness");
        let storage = FolderStorage::open(&path).unwrap();
        assert_eq!(storage.read("logs/a").unwrap(), None);
        for text in ["one", "two"] {
            replace(&storage, LOGS, "a", text.as_bytes()).unwrap();
            assert_eq!(storage.read("logs/a").unwrap().unwrap(), text.as_bytes());
        }
        assert_eq!(storage.list(LOGS).unwrap(), ["a"]);
        let refused = FolderStorage::open(&path).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::WouldBlock);
        assert!(refused.to_string().contains(&std::process::id().to_string()), "{refused}");
        drop(storage);
        FolderStorage::open(&path).unwrap();
    }

    #[test]
    fn a_monstrous_file_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        let storage = FolderStorage::open(dir.path()).unwrap();
        File::create(dir.path().join("logs/a")).unwrap().set_len(MAX_FILE_BYTES + 1).unwrap();
        assert!(storage.read("logs/a").unwrap_err().to_string().contains("at most"));
    }
}
