//! The operating system's files, below one folder.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use crate::disk::{Disk, OpenFile};
use crate::error::DurableError;
use crate::paths;

/// Files below a folder.
#[derive(Debug, Clone)]
pub struct RealDisk {
    root: PathBuf,
    /// Whether every change is refused.
    only_reading: bool,
}

impl RealDisk {
    /// Files below `root`, which is there.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_path_buf(), only_reading: false }
    }

    /// Files below `root`, none of which changes: what would change one is refused.
    pub fn only_reading(root: &Path) -> Self {
        Self { root: root.to_path_buf(), only_reading: true }
    }

    fn may_change(&self, operation: &'static str, path: &str) -> Result<(), DurableError> {
        let cause = || io::Error::new(io::ErrorKind::PermissionDenied, "it is opened for reading only");
        if self.only_reading { Err(self.failed(operation, path)(cause())) } else { Ok(()) }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    fn failed(&self, operation: &'static str, path: &str) -> impl Fn(io::Error) -> DurableError + use<> {
        DurableError::io(operation, &self.at(path))
    }

    fn open_for_writing(&self, path: &Path) -> io::Result<File> {
        let open = || OpenOptions::new().write(true).create(true).truncate(false).open(path);
        match open() {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                path.parent().map_or(Ok(()), paths::make_folders)?;
                open()
            }
            opened => opened,
        }
    }
}

impl Disk for RealDisk {
    fn read(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, DurableError> {
        paths::read_limited_if_there(&self.at(path), limit)
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, DurableError> {
        let entries = match fs::read_dir(self.at(folder)) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(self.failed("list", folder))?,
        };
        let names = entries.map(|entry| entry.map(|entry| entry.file_name().to_string_lossy().into_owned()));
        names.collect::<Result<_, _>>().map_err(self.failed("list", folder))
    }

    fn open(&self, path: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError> {
        match File::open(self.at(path)) {
            Ok(file) => Ok(Some(Box::new(RealFile { file, path: self.at(path) }))),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(self.failed("open", path)(e)),
        }
    }

    fn write(&self, path: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        self.may_change("write", path)?;
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

    fn sync(&self, path: &str) -> Result<(), DurableError> {
        if self.only_reading {
            return Ok(());
        }
        let opened = OpenOptions::new().write(true).open(self.at(path));
        // `fdatasync`: bytes and whatever it takes to find them again, the length included, but no times.
        opened.and_then(|file| file.sync_data()).map_err(self.failed("flush", path))
    }

    fn sync_files(&self, paths: &[String]) -> Result<(), DurableError> {
        at_once(paths, |path| self.sync(path))
    }

    fn sync_folders(&self, paths: &[&str]) -> Result<(), DurableError> {
        at_once(paths, |path| self.sync_folder(path))
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), DurableError> {
        self.may_change("rename", from)?;
        fs::rename(self.at(from), self.at(to)).map_err(self.failed("rename", from))
    }

    fn sync_folder(&self, path: &str) -> Result<(), DurableError> {
        paths::sync_folder(&self.at(path))
    }

    fn remove(&self, path: &str) -> Result<(), DurableError> {
        if self.at(path).exists() {
            self.may_change("remove", path)?;
        }
        paths::remove(&self.at(path))
    }
}

/// A file held open.
struct RealFile {
    file: File,
    path: PathBuf,
}

impl RealFile {
    fn failed(&self, operation: &'static str, e: io::Error) -> DurableError {
        DurableError::io(operation, &self.path)(e)
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
    fn size(&self) -> Result<u64, DurableError> {
        Ok(self.file.metadata().map_err(|e| self.failed("size", e))?.len())
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, DurableError> {
        let (mut bytes, mut filled) = (vec![0; length], 0);
        while filled < length {
            match self.read_some(offset + filled as u64, &mut bytes[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.failed("read", e)),
            }
        }
        bytes.truncate(filled);
        Ok(bytes)
    }
}

/// Flushes at the same time.
const AT_ONCE: usize = 8;

/// Does something for each of `all`, several at the same time.
fn at_once<T: Sync>(all: &[T], act: impl Fn(&T) -> Result<(), DurableError> + Sync) -> Result<(), DurableError> {
    if let [one] = all {
        return act(one);
    }
    let act = &act;
    std::thread::scope(|scope| {
        let share = all.len().div_ceil(AT_ONCE).max(1);
        let threads: Vec<_> =
            all.chunks(share).map(|some| scope.spawn(move || some.iter().try_for_each(act))).collect();
        let mut ended = threads.into_iter().map(|thread| thread.join());
        let panicked = || DurableError::io("flush", Path::new("files"))(io::Error::other("a thread panicked"));
        ended.try_for_each(|end| end.unwrap_or_else(|_| Err(panicked())))
    })
}
