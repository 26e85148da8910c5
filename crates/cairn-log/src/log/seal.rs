//! The seal on the store's own files: their digests, written once the store is closed.
//!
//! Tiles and packs follow from leaves and signatures, and whoever reads them can check every
//! byte. The store's files are sled's: a byte that changed in a part of them that nothing points to shows nowhere.
//! So a clean stop writes down what they are, an auditor compares, and a start breaks the
//! seal before anything is written. Where there is none, the last stop was not a clean one.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use super::layout;
use crate::{
    format::{
        digest::Digest,
        manifest::{Manifest, ManifestFile, VERSION},
    },
    log::store::{KnownFile, StoreError, await_closed},
};
use cairn_durable::{Files, RealDisk, sync_folder};

/// Seals the store's folder when dropped, if armed.
pub(super) struct Seal {
    root: PathBuf,
    /// Files whose digests are known since they were written; none while it is not armed.
    known: Option<Vec<KnownFile>>,
}

impl Seal {
    /// Removes the seal, durably: from now on the files may change.
    pub(super) fn break_open(root: &Path) -> Result<Self, StoreError> {
        let path = root.join(layout::SEAL);
        if path.exists() {
            cairn_durable::remove(&path)?;
            sync_folder(root)?;
        }
        Ok(Self { root: root.to_path_buf(), known: None })
    }

    /// To be written when dropped: the store is known to be good, and these files of it as they were written.
    pub(super) fn arm(&mut self, known: Vec<KnownFile>) {
        self.known = Some(known);
    }

    fn write(&self, known: &[KnownFile]) -> io::Result<()> {
        await_closed(&self.root.join(layout::WORKING).join("db"))?;
        let mut files = Vec::new();
        list(&self.root, layout::WORKING, known, &mut files)?;
        // One that is gone stays vouched for, so that it is missed.
        for KnownFile { path, size, sha256 } in known {
            if files.iter().all(|file| file.path != *path) {
                files.push(ManifestFile { path: path.clone(), size: *size, sha256: *sha256 });
            }
        }
        files.sort_by(|a, b| a.path.cmp(&b.path));
        let json = serde_json::to_vec(&Manifest { format_version: VERSION, files })?;
        let disk = Files::new(Box::new(RealDisk::new(&self.root)));
        disk.replace(&[(layout::SEAL.to_owned(), json)]).map_err(io::Error::other)
    }
}

impl Drop for Seal {
    fn drop(&mut self) {
        if let Some(known) = self.known.take() {
            // Without a seal an auditor says that it cannot be told, which is the truth.
            let _ = self.write(&known);
        }
    }
}

fn list(root: &Path, folder: &str, known: &[KnownFile], files: &mut Vec<ManifestFile>) -> io::Result<()> {
    for entry in fs::read_dir(root.join(folder))? {
        let entry = entry?;
        let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
        if entry.file_type()?.is_dir() {
            list(root, &path, known, files)?;
            continue;
        }
        // As it was written, not as it is now: it may have changed since, and there may be gigabytes of it.
        let (sha256, size) = match known.iter().find(|known| known.path == path) {
            Some(known) => (known.sha256, known.size),
            None => Digest::of_all(&mut File::open(root.join(&path))?)?,
        };
        files.push(ManifestFile { path, size, sha256 });
    }
    Ok(())
}
