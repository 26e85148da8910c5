//! Files that commands read and write, named where that fails.

use std::path::Path;

use anyhow::Context as _;

/// Reads a file.
///
/// # Errors
/// The file system's, with the file's name.
pub fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Writes a file.
///
/// # Errors
/// The file system's, with the file's name.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
