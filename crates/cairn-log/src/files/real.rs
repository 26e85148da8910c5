//! The operating system's files, below one folder.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use super::{Disk, OpenFile};
use crate::store::{StoreError, sync_folder};

/// Files below a folder.
#[derive(Debug, Clone)]
pub struct RealDisk {
    root: PathBuf,
}

impl RealDisk {
    /// Files below `root`, which is there.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_path_buf() }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    fn failed(&self, operation: &'static str, path: &str) -> impl Fn(io::Error) -> StoreError {
        let place = self.at(path).display().to_string();
        move |e| StoreError { operation, place: place.clone(), cause: e.to_string() }
    }

    /// A new folder's name is flushed as well: a file in it is found again only through it.
    fn make_folders(&self, folder: &Path) -> io::Result<()> {
        if folder.is_dir() {
            return Ok(());
        }
        if let Some(parent) = folder.parent() {
            self.make_folders(parent)?;
            match fs::create_dir(folder) {
                Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
                _ => sync_folder(parent)?,
            }
        }
        Ok(())
    }

    fn open_for_writing(&self, path: &Path) -> io::Result<File> {
        let open = || OpenOptions::new().write(true).create(true).truncate(false).open(path);
        match open() {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                path.parent().map_or(Ok(()), |folder| self.make_folders(folder))?;
                open()
            }
            opened => opened,
        }
    }
}

impl Disk for RealDisk {
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let failed = self.failed("read", path);
        let file = match File::open(self.at(path)) {
            Ok(file) => file,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(failed(e)),
        };
        let length = file.metadata().map_err(&failed)?.len();
        if length > limit {
            let cause = format!("{length} bytes, at most {limit} are expected there");
            return Err(failed(io::Error::new(io::ErrorKind::FileTooLarge, cause)));
        }
        let mut bytes = Vec::with_capacity(length as usize);
        file.take(limit).read_to_end(&mut bytes).map_err(&failed)?;
        Ok(Some(bytes))
    }

    fn read_at(&self, path: &str, offset: u64, length: usize) -> Result<Option<Vec<u8>>, StoreError> {
        let failed = self.failed("read", path);
        let mut file = match File::open(self.at(path)) {
            Ok(file) => file,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(failed(e)),
        };
        file.seek(SeekFrom::Start(offset)).map_err(&failed)?;
        let mut bytes = Vec::with_capacity(length);
        file.take(length as u64).read_to_end(&mut bytes).map_err(&failed)?;
        Ok(Some(bytes))
    }

    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, StoreError> {
        match File::open(self.at(path)) {
            Ok(file) => Ok(Some(Box::new(RealFile { file, path: self.at(path) }))),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(self.failed("open", path)(e)),
        }
    }

    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let failed = self.failed("write", path);
        let mut file = self.open_for_writing(&self.at(path)).map_err(&failed)?;
        let length = file.metadata().map_err(&failed)?.len();
        if length < offset {
            let cause = format!("{length} bytes, at least {offset} are expected there");
            return Err(failed(io::Error::new(io::ErrorKind::UnexpectedEof, cause)));
        }
        file.set_len(offset).map_err(&failed)?;
        file.seek(SeekFrom::Start(offset)).map_err(&failed)?;
        file.write_all(bytes).map_err(&failed)
    }

    fn sync(&self, path: &str) -> Result<(), StoreError> {
        let opened = OpenOptions::new().write(true).open(self.at(path));
        // `fdatasync`: bytes and whatever it takes to find them again, the length included, but no times.
        opened.and_then(|file| file.sync_data()).map_err(self.failed("flush", path))
    }

    fn sync_files(&self, paths: &[String]) -> Result<(), StoreError> {
        at_once(paths, |path| self.sync(path))
    }

    fn sync_folders(&self, paths: &[&str]) -> Result<(), StoreError> {
        at_once(paths, |path| self.sync_folder(path))
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), StoreError> {
        fs::rename(self.at(from), self.at(to)).map_err(self.failed("rename", from))
    }

    fn sync_folder(&self, path: &str) -> Result<(), StoreError> {
        sync_folder(&self.at(path)).map_err(self.failed("flush the folder", path))
    }

    fn remove(&self, path: &str) -> Result<(), StoreError> {
        let at = self.at(path);
        let removed = if at.is_dir() { fs::remove_dir_all(&at) } else { fs::remove_file(&at) };
        match removed {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed.map_err(self.failed("remove", path)),
        }
    }
}

/// A file held open.
struct RealFile {
    file: File,
    path: PathBuf,
}

impl RealFile {
    fn failed(&self, operation: &'static str, e: &io::Error) -> StoreError {
        StoreError { operation, place: self.path.display().to_string(), cause: e.to_string() }
    }

    /// Reads without the file's own position, which readers at the same time would share.
    #[cfg(unix)]
    fn read_some(&self, offset: u64, bytes: &mut [u8]) -> io::Result<usize> {
        std::os::unix::fs::FileExt::read_at(&self.file, bytes, offset)
    }

    #[cfg(windows)]
    fn read_some(&self, offset: u64, bytes: &mut [u8]) -> io::Result<usize> {
        std::os::windows::fs::FileExt::seek_read(&self.file, bytes, offset)
    }
}

impl OpenFile for RealFile {
    fn size(&self) -> Result<u64, StoreError> {
        Ok(self.file.metadata().map_err(|e| self.failed("size", &e))?.len())
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, StoreError> {
        let (mut bytes, mut filled) = (vec![0; length], 0);
        while filled < length {
            match self.read_some(offset + filled as u64, &mut bytes[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.failed("read", &e)),
            }
        }
        bytes.truncate(filled);
        Ok(bytes)
    }
}

/// Flushes at the same time.
const AT_ONCE: usize = 8;

/// Does something for each of `all`, several at the same time.
fn at_once<T: Sync>(all: &[T], act: impl Fn(&T) -> Result<(), StoreError> + Sync) -> Result<(), StoreError> {
    if let [one] = all {
        return act(one);
    }
    let act = &act;
    std::thread::scope(|scope| {
        let share = all.len().div_ceil(AT_ONCE).max(1);
        let threads: Vec<_> =
            all.chunks(share).map(|some| scope.spawn(move || some.iter().try_for_each(act))).collect();
        let mut ended = threads.into_iter().map(|thread| thread.join());
        let panicked = || StoreError { operation: "flush", place: "files".into(), cause: "a thread panicked".into() };
        ended.try_for_each(|end| end.unwrap_or_else(|_| Err(panicked())))
    })
}
