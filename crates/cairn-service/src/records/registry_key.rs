//! The key that the log is signed with: made at the first start, and on disk plain or sealed as the settings say.

use std::path::Path;

use cairn_log::{
    OwnerKey,
    format::sealed::SealingKey,
    keys::{KeyFileError, Seal, Unlock, load_key, load_sealing_key, save_key},
};

use crate::error::EngineError;
use crate::store::folder::DataFolder;

/// Opens the folder's registry key; makes it where the log is still empty.
///
/// # Errors
/// [`EngineError::KeyMissing`], [`EngineError::SealingKeyMissing`]; a key that is sealed where `key_file` says
/// nothing, or plain where it does.
pub fn open(folder: &DataFolder, key_file: Option<&Path>) -> Result<OwnerKey, EngineError> {
    let path = folder.registry_key();
    let sealing = key_file.map(sealing_key).transpose()?;
    if !path.exists() {
        // A new key cannot go on with an old log; made all the same, it would only hide that the old one is lost.
        if !folder.registry_is_empty()? {
            return Err(EngineError::KeyMissing { key: path, log: folder.registry() });
        }
        let seal = sealing.clone().map_or(Seal::Plain, Seal::KeyFile);
        save_key(&path, &OwnerKey::generate().map_err(KeyFileError::from)?, &seal)?;
    }
    let unlock = sealing.map_or(Unlock::Nothing, Unlock::KeyFile);
    Ok(load_key(&path, &unlock)?)
}

fn sealing_key(path: &Path) -> Result<SealingKey, EngineError> {
    // Never made here: a path that is misspelt must not seal the log's key with what nobody keeps.
    load_sealing_key(path).map_err(|e| match e {
        KeyFileError::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            EngineError::SealingKeyMissing { path: path.into() }
        }
        other => other.into(),
    })
}
