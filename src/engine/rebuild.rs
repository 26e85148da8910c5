//! Making the registry's working state again, on a folder that no daemon has open.

use std::path::Path;

use cairn_registry::Registry;
use cairn_registry::registry::Rebuilt;

use super::error::EngineError;
use super::folder::DataFolder;
use super::registry_key;
use crate::config::Config;

/// As [`Registry::rebuild`], in the data folder `data`. That the log goes on from what it published last, and from what its
/// witnesses saw, is checked by the next start.
///
/// # Errors
/// [`EngineError::Locked`] while another process has the folder; [`EngineError::KeyMissing`]; the registry's.
pub fn rebuild_registry(
    data: &Path,
    config: &Config,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Rebuilt, EngineError> {
    let folder = DataFolder::open(data)?;
    let key = registry_key::open(&folder, config.registry_key_file.as_deref())?;
    Ok(Registry::rebuild(&folder.registry(), &key, &config.origin, progress)?)
}
