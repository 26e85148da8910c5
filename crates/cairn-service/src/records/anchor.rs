//! The log's anchor in the settings: where it may lie, and writing it for the first time.
//!
//! What it is, and what a start makes of it, is cairn-log's ([`cairn_log::Anchor`]). An anchor inside the data folder
//! would go back with that when an older backup is restored, and so is refused.

use std::path::Path;

use cairn_log::{Anchor, Checkpoint, Registry, RegistryError};

use crate::config::Config;
use crate::error::EngineError;
use crate::records::published::LastPublished;
use crate::records::registry_key;
use crate::store::folder::DataFolder;

/// The anchor that the settings name, if any, for the log in the data folder `data`, which is there.
///
/// # Errors
/// [`EngineError::Invalid`] for one inside the data folder; [`RegistryError::Store`] where its folder is not there.
pub fn of(data: &Path, path: Option<&Path>) -> Result<Option<Anchor>, EngineError> {
    let Some(path) = path else { return Ok(None) };
    let anchor = Anchor::at(path).map_err(RegistryError::from)?;
    let real = |path: &Path| path.canonicalize().map_err(EngineError::io("find", path));
    let data = real(data)?;
    let folder = real(path.parent().unwrap_or(Path::new("/")))?;
    // The file itself may be a link that leads back.
    let inside = folder.starts_with(&data) || path.canonicalize().is_ok_and(|file| file.starts_with(&data));
    if inside {
        let expected = format!("a file outside the data folder {}, which is restored without it", data.display());
        return Err(EngineError::invalid("registry.anchor_file", path.display(), expected));
    }
    Ok(Some(anchor))
}

/// Opens the log of the data folder `data` against its anchor, which is written from it where it is missing and `accept`
/// says so; where the log is.
///
/// # Errors
/// [`EngineError::Invalid`] where the settings name no anchor; [`EngineError::Stored`] where no log was begun;
/// [`EngineError::Locked`]; as [`LastPublished::hold`]; the registry's: [`RegistryError::RolledBack`], [`RegistryError::AnchorMissing`].
pub fn hold(data: &Path, config: &Config, accept: bool) -> Result<Checkpoint, EngineError> {
    if config.anchor_file.is_none() {
        let expected = "the absolute path of a file outside the data folder, set with --config";
        return Err(EngineError::invalid("registry.anchor_file", "empty", expected));
    }
    // Before anything is made there: a path that is misspelt must not become a folder with a new key.
    let log = data.join("registry");
    if !log.is_dir() {
        let problem = "is missing: no log was begun here, to write an anchor from".into();
        return Err(EngineError::Stored { path: log, problem });
    }
    let folder = DataFolder::open(data)?;
    let key = registry_key::open(&folder, config.registry_key_file.as_deref())?;
    let anchor = of(data, config.anchor_file.as_deref())?;
    let anchor = anchor.map(|anchor| if accept { anchor.made_where_missing() } else { anchor });
    // An anchor is nobody's leave to forget what was published.
    let last = LastPublished::of(folder.last_checkpoint(), data, &key.public());
    if accept {
        last.hold(&Registry::open(&folder.registry(), key.clone(), &config.origin)?)?;
    }
    let registry = Registry::open_anchored(&folder.registry(), key, &config.origin, anchor)?;
    last.hold(&registry)?;
    Ok(registry.head()?)
}
