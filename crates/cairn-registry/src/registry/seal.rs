//! The seal on the store's own files: their digests, written once the store is closed.
//!
//! Tiles and packs follow from leaves and signatures, and whoever reads them can check every
//! byte. The store's files are sled's: a byte that changed in a part of them that nothing points to shows nowhere.
//! So a clean stop writes down what they are, an auditor compares, and a start breaks the
//! seal before anything is written. Where there is none, the last stop was not a clean one.

use std::{
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::layout;
use crate::{
    digest::Digest,
    files::{Files, RealDisk},
    store::{StoreError, sync_folder},
};

/// The seal's format version.
pub const VERSION: u32 = 1;

/// `working.seal`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sealed {
    format_version: u32,
    files: Vec<SealedFile>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SealedFile {
    path: String,
    size: u64,
    sha256: Digest,
}

/// Seals the store's folder when dropped.
pub(super) struct Seal {
    root: PathBuf,
}

impl Seal {
    /// Removes the seal, durably: from now on the files may change.
    pub(super) fn break_open(root: &Path) -> Result<Self, StoreError> {
        let path = root.join(layout::SEAL);
        let removed = match fs::remove_file(&path) {
            Ok(()) => sync_folder(root),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(e) => Err(e),
        };
        removed.map_err(|e| StoreError {
            operation: "remove",
            place: path.display().to_string(),
            cause: e.to_string(),
        })?;
        Ok(Self { root: root.to_path_buf() })
    }

    fn write(&self) -> io::Result<()> {
        let mut files = Vec::new();
        list(&self.root, layout::WORKING, &mut files)?;
        files.sort_by(|a, b| a.path.cmp(&b.path));
        let json = serde_json::to_vec(&Sealed { format_version: VERSION, files })?;
        let disk = Files::new(Box::new(RealDisk::new(&self.root)));
        disk.replace(&[(layout::SEAL.to_owned(), json)]).map_err(io::Error::other)
    }
}

impl Drop for Seal {
    fn drop(&mut self) {
        // Without a seal an auditor says that it cannot be told, which is the truth.
        let _ = self.write();
    }
}

fn digest(file: &mut File) -> io::Result<(u64, Digest)> {
    let (mut hasher, mut size, mut piece) = (Sha256::new(), 0, vec![0; 1 << 16]);
    loop {
        let count = file.read(&mut piece)?;
        if count == 0 {
            return Ok((size, Digest::from_bytes(hasher.finalize().into())));
        }
        hasher.update(&piece[..count]);
        size += count as u64;
    }
}

fn list(root: &Path, folder: &str, files: &mut Vec<SealedFile>) -> io::Result<()> {
    for entry in fs::read_dir(root.join(folder))? {
        let entry = entry?;
        let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
        if entry.file_type()?.is_dir() {
            list(root, &path, files)?;
        } else {
            let (size, sha256) = digest(&mut File::open(root.join(&path))?)?;
            files.push(SealedFile { path, size, sha256 });
        }
    }
    Ok(())
}
