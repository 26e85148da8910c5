//! Files of the benchmarks, named when they cannot be read or written.

use std::path::Path;

use anyhow::Context as _;
use cairn_scene::{Limits, Picture, decode_picture};

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
pub fn with_ending(folder: &Path, endings: &[&str]) -> anyhow::Result<Vec<std::path::PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    files.retain(|path| path.extension().is_some_and(|e| endings.iter().any(|wanted| e.eq_ignore_ascii_case(wanted))));
    files.sort();
    Ok(files)
}
