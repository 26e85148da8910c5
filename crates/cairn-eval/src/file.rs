//! Files of the benchmarks, named when they cannot be read or written.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_scene::{Limits, Picture, decode_picture};
use serde::Serialize;
use sha2::{Digest as _, Sha256};

/// Reads a file.
///
/// # Errors
/// For a file that cannot be read.
pub fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Opens a file to be read piece by piece.
///
/// # Errors
/// For a file that cannot be opened.
pub fn open(path: &Path) -> anyhow::Result<std::fs::File> {
    std::fs::File::open(path).with_context(|| format!("cannot open {}", path.display()))
}

/// Writes a file.
///
/// # Errors
/// For a file that cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Makes a folder, with those above it, where it is not there yet.
///
/// # Errors
/// For a folder that cannot be made.
pub fn make_folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make the folder {}", path.display()))
}

/// A folder in `folder` for what is kept of this very `what`, made where it is not there yet: its name is the beginning of
/// the SHA-256 of its JSON.
///
/// # Errors
/// For a folder that cannot be made.
pub fn folder_of(folder: &Path, what: &impl Serialize) -> anyhow::Result<PathBuf> {
    let digest = Sha256::digest(serde_json::to_vec(what)?);
    let folder = folder.join(digest[..4].iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    make_folder(&folder)?;
    Ok(folder)
}

/// Decodes a picture file.
///
/// # Errors
/// For a file that does not read or decode.
pub fn decoded(path: &Path) -> anyhow::Result<Picture> {
    decode_picture(&read(path)?, &Limits::default(), None)
        .with_context(|| format!("{} does not decode", path.display()))
}

/// Files of a folder with one of some endings, in order of file name.
///
/// # Errors
/// For a folder that cannot be read.
pub fn with_ending(folder: &Path, endings: &[&str]) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    files.retain(|path| path.extension().is_some_and(|e| endings.iter().any(|wanted| e.eq_ignore_ascii_case(wanted))));
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_thing_has_another_folder_that_is_there() {
        let place = tempfile::tempdir().unwrap();
        let of = |what: &[u64]| folder_of(place.path(), &what).unwrap();
        let folders = [of(&[1]), of(&[1]), of(&[1, 2])];
        assert!(folders[0] == folders[1] && folders[0] != folders[2] && folders.iter().all(|folder| folder.is_dir()));
    }
}
