//! The data folder: where everything lies, one owner at a time, and files that
//! are there whole or not at all.
//!
//! ```text
//! DIR/lock                      the owning process's id, locked while it lives
//! DIR/format.json               format version of the folder
//! DIR/registry.key              the registry's signing key, mode 600
//! DIR/scenes/NAME/              a capture (cairn-scene's format)
//! DIR/models/NAME/current.json  which of the models below is the newest
//! DIR/models/NAME/JOB/          base.field, marked.field, detector, model.json, ...
//! DIR/jobs/JOB/                 job.json, signals, checkpoints
//! DIR/registry/                 the log of owner records (cairn-log's format)
//! DIR/access/                   accounts.json, usage.json (cairn-service's formats)
//! DIR/owners/NAME.json          who imported the scene, where somebody with an account did
//! DIR/exclusions/NAME.json      which of the scene's views are excluded, and why
//! (each scene, model and ended job has a manifest.json: size and SHA-256 of all its files)
//! DIR/state.seal                digests of access/, owners/, exclusions/ and registry.key, while nobody has it open
//! DIR/staging/                  imports under way; emptied at every start
//! DIR/socket/cairn              where the owning process answers other commands on the folder; mode 700
//! ```

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use cairn_durable::{LockFile, read_limited, sync_folder, write_atomic};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::seal;

/// The lock file of the folder's one owner.
pub(crate) const LOCK: &str = "lock";
/// The file that every data folder has.
pub(crate) const LAYOUT: &str = "format.json";
/// Version of the folder's layout.
const FORMAT_VERSION: u32 = 1;
/// Largest JSON file that is read, bytes.
const MAX_JSON_BYTES: u64 = 256 << 20;

/// An opened data folder. Its lock goes when this is dropped, or the process dies.
#[derive(Debug)]
pub struct DataFolder {
    root: PathBuf,
    /// Whether what it holds is known to be good, so that a seal may say what it is.
    sound: AtomicBool,
    _lock: LockFile,
}

#[derive(Serialize, Deserialize)]
struct Layout {
    format_version: u32,
}

impl DataFolder {
    /// Opens the folder, made where absent, as its only owner.
    ///
    /// # Errors
    /// [`EngineError::Locked`] naming the owner's process, [`EngineError::Stored`] for a layout of
    /// another version, and the file system's.
    pub fn open(root: &Path) -> Result<Self, EngineError> {
        fs::create_dir_all(root).map_err(EngineError::io("create", root))?;
        let lock = LockFile::take(&root.join(LOCK))?;
        let format = root.join(LAYOUT);
        if format.exists() {
            let _: Layout = read_json(&format, FORMAT_VERSION)?;
        } else {
            write_json(&format, &Layout { format_version: FORMAT_VERSION })?;
        }
        seal::break_open(root)?;
        let folder = Self { root: root.to_path_buf(), sound: AtomicBool::new(false), _lock: lock };
        let staging = folder.staging();
        if staging.exists() {
            fs::remove_dir_all(&staging).map_err(EngineError::io("empty", &staging))?;
        }
        for path in [folder.scenes(), folder.models(), folder.jobs(), staging] {
            fs::create_dir_all(&path).map_err(EngineError::io("create", &path))?;
        }
        sync_folder(root)?;
        Ok(folder)
    }

    /// Everything in it was read and found good: when it is closed its state is sealed (`state.seal`).
    pub fn seal_at_end(&self) {
        self.sound.store(true, Ordering::Relaxed);
    }

    /// Captures.
    pub fn scenes(&self) -> PathBuf {
        self.root.join("scenes")
    }

    /// Trained models.
    pub fn models(&self) -> PathBuf {
        self.root.join("models")
    }

    /// Trainings, each in its folder.
    pub fn jobs(&self) -> PathBuf {
        self.root.join("jobs")
    }

    /// The log of owner records.
    pub fn registry(&self) -> PathBuf {
        self.root.join("registry")
    }

    /// Whether no log of owner records was ever begun here.
    ///
    /// # Errors
    /// The file system's.
    pub fn registry_is_empty(&self) -> Result<bool, EngineError> {
        let path = self.registry();
        match fs::read_dir(&path) {
            Ok(mut entries) => Ok(entries.next().is_none()),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(true),
            Err(e) => Err(EngineError::io("list", &path)(e)),
        }
    }

