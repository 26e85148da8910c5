//! Files that are held to their SHA-256.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use cairn_durable::read_limited;
use cairn_log::Digest;

use crate::error::EngineError;

/// The file at `path`, at most `limit` bytes, whose SHA-256 is `expected`.
///
/// # Errors
/// [`EngineError::Stored`] for another.
pub fn read_checked(path: &Path, expected: &Digest, limit: u64) -> Result<Vec<u8>, EngineError> {
    let bytes = read_limited(path, limit)?;
    held_to(path, &Digest::of(&bytes), expected)?;
    Ok(bytes)
}

fn held_to(path: &Path, got: &Digest, expected: &Digest) -> Result<(), EngineError> {
    if got == expected {
        return Ok(());
    }
    let problem = format!("its SHA-256 is {got}, model.json says {expected}: it was altered");
    Err(EngineError::Stored { path: path.to_path_buf(), problem })
}

/// As [`read_checked`], of a file that is read piece by piece and left open at its start: fields take gigabytes.
///
/// # Errors
/// [`EngineError::Stored`] for another.
pub(crate) fn open_checked(path: &Path, expected: &Digest, limit: u64) -> Result<File, EngineError> {
    let mut file = File::open(path).map_err(EngineError::io("open", path))?;
    let (got, size) = Digest::of_all(&mut file.by_ref().take(limit + 1)).map_err(EngineError::io("read", path))?;
    if size > limit {
        return Err(EngineError::too_large(path.to_path_buf(), limit));
    }
    held_to(path, &got, expected)?;
    file.rewind().map_err(EngineError::io("read", path))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_was_altered_or_is_too_large_is_not_opened() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("base.field");
        let mut bytes = vec![7; 100_000];
        std::fs::write(&path, &bytes).unwrap();
        let digest = Digest::of(&bytes);
        let open = |limit| open_checked(&path, &digest, limit).map_err(|e| e.to_string());
        let mut read = Vec::new();
        open(100_000).unwrap().read_to_end(&mut read).unwrap();
        assert!(read == bytes, "from its start");
        assert!(open(99_999).unwrap_err().contains("more than 99999 bytes"));
        bytes[99_999] ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        let text = open(100_000).unwrap_err();
        assert!(text.contains("altered") && text.contains("base.field"), "{text}");
        std::fs::remove_file(&path).unwrap();
        assert!(open(100_000).unwrap_err().contains("base.field"));
    }
}
