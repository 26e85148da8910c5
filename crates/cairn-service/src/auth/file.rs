//! Versioned JSON files that are there whole or not at all.

use std::fs::{self, File};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::auth::error::FileError;

/// The version that this release reads and writes.
pub(crate) const FORMAT_VERSION: u64 = 1;
/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;

fn io(operation: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> FileError {
    let path = path.to_path_buf();
    move |source| FileError::Io { operation, path, source }
}

/// Reads `path`; `None` where there is no such file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, FileError> {
    let stored = |problem: String| FileError::Stored { path: path.to_path_buf(), problem };
    let file = match File::open(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        opened => opened.map_err(io("open", path))?,
    };
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io("read", path))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(stored(format!("more than {MAX_BYTES} bytes, the most that such a file may have")));
    }
    let value: serde_json::Value = serde_json::from_slice(&bytes).map_err(|e| stored(format!("no JSON ({e})")))?;
    match value.get("format_version").and_then(serde_json::Value::as_u64) {
        Some(FORMAT_VERSION) => {}
        Some(version) => {
            return Err(stored(format!("format version {version}, this release reads {FORMAT_VERSION}")));
        }
        None => return Err(stored("it has no format version".into())),
    }
    serde_json::from_value(value).map(Some).map_err(|e| stored(e.to_string()))
}

/// Replaces `path`, durably: after a crash there is the old file or the new one.
pub(crate) fn write<T: Serialize>(path: &Path, value: &T) -> Result<(), FileError> {
    let json = serde_json::to_vec_pretty(value)
        .map_err(|e| FileError::Stored { path: path.to_path_buf(), problem: format!("it cannot be written ({e})") })?;
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(io("create", folder))?;
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    let temporary = PathBuf::from(temporary);
    let mut file = File::create(&temporary).map_err(io("create", &temporary))?;
    file.write_all(&json).and_then(|()| file.sync_all()).map_err(io("write", &temporary))?;
    fs::rename(&temporary, path).map_err(io("replace", path))?;
    if cfg!(unix) {
        File::open(folder).and_then(|f| f.sync_all()).map_err(io("flush", folder))?;
    }
    Ok(())
}