    /// The registry's signing key.
    pub fn registry_key(&self) -> PathBuf {
        self.root.join("registry.key")
    }

    /// The accounts.
    pub fn accounts(&self) -> PathBuf {
        self.root.join("access/accounts.json")
    }

    /// What the accounts use.
    pub fn usage(&self) -> PathBuf {
        self.root.join("access/usage.json")
    }

    /// Who imported which scene.
    pub fn owners(&self) -> PathBuf {
        self.root.join("owners")
    }

    /// Views that are excluded from trainings and answers.
    pub fn exclusions(&self) -> PathBuf {
        self.root.join("exclusions")
    }

    /// Imports under way.
    pub fn staging(&self) -> PathBuf {
        self.root.join("staging")
    }
}

impl Drop for DataFolder {
    fn drop(&mut self) {
        // The lock is still held: fields go after this.
        if self.sound.load(Ordering::Relaxed)
            && let Err(error) = seal::write(&self.root)
        {
            tracing::warn!(%error, "the data folder's state is not sealed");
        }
    }
}

/// Checks that no process has the data folder `root`, which stays as it is.
///
/// # Errors
/// [`EngineError::Locked`] names the owner's process.
pub fn must_be_free(root: &Path) -> Result<(), EngineError> {
    Ok(LockFile::must_be_free(&root.join(LOCK))?)
}

/// Writes a versioned JSON file atomically.
///
/// # Errors
/// The file system's, with the path.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), EngineError> {
    let json = serde_json::to_vec_pretty(value)
        .map_err(|e| EngineError::Internal(format!("{} cannot be written as JSON: {e}", path.display())))?;
    Ok(write_atomic(path, &json)?)
}

/// Reads a JSON file whose `format_version` is `version`, the one that this release writes.
///
/// # Errors
/// [`EngineError::Stored`] for damage and for another version, by number.
pub fn read_json<T: DeserializeOwned>(path: &Path, version: u32) -> Result<T, EngineError> {
    let stored = |problem: String| EngineError::Stored { path: path.to_path_buf(), problem };
    let bytes = read_limited(path, MAX_JSON_BYTES)?;
    let value: serde_json::Value = serde_json::from_slice(&bytes).map_err(|e| stored(format!("no JSON ({e})")))?;
    match value.get("format_version").and_then(serde_json::Value::as_u64) {
        Some(found) if found == u64::from(version) => {}
        Some(found) => return Err(stored(format!("format version {found}, this release reads {version}"))),
        None => return Err(stored("it has no format version".into())),
    }
    serde_json::from_value(value).map_err(|e| stored(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_owner_is_refused_and_told_who_has_it() {
        let dir = tempfile::tempdir().unwrap();
        let first = DataFolder::open(dir.path()).unwrap();
        let error = DataFolder::open(dir.path()).unwrap_err().to_string();
        assert!(error.contains(&std::process::id().to_string()), "{error}");
        drop(first);
        DataFolder::open(dir.path()).unwrap();
    }

    #[test]
    fn another_version_is_refused_by_number() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("format.json"), r#"{"format_version": 7}"#).unwrap();
        let error = DataFolder::open(dir.path()).unwrap_err().to_string();
        assert!(error.contains("format version 7"), "{error}");
    }

    #[test]
    fn staging_is_emptied_at_the_start() {
        let dir = tempfile::tempdir().unwrap();
        let left = dir.path().join("staging/half-an-import");
        std::fs::create_dir_all(&left).unwrap();
        let folder = DataFolder::open(dir.path()).unwrap();
        assert!(!left.exists() && folder.staging().is_dir());
    }

    #[test]
    fn a_folder_is_said_to_be_free_without_touching_it() {
        let dir = tempfile::tempdir().unwrap();
        must_be_free(dir.path()).unwrap();
        std::fs::write(dir.path().join("lock"), "999").unwrap();
        must_be_free(dir.path()).unwrap();
        assert_eq!(std::fs::read(dir.path().join("lock")).unwrap(), b"999");
        let _held = DataFolder::open(dir.path()).unwrap();
        let refused = must_be_free(dir.path()).unwrap_err().to_string();
        assert!(refused.contains(&std::process::id().to_string()), "{refused}");
    }
}
