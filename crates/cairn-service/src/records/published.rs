//! What the log published last, kept where the log's own folder does not reach, so that one that was restored from an older
//! backup is found out at its next start.
//!
//! It is kept twice. `DIR/registry.checkpoint`, in the data folder, speaks where the log alone was restored.
//! `DIR.KEY.checkpoint`, beside it, speaks where the whole data folder was: it does not go back with that, and needs no
//! setting. KEY is the start of the log's key id: another log begun in the same place has a file of its own, and takes nobody's
//! word away. What was signed in the moment between a publication and a backup neither knows of; an anchor does
//! ([`crate::records::anchor`]), which may lie on another disk as well.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use cairn_log::{Checkpoint, PublicKey, Registry, RegistryError};

use crate::error::EngineError;
use cairn_durable::{read_limited, write_atomic};

/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 16;
/// Hexadecimal digits of the key id in the name beside the data folder.
const KEY_DIGITS: usize = 8;

/// The files that hold it.
#[derive(Debug)]
pub struct LastPublished {
    inside: PathBuf,
    beside: Option<PathBuf>,
    /// Whether it was said that nothing can be written there.
    told: AtomicBool,
}

impl LastPublished {
    /// In the file `inside` of the data folder `data`, which is there, and in one beside that; of the log with this key.
    pub fn of(inside: PathBuf, data: &Path, key: &PublicKey) -> Self {
        // Where a link leads, since that is what is restored.
        let data = data.canonicalize().ok().filter(|data| data.file_name().is_some());
        let beside = data.map(|data| {
            tell_of_mount(&data);
            let mut name = data.into_os_string();
            name.push(format!(".{}.checkpoint", &key.id().to_string()[..KEY_DIGITS]));
            PathBuf::from(name)
        });
        Self { inside, beside, told: AtomicBool::new(false) }
    }

    /// Holds the log to them, where they are there.
    ///
    /// # Errors
    /// [`cairn_log::RegistryError::Inconsistent`] for a log that does not go on from the one in the data folder, and
    /// [`EngineError::Stored`] where that cannot be read; [`EngineError::RestoredOlder`] and [`EngineError::Beside`] likewise
    /// for the one beside it.
    pub fn hold(&self, registry: &Registry) -> Result<(), EngineError> {
        if self.inside.exists() {
            let stored = |problem: String| EngineError::Stored { path: self.inside.clone(), problem };
            let known = verified(&read_limited(&self.inside, MAX_CHECKPOINT)?, registry)?;
            registry.must_extend(&known.map_err(stored)?)?;
        }
        match &self.beside {
            Some(beside) => hold_to_beside(beside, registry),
            None => Ok(()),
        }
    }

    /// Keeps what was published. Where nothing can be written beside the data folder, that is said once, and the one inside
    /// must do.
    ///
    /// # Errors
    /// The file system's, for the file in the data folder.
    pub fn keep(&self, checkpoint: &str) -> Result<(), EngineError> {
        let inside = write_atomic(&self.inside, checkpoint.as_bytes());
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
        Ok(inside?)
    }
}

fn hold_to_beside(beside: &Path, registry: &Registry) -> Result<(), EngineError> {
    let refuse = |problem: String| EngineError::Beside { file: beside.to_path_buf(), problem };
    let found = match beside.symlink_metadata() {
        Ok(found) => found,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            // The first start of all, or the first here: a folder may be moved.
            if registry.size() > 0 {
                tracing::warn!(
                    file = %beside.display(),
                    size = registry.size(),
                    "nothing beside the data folder says how far its log had come; it is taken as it is from here on"
                );
            }
            return Ok(());
        }
        Err(error) => return Err(refuse(error.to_string())),
    };
    if !found.is_file() {
        return Err(refuse("it is no regular file".into()));
    }
    let bytes = read_limited(beside, MAX_CHECKPOINT).map_err(|e| refuse(e.to_string()))?;
    let known = verified(&bytes, registry)?.map_err(refuse)?;
    registry.must_extend(&known).map_err(|error| {
        let problem = match error {
            RegistryError::Inconsistent { what, .. } => what,
            other => other.to_string(),
        };
        EngineError::RestoredOlder { file: beside.to_path_buf(), problem }
    })
}

/// The checkpoint that the log signed, or what is wrong with it.
fn verified(bytes: &[u8], registry: &Registry) -> Result<Result<Checkpoint, String>, EngineError> {
    let verifier = registry.verifier().map_err(EngineError::from)?;
    // What is no text is no note.
    let note = String::from_utf8_lossy(bytes);
    Ok(Checkpoint::verify(&note, &verifier).map_err(|e| e.to_string()))
}

/// Says so where the data folder is a disk of its own: beside it lies another, which may not outlast a container.
fn tell_of_mount(data: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let device = |path: &Path| path.metadata().ok().map(|found| found.dev());
        if let Some(around) = data.parent()
            && device(data) != device(around)
        {
            tracing::warn!(
                folder = %data.display(),
                "the data folder is where a disk is mounted: what is kept beside it lies on another, and goes with that; give \
                 the data a folder on the disk, or set registry.anchor_file"
            );
        }
    }
    #[cfg(not(unix))]
    let _ = data;
}

#[cfg(test)]
#[path = "published_tests.rs"]
pub mod tests;
