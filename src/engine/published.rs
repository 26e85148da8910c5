//! What the log published last, kept where the log's own folder does not reach, so that one that was restored from an older
//! backup is found out at its next start.
//!
//! It is kept twice. `DIR/registry.checkpoint`, in the data folder, speaks where the log alone was restored.
//! `DIR.checkpoint`, beside it, speaks where the whole data folder was: it does not go back with that, and needs no setting.
//! What was signed in the moment between a publication and a backup it does not know of; an anchor does
//! ([`super::anchor`]), which may lie on another disk as well.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use cairn_registry::{Checkpoint, CheckpointError, NoteError, Registry, RegistryError};

use super::error::EngineError;
use super::folder::{read_limited, write_atomic};

/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 16;

/// The files that hold it.
#[derive(Debug)]
pub struct LastPublished {
    inside: PathBuf,
    beside: Option<PathBuf>,
    /// Whether it was said that nothing can be written there.
    told: AtomicBool,
}

impl LastPublished {
    /// In this file alone.
    pub fn inside(file: PathBuf) -> Self {
        Self { inside: file, beside: None, told: AtomicBool::new(false) }
    }

    /// In this file of the data folder `data`, which is there, and in one beside that.
    pub fn of(file: PathBuf, data: &Path) -> Self {
        // Where a link leads, since that is what is restored.
        let beside = data.canonicalize().ok().filter(|data| data.file_name().is_some()).map(|data| {
            let mut name = data.into_os_string();
            name.push(".checkpoint");
            PathBuf::from(name)
        });
        Self { inside: file, beside, told: AtomicBool::new(false) }
    }

    /// Holds the log to them, where they are there.
    ///
    /// # Errors
    /// [`cairn_registry::RegistryError::Inconsistent`] for a log that does not go on from the one in the data folder,
    /// [`EngineError::RestoredOlder`] from the one beside it; [`EngineError::Stored`] and [`EngineError::Beside`] where they cannot
    /// be read.
    pub fn hold(&self, registry: &Registry) -> Result<(), EngineError> {
        if let Some(known) = read(&self.inside, registry)? {
            let stored = |e: CheckpointError| EngineError::Stored { path: self.inside.clone(), problem: e.to_string() };
            registry.must_extend(&known.map_err(stored)?)?;
        }
        let Some(beside) = &self.beside else { return Ok(()) };
        match read(beside, registry)? {
            None => {
                // The first start of all, or the first here: a folder may be moved.
                if registry.size() > 0 {
                    tracing::warn!(
                        file = %beside.display(),
                        size = registry.size(),
                        "nothing beside the data folder says how far its log had come; it is taken as it is from here on"
                    );
                }
            }
            Some(Ok(known)) => registry.must_extend(&known).map_err(|error| {
                let problem = match error {
                    RegistryError::Inconsistent { what, .. } => what,
                    other => other.to_string(),
                };
                EngineError::RestoredOlder { file: beside.clone(), problem }
            })?,
            // Begun anew, or another folder in its place.
            Some(Err(
                other @ (CheckpointError::Origin { .. } | CheckpointError::Note(NoteError::NoneVerified { .. })),
            )) => {
                tracing::warn!(file = %beside.display(), %other, "another log's checkpoint is replaced by this one's");
            }
            Some(Err(damaged)) => {
                return Err(EngineError::Beside { file: beside.clone(), problem: damaged.to_string() });
            }
        }
        Ok(())
    }

    /// Keeps what was published. Where nothing can be written beside the data folder, that is said, and the one inside must do.
    ///
    /// # Errors
    /// The file system's, for the file in the data folder.
    pub fn keep(&self, checkpoint: &str) -> Result<(), EngineError> {
        write_atomic(&self.inside, checkpoint.as_bytes())?;
        if let Some(beside) = &self.beside
            && let Err(error) = write_atomic(beside, checkpoint.as_bytes())
            && !self.told.swap(true, Ordering::Relaxed)
        {
            tracing::warn!(
                %error,
                "nothing can be kept beside the data folder: that it was restored whole from an older backup is found out \
                 by an anchor (registry.anchor_file), witnesses and followers only"
            );
        }
        Ok(())
    }
}

/// The checkpoint in a file: none where there is no file.
fn read(file: &Path, registry: &Registry) -> Result<Option<Result<Checkpoint, CheckpointError>>, EngineError> {
    if !file.exists() {
        return Ok(None);
    }
    // What is no text is no note.
    let note = String::from_utf8_lossy(&read_limited(file, MAX_CHECKPOINT)?).into_owned();
    Ok(Some(Checkpoint::verify(&note, &registry.verifier().map_err(EngineError::from)?)))
}

/// A data folder that goes with its test, and what is kept beside it as well.
#[cfg(test)]
pub struct TestFolder {
    data: PathBuf,
    _around: tempfile::TempDir,
}

#[cfg(test)]
impl TestFolder {
    pub fn new() -> Self {
        let around = tempfile::tempdir().unwrap();
        let data = around.path().join("data");
        std::fs::create_dir(&data).unwrap();
        Self { data, _around: around }
    }

    pub fn path(&self) -> &Path {
        &self.data
    }
}
