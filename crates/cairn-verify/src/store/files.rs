//! Where a registry's files lie, and reading them without believing their size.

use std::{
    io,
    path::{Path, PathBuf},
};

use cairn_log::format::{
    leaf::LEAF_LEN,
    note::MAX_NOTE_BYTES,
    packs::MAX_PACK,
    tile::{TILE_WIDTH, TileKind, TilePath},
};

use crate::bounded::read;

/// Entries a chunk: a full tile, a full bundle, a file of envelopes.
pub(super) const CHUNK: u64 = TILE_WIDTH as u64;
/// Bytes of an entry in its bundle.
pub(super) const ENTRY: usize = 2 + LEAF_LEN;

/// A folder that cannot be audited at all.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No registry in the folder.
    #[error(
        "{path}: no registry here (expected the folder `registry` with `public` in it); give a daemon's data folder"
    )]
    NoRegistry {
        /// The folder.
        path: String,
    },
    /// A folder or file that cannot be read.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// Its path.
        path: String,
        /// The operating system's answer.
        source: io::Error,
    },
}

/// The registry's folder.
#[derive(Debug, Clone)]
pub(super) struct Files {
    registry: PathBuf,
}

impl Files {
    pub(super) fn open(dir: &Path) -> Result<Self, StoreError> {
        let registry = dir.join("registry");
        if !registry.join("public").is_dir() {
            return Err(StoreError::NoRegistry { path: dir.display().to_string() });
        }
        Ok(Self { registry })
    }

    pub(super) fn registry(&self) -> &Path {
        &self.registry
    }

    pub(super) fn public(&self) -> PathBuf {
        self.registry.join("public")
    }

    /// The name that findings have for a file of `public/`.
    pub(super) fn name_public(&self, path: &str) -> String {
        format!("registry/public/{path}")
    }

    pub(super) fn name_tile(&self, path: &TilePath) -> String {
        self.name_public(&path.to_string())
    }

    pub(super) fn name_envelopes(&self, chunk: u64) -> String {
        format!("registry/{}", envelopes(chunk))
    }

    pub(super) fn checkpoint(&self) -> Result<Option<String>, String> {
        let bytes = read(&self.public().join("checkpoint"), MAX_NOTE_BYTES)?;
        bytes.map(|bytes| String::from_utf8(bytes).map_err(|e| format!("not UTF-8: {e}"))).transpose()
    }

    pub(super) fn tile(&self, path: &TilePath) -> Result<Option<Vec<u8>>, String> {
        let each = match path.kind {
            TileKind::Hashes(_) => 32,
            TileKind::Entries => ENTRY,
        };
        read(&self.public().join(path.to_string()), usize::from(path.width) * each)
    }

    pub(super) fn envelopes(&self, chunk: u64) -> Result<Option<Vec<u8>>, String> {
        read(&self.registry.join(envelopes(chunk)), MAX_PACK as usize)
    }

    /// Widths of the partial tiles of this kind and index, rising. Names that are no width are left to the walk over
    /// all files.
    pub(super) fn partial_widths(&self, kind: TileKind, index: u64) -> Vec<u16> {
        let one = TilePath { kind, index, width: 1 }.to_string();
        let folder = self.public().join(one.strip_suffix("/1").unwrap_or(&one));
        let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let width = |name: String| name.parse::<u16>().ok().filter(|w| (1..TILE_WIDTH).contains(w));
        let mut widths: Vec<u16> = names.filter_map(|e| e.file_name().into_string().ok().and_then(width)).collect();
        widths.sort_unstable();
        widths
    }
}

/// `envelopes/x001/234` for chunk 1234: the groups of a tile's path.
pub(super) fn envelopes(chunk: u64) -> String {
    let path = TilePath { kind: TileKind::Entries, index: chunk, width: TILE_WIDTH }.to_string();
    path.replacen("tile/entries", "envelopes", 1)
}

/// Every file below `folder`, as paths from it with `/`, folder by folder in order of names. Links are files: what they lead to is not
/// followed.
pub(super) fn walk(folder: &Path, found: &mut dyn FnMut(&str)) -> Result<(), StoreError> {
    fn below(folder: &Path, prefix: &str, depth: usize, found: &mut dyn FnMut(&str)) -> io::Result<()> {
        let mut entries = std::fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
        entries.sort_by_key(std::fs::DirEntry::file_name);
        for entry in entries {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            // No folder of ours lies deeper; what does is named and not looked into.
            if entry.file_type()?.is_dir() && depth < 16 {
                below(&entry.path(), &format!("{name}/"), depth + 1, found)?;
            } else {
                found(&name);
            }
        }
        Ok(())
    }
    if !folder.exists() {
        return Ok(());
    }
    below(folder, "", 0, found).map_err(|source| StoreError::Io { path: folder.display().to_string(), source })
}
