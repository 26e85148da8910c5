//! Manifests: which files a folder has, each with its size and SHA-256. The seals of the
//! registry's working state and of the data folder's are some, and so are those of scenes, models and jobs.
//!
//! A manifest tells bit rot and half-restored copies; who can write the folder can write
//! the manifest, so it is no defence against them. Signatures are.

use serde::{Deserialize, Serialize};

use super::digest::Digest;

/// The version of manifests that this release reads and writes.
pub const VERSION: u32 = 1;

/// A folder's files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`VERSION`].
    pub format_version: u32,
    /// All files but the manifest itself, ascending by path.
    pub files: Vec<ManifestFile>,
}

/// One file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestFile {
    /// From the folder, with `/`.
    pub path: String,
    /// Bytes.
    pub size: u64,
    /// SHA-256 (hex).
    pub sha256: Digest,
}

impl Manifest {
    /// Reads a manifest; only the one way of writing it is taken (compact or indented as serde_json does), so that no
    /// byte can change unnoticed.
    ///
    /// # Errors
    /// What is wrong.
    pub fn parse(json: &[u8]) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Stated {
            format_version: u64,
        }
        let stated: Stated = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        if stated.format_version != u64::from(VERSION) {
            return Err(format!("format version {}, this release reads {VERSION}", stated.format_version));
        }
        let manifest: Self = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        let compact = serde_json::to_vec(&manifest).map_err(|e| e.to_string())?;
        let indented = serde_json::to_vec_pretty(&manifest).map_err(|e| e.to_string())?;
        if json != compact && json != indented {
            return Err("not as it is written: blanks or escapes differ".to_owned());
        }
        if manifest.files.windows(2).any(|pair| pair[0].path >= pair[1].path) {
            return Err("files out of order, or one twice".to_owned());
        }
        Ok(manifest)
    }
}
