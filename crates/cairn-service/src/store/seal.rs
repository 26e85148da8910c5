//! `DIR/state.seal`: digests of the daemon's own state, written when it stops cleanly and taken away when it starts.
//!
//! Accounts, what they use, who imported what, and which views are excluded change while the daemon runs: a
//! digest of them could only lag behind. So, as for the registry's working state, there is one while nobody has the folder
//! open, and an auditor can tell rot from then on. Of the registry's key, a secret, there is its file's digest.

use std::path::Path;

use cairn_log::Digest;
use cairn_log::format::manifest::{Manifest, ManifestFile, VERSION};

use crate::error::EngineError;
use cairn_durable::{remove, sync_folder, write_atomic};

const SEAL: &str = "state.seal";
/// What is sealed: folders, of files only, and single files.
const COVERED: [&str; 4] = ["access", "exclusions", "owners", "registry.key"];

/// Takes the seal away, durably: from now on the files may change.
///
/// # Errors
/// The file system's.
pub fn break_open(root: &Path) -> Result<(), EngineError> {
    let path = root.join(SEAL);
    if !path.exists() {
        return Ok(());
    }
    remove(&path)?;
    Ok(sync_folder(root)?)
}

/// Writes down what the files are now.
///
/// # Errors
/// The file system's. Without a seal an auditor says that it cannot be told, which is the truth.
pub fn write(root: &Path) -> Result<(), EngineError> {
    let mut paths = Vec::new();
    for name in COVERED {
        let path = root.join(name);
        if path.is_dir() {
            let io = |e| EngineError::io("list", &path)(e);
            for entry in std::fs::read_dir(&path).map_err(io)? {
                paths.push(format!("{name}/{}", entry.map_err(io)?.file_name().to_string_lossy()));
            }
        } else if path.exists() {
            paths.push(name.to_owned());
        }
    }
    paths.sort();
    let mut files = Vec::with_capacity(paths.len());
    for path in paths {
        let place = root.join(&path);
        let read = |e| EngineError::io("read", &place)(e);
        let (sha256, size) = Digest::of_all(&mut std::fs::File::open(&place).map_err(read)?).map_err(read)?;
        files.push(ManifestFile { path, size, sha256 });
    }
    let manifest = Manifest { format_version: VERSION, files };
    // Strings and numbers only: there is nothing that could fail to serialise.
    Ok(write_atomic(&root.join(SEAL), &serde_json::to_vec_pretty(&manifest).unwrap_or_default())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::folder::DataFolder;

    fn audited(root: &Path) -> Vec<&'static str> {
        let (findings, _) = cairn_verify::audit_folders(root).unwrap();
        let of_state = findings.iter().map(|f| f.code.as_str()).filter(|code| code.starts_with("state."));
        of_state.collect()
    }

    #[test]
    fn a_clean_stop_seals_and_a_start_breaks_the_seal() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let folder = DataFolder::open(root).unwrap();
        for name in ["access", "exclusions", "owners"] {
            std::fs::create_dir(root.join(name)).unwrap();
        }
        for name in ["access/accounts.json", "owners/town.json", "owners/a.json", "exclusions/a.json", "registry.key"] {
            std::fs::write(root.join(name), name).unwrap();
        }
        // A start that came to nothing vouches for nothing.
        drop(folder);
        assert_eq!(audited(root), ["state.unsealed"]);
        let folder = DataFolder::open(root).unwrap();
        folder.seal_at_end();
        drop(folder);
        assert_eq!(audited(root), ["state.verified"]);
        let sealed = std::fs::read(root.join(SEAL)).unwrap();
        std::fs::write(root.join("owners/a.json"), "x").unwrap();
        assert_eq!(audited(root), ["state.mismatch"]);
        let folder = DataFolder::open(root).unwrap();
        assert_eq!(audited(root), ["state.unsealed"], "it may change from now on");
        folder.seal_at_end();
        drop(folder);
        assert_ne!(std::fs::read(root.join(SEAL)).unwrap(), sealed);
        assert_eq!(audited(root), ["state.verified"]);
    }
}
