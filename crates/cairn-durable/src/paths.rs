//! Single files and folders, by path.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::error::DurableError;

/// The folder that `path` lies in; the working directory for a bare name.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Replaces `path` by `bytes`, durable on return: after a crash there is the old file or the new one, whole.
///
/// Writes `path` + `.new`, flushes it, renames it and flushes the folder. What lay at `.new` is removed first: it is
/// never written into, so a link there leads nowhere.
///
/// # Errors
/// [`DurableError::Io`]; then `path` is the old file, or the new one where only the folder was not flushed.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), DurableError> {
    replace(path, bytes, OpenOptions::new().create_new(true).write(true))
}

/// As [`write_atomic`]; only the file's owner may read it (mode 600).
///
/// # Errors
/// As [`write_atomic`].
pub fn write_secret(path: &Path, bytes: &[u8]) -> Result<(), DurableError> {
    let mut secret = OpenOptions::new();
    secret.create_new(true).write(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut secret, 0o600);
    replace(path, bytes, &secret)
}

fn replace(path: &Path, bytes: &[u8], how: &OpenOptions) -> Result<(), DurableError> {
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    let temporary = PathBuf::from(temporary);
    remove(&temporary)?;
    let written = || {
        let mut file = how.open(&temporary).map_err(DurableError::io("create", &temporary))?;
        file.write_all(bytes).and_then(|()| file.sync_all()).map_err(DurableError::io("write", &temporary))?;
        fs::rename(&temporary, path).map_err(DurableError::io("replace", path))
    };
    // The write's own error is the one to report.
    written().inspect_err(|_| drop(remove(&temporary)))?;
    sync_folder(folder_of(path))
}

/// Makes the file `path`, mode 600, durable on return; one that is there stays as it is.
///
/// # Errors
/// [`DurableError::Io`], of kind [`io::ErrorKind::AlreadyExists`] where there is something at `path`.
pub fn create_secret(path: &Path, bytes: &[u8]) -> Result<(), DurableError> {
    let (folder, failed) = (folder_of(path), DurableError::io("write", path));
    // Opened with O_EXCL and mode 600.
    let mut file = tempfile::NamedTempFile::new_in(folder).map_err(&failed)?;
    file.write_all(bytes).and_then(|()| file.as_file().sync_all()).map_err(&failed)?;
    file.persist_noclobber(path).map_err(|e| failed(e.error))?;
    sync_folder(folder)
}

/// Writes and flushes the file `path`, new or over what was there. Neither atomic nor findable after a crash before
/// [`sync_folder`]: for folders that get their own name later.
///
/// # Errors
/// [`DurableError::Io`].
pub fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), DurableError> {
    let mut file = File::create(path).map_err(DurableError::io("create", path))?;
    file.write_all(bytes).and_then(|()| file.sync_all()).map_err(DurableError::io("write", path))
}

/// Renames a file or folder and flushes the folder of its new name.
///
/// # Errors
/// [`DurableError::Io`]; then it has its old name, or the new one where only the folder was not flushed.
pub fn rename(from: &Path, to: &Path) -> Result<(), DurableError> {
    fs::rename(from, to).map_err(DurableError::io("create", to))?;
    sync_folder(folder_of(to))
}

/// Flushes a folder's names: without that a new one in it may be lost in a power cut.
///
/// # Errors
/// [`DurableError::Io`].
pub fn sync_folder(path: &Path) -> Result<(), DurableError> {
    if cfg!(unix) {
        File::open(path).and_then(|folder| folder.sync_all()).map_err(DurableError::io("flush the folder", path))?;
    }
    Ok(())
}

/// Makes a folder and those that it lies in, where absent, and flushes each new name.
///
/// # Errors
/// [`DurableError::Io`].
pub fn make_folders(folder: &Path) -> Result<(), DurableError> {
    if folder.as_os_str().is_empty() || folder.is_dir() {
        return Ok(());
    }
    let parent = folder_of(folder);
    make_folders(parent)?;
    match fs::create_dir(folder) {
        Err(e) if e.kind() != io::ErrorKind::AlreadyExists => Err(DurableError::io("create", folder)(e)),
        _ => sync_folder(parent),
    }
}

/// The bytes of the file `path`, where they are at most `limit`.
///
/// # Errors
/// [`DurableError::TooLarge`], before a byte is read where the file states its length; [`DurableError::Io`].
pub fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, DurableError> {
    read_open(File::open(path).map_err(DurableError::io("open", path))?, path, limit)
}

