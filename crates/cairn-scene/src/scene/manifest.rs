//! A folder's manifest: which files it has, each with its size and SHA-256, so that a
//! changed byte in any of them can be told, also in those that no table or record names.
//!
//! `manifest.json`: `{"format_version":1,"files":[{"path":..,"size":..,"sha256":..},..]}` without blanks, ascending
//! by path. It is written last, into folders that are complete.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use cairn_durable::write_synced;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::error::CaptureError;

/// The manifest's name in its folder.
pub const MANIFEST: &str = "manifest.json";

#[derive(Serialize)]
struct Manifest {
    format_version: u32,
    files: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    path: String,
    size: u64,
    sha256: String,
}

/// Writes the manifest of everything that lies in `folder`, and flushes it; its SHA-256.
///
/// The folder must not change meanwhile; whoever changes it later removes the manifest first.
///
/// # Errors
/// The file system's.
pub fn write_manifest(folder: &Path) -> Result<[u8; 32], CaptureError> {
    let mut files = Vec::new();
    below(folder, "", &mut files)?;
    files.retain(|row: &Row| row.path != MANIFEST);
    files.sort_by(|a, b| a.path.cmp(&b.path));
    let path = folder.join(MANIFEST);
    let json = serde_json::to_vec(&Manifest { format_version: 1, files });
    let json = json.map_err(|e| CaptureError::io("write", &path)(e.into()))?;
    write_synced(&path, &json)?;
    Ok(Sha256::digest(&json).into())
}

fn below(folder: &Path, prefix: &str, files: &mut Vec<Row>) -> Result<(), CaptureError> {
    for entry in fs::read_dir(folder).map_err(CaptureError::io("list", folder))? {
        let entry = entry.map_err(CaptureError::io("list", folder))?;
        let (path, name) = (entry.path(), format!("{prefix}{}", entry.file_name().to_string_lossy()));
        if entry.file_type().map_err(CaptureError::io("read", &path))?.is_dir() {
            below(&path, &format!("{name}/"), files)?;
        } else {
            let (size, sha256) = digest(&path).map_err(CaptureError::io("read", &path))?;
            files.push(Row { path: name, size, sha256 });
        }
    }
    Ok(())
}

/// Size and SHA-256 of a file, read in pieces.
fn digest(path: &Path) -> io::Result<(u64, String)> {
    let (mut file, mut hasher, mut size) = (File::open(path)?, Sha256::new(), 0);
    let mut piece = vec![0; 1 << 16];
    loop {
        let count = file.read(&mut piece)?;
        if count == 0 {
            return Ok((size, hex::encode(hasher.finalize())));
        }
        hasher.update(&piece[..count]);
        size += count as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_is_listed_once_and_the_manifest_not() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("b")).unwrap();
        fs::write(dir.path().join("b/two"), b"two").unwrap();
        fs::write(dir.path().join("a"), b"").unwrap();
        write_manifest(dir.path()).unwrap();
        let digest = write_manifest(dir.path()).unwrap();
        let json = fs::read(dir.path().join(MANIFEST)).unwrap();
        let two = "3fc4ccfe745870e2c0d99f71f30ff0656c8dedd41cc1d7d3d376b0dbe685e2f3";
        let empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
        let wanted = format!(
            r#"{{"format_version":1,"files":[{{"path":"a","size":0,"sha256":"{empty}"}},{{"path":"b/two","size":3,"sha256":"{two}"}}]}}"#
        );
        assert_eq!(String::from_utf8(json.clone()).unwrap(), wanted);
        assert_eq!(digest, <[u8; 32]>::from(Sha256::digest(&json)));
    }
}
