//! Versioned JSON files that are there whole or not at all.

use std::path::Path;

use cairn_durable::{make_folders, read_limited_if_there, write_atomic};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::auth::error::FileError;

/// The version that this release reads and writes.
pub(crate) const FORMAT_VERSION: u64 = 1;
/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;

/// Reads `path`; `None` where there is no such file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, FileError> {
    let stored = |problem: String| FileError::Stored { path: path.to_path_buf(), problem };
    let Some(bytes) = read_limited_if_there(path, MAX_BYTES)? else { return Ok(None) };
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
    path.parent().map_or(Ok(()), make_folders)?;
    Ok(write_atomic(path, &json)?)
}