/// As [`read_limited`], of a secret; and its permission bits where others may read it or write to it ([`open_to_others`]).
///
/// # Errors
/// As [`read_limited`].
pub fn read_secret(path: &Path, limit: u64) -> Result<(Vec<u8>, Option<u32>), DurableError> {
    let file = File::open(path).map_err(DurableError::io("open", path))?;
    let mode = open_to_others(&file).map_err(DurableError::io("look at", path))?;
    Ok((read_open(file, path, limit)?, mode))
}

/// The permission bits of a file where others than its owner may read it or write to it. `None` for what is no regular
/// file: a pipe's bits say nothing of who reads it.
///
/// # Errors
/// The system's.
#[cfg(unix)]
pub fn open_to_others(file: &File) -> io::Result<Option<u32>> {
    use std::os::unix::fs::PermissionsExt as _;
    let about = file.metadata()?;
    let mode = about.permissions().mode() & 0o777;
    Ok((about.is_file() && mode & 0o077 != 0).then_some(mode))
}

/// The permission bits of a file where others than its owner may read it or write to it: not known on this system.
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub fn open_to_others(_: &File) -> io::Result<Option<u32>> {
    Ok(None)
}

fn read_open(file: File, path: &Path, limit: u64) -> Result<Vec<u8>, DurableError> {
    let failed = DurableError::io("read", path);
    let length = file.metadata().map_err(&failed)?.len();
    let too_large = |got| DurableError::TooLarge { path: path.to_path_buf(), limit, got };
    if length > limit {
        return Err(too_large(Some(length)));
    }
    let mut bytes = Vec::with_capacity(length as usize);
    // A pipe states no length, and a file may grow between the look and the read.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limit { Err(too_large(None)) } else { Ok(bytes) }
}

/// As [`read_limited`]; `None` where there is no such file.
///
/// # Errors
/// As [`read_limited`].
pub fn read_limited_if_there(path: &Path, limit: u64) -> Result<Option<Vec<u8>>, DurableError> {
    match read_limited(path, limit) {
        Err(error) if error.is_not_found() => Ok(None),
        read => read.map(Some),
    }
}

/// Removes a file, or a folder with all in it; absence is no error. Durable only after [`sync_folder`].
///
/// # Errors
/// [`DurableError::Io`].
pub fn remove(path: &Path) -> Result<(), DurableError> {
    // A link to a folder is a file here: what it leads to stays.
    let is_folder = fs::symlink_metadata(path).is_ok_and(|there| there.is_dir());
    let removed = if is_folder { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(DurableError::io("remove", path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writing_replaces_whole_files() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        write_atomic(&path, b"first, and longer").unwrap();
        write_atomic(&path, b"second").unwrap();
        assert_eq!(read_limited(&path, 6).unwrap(), b"second");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file stays");
    }

    #[test]
    fn reading_is_bounded() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        assert!(read_limited(&path, 5).unwrap_err().is_not_found());
        assert_eq!(read_limited_if_there(&path, 5).unwrap(), None);
        write_synced(&path, b"second").unwrap();
        let refused = read_limited(&path, 5).unwrap_err();
        assert!(matches!(refused, DurableError::TooLarge { limit: 5, got: Some(6), .. }), "{refused}");
        assert!(refused.to_string().ends_with("has 6 bytes, at most 5 are read"), "{refused}");
        // What states no length is read to the limit, and not on.
        if cfg!(target_os = "linux") {
            let refused = read_limited(Path::new("/dev/zero"), 5).unwrap_err();
            assert!(matches!(refused, DurableError::TooLarge { limit: 5, got: None, .. }), "{refused}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn writing_follows_no_link_and_leaves_nothing_half_done() {
        use std::os::unix::fs::{PermissionsExt as _, symlink};
        let dir = tempfile::tempdir().unwrap();
        let (path, new, victim) = (dir.path().join("a"), dir.path().join("a.new"), dir.path().join("victim"));
        let mode = || fs::metadata(&path).unwrap().permissions().mode() & 0o777;
        fs::write(&victim, b"theirs").unwrap();
        symlink(&victim, &new).unwrap();
        write_secret(&path, b"mine").unwrap();
        assert_eq!((fs::read(&victim).unwrap(), fs::read(&path).unwrap()), (b"theirs".into(), b"mine".into()));
        assert_eq!(mode(), 0o600);
        // What an earlier one left readable for all does not stay so.
        fs::write(&new, b"left").unwrap();
        write_secret(&path, b"mine").unwrap();
        assert_eq!(mode(), 0o600);
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(write_atomic(&path, b"mine").is_err() && !new.exists());
    }

    #[test]
    fn a_new_secret_replaces_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        create_secret(&path, b"first").unwrap();
        let refused = create_secret(&path, b"second").unwrap_err();
        let DurableError::Io { cause, .. } = &refused else { panic!("{refused}") };
        assert_eq!(cause.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file stays");
    }
}
