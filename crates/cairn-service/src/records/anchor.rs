//! Where the log's anchor lies, and writing it for the first time.
//!
//! The anchor is the one guard against a data folder that was restored from an older backup ([`cairn_log::Anchor`]). It
//! is always on. It lies beside the data folder `DIR`, in `DIR.KEY.anchor`, unless the settings name another file. KEY is
//! the start of the log's key id, so another log in the same place has an anchor of its own. An anchor inside the data
//! folder would go back with that, and is refused.

use std::path::{Path, PathBuf};

use cairn_log::{Anchor, Checkpoint, PublicKey, Registry, RegistryError};

use crate::config::Config;
use crate::error::EngineError;
use crate::records::registry_key;

/// Hexadecimal digits of the key id in the name beside the data folder.
const KEY_DIGITS: usize = 8;

/// The anchor of the log with this key in the data folder `data`, which is there; in the file that the settings name, or
/// else beside the data folder.
///
/// # Errors
/// [`EngineError::Invalid`] for one inside the data folder, or where nothing lies beside that;
/// [`RegistryError::Store`] where the anchor's folder is not there.
pub fn of(data: &Path, key: &PublicKey, file: Option<&Path>) -> Result<Anchor, EngineError> {
    let real = |path: &Path| path.canonicalize().map_err(EngineError::io("find", path));
    // Where a link leads, since that is what is restored.
    let data = real(data)?;
    let invalid = |path: &Path| {
        let expected = format!("a file outside the data folder {}, which is restored without it", data.display());
        EngineError::invalid("registry.anchor_file", path.display(), expected)
    };
    let path = match file {
        Some(file) => file.to_path_buf(),
        None => beside(&data, key).ok_or_else(|| invalid(&data))?,
    };
    let anchor = Anchor::at(&path).map_err(RegistryError::from)?;
    let folder = real(path.parent().unwrap_or(Path::new("/")))?;
    // The file itself may be a link that leads back.
    if folder.starts_with(&data) || path.canonicalize().is_ok_and(|file| file.starts_with(&data)) {
        return Err(invalid(&path));
    }
    tracing::info!(file = %path.display(), "the log is anchored");
    Ok(anchor)
}

/// `DIR.KEY.anchor`; none for a data folder that has no folder around it.
fn beside(data: &Path, key: &PublicKey) -> Option<PathBuf> {
    data.file_name()?;
    warn_of_mount(data);
    let mut name = data.as_os_str().to_owned();
    name.push(format!(".{}.anchor", &key.id().to_string()[..KEY_DIGITS]));
    Some(name.into())
}

/// Warns where the data folder is a disk of its own: beside it lies another, which may not outlast a container.
fn warn_of_mount(data: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let device = |path: &Path| path.metadata().ok().map(|found| found.dev());
        if let Some(around) = data.parent()
            && device(data) != device(around)
        {
            tracing::warn!(
                folder = %data.display(),
                "the data folder is where a disk is mounted: the anchor beside it lies on another disk; give the data a \
                 folder on its disk, or set registry.anchor_file"
            );
        }
    }
    #[cfg(not(unix))]
    let _ = data;
}

/// Opens the log of the data folder `data` against its anchor and gives the log's head. Where the anchor is missing,
/// `accept` writes it from the log as it is.
///
/// # Errors
/// [`EngineError::Stored`] where no log was begun; [`EngineError::Locked`]; [`EngineError::Invalid`] as [`of`]; the
/// registry's: [`RegistryError::RolledBack`], [`RegistryError::AnchorMissing`].
pub fn hold(data: &Path, config: &Config, accept: bool) -> Result<Checkpoint, EngineError> {
    let missing = "no log was begun here, to write an anchor from";
    let (folder, key) = registry_key::open_begun(data, config, "registry", missing)?;
    let anchor = of(data, &key.public(), config.anchor_file.as_deref())?;
    let anchor = if accept { anchor.made_where_missing() } else { anchor };
    let registry = Registry::open_anchored(&folder.registry(), key, &config.origin, Some(anchor))?;
    Ok(registry.head()?)
}
