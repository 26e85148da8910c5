//! Making the registry's working state again, on a folder that no daemon has open.

use std::path::Path;

use cairn_log::Registry;
use cairn_log::log::Rebuilt;

use crate::config::Config;
use crate::error::EngineError;
use crate::records::registry_key;

/// As [`Registry::rebuild`], in the data folder `data`. That the log goes on from what it published last, and from what its
/// witnesses saw, is checked by the next start.
///
/// # Errors
/// [`EngineError::Stored`] where no log was published; [`EngineError::Locked`] while another process has the folder;
/// [`EngineError::WrongState`] without its key; the registry's.
pub fn rebuild_registry(
    data: &Path,
    config: &Config,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Rebuilt, EngineError> {
    let missing = "no log was published here, to make its working state from";
    let (folder, key) = registry_key::open_begun(data, config, "registry/public/checkpoint", missing)?;
    Ok(Registry::rebuild(&folder.registry(), &key, &config.origin, progress)?)
}
