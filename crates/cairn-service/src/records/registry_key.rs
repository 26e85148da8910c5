//! The key that the log is signed with: made at the first start, and on disk plain or sealed as the settings say.

use std::path::Path;

use cairn_log::{
    OwnerKey,
    format::sealed::SealingKey,
    keys::{KeyFileError, Seal, Unlock, load_key, load_sealing_key, save_key},
};

use crate::config::Config;
use crate::error::EngineError;
use crate::store::folder::DataFolder;

/// Opens the folder's registry key; makes it where the log is still empty.
///
/// # Errors
/// [`EngineError::WrongState`] where the key, or what it is sealed with, is missing; a key that is
/// sealed where `key_file` says nothing, or plain where it does.
pub fn open(folder: &DataFolder, key_file: Option<&Path>) -> Result<OwnerKey, EngineError> {
    let path = folder.registry_key();
    let sealing = key_file.map(sealing_key).transpose()?;
    if !path.exists() {
        // A new key cannot go on with an old log; made all the same, it would only hide that the old one is lost.
        if !folder.registry_is_empty()? {
            let why = format!(
                "its key {} is missing, and no other can sign that log; restore the key's file from the backup",
                path.display()
            );
            return Err(EngineError::wrong_state(format!("the log in {}", folder.registry().display()), "opened", why));
        }
        let seal = sealing.clone().map_or(Seal::Plain, Seal::KeyFile);
        save_key(&path, &OwnerKey::generate().map_err(KeyFileError::from)?, &seal)?;
    }
    let unlock = sealing.map_or(Unlock::Nothing, Unlock::KeyFile);
    Ok(load_key(&path, &unlock)?)
}

/// Opens the data folder `data`, in which `file` lies already, and its registry key; `missing` says
/// what a folder without that file lacks.
///
/// # Errors
/// [`EngineError::Stored`] where the file is not there; [`DataFolder::open`]'s and [`open`]'s.
pub fn open_begun(
    data: &Path,
    config: &Config,
    file: &str,
    missing: &str,
) -> Result<(DataFolder, OwnerKey), EngineError> {
    // Before anything is made there: a path that is misspelt must not become a folder with a new
    // key.
    let path = data.join(file);
    if !path.exists() {
        return Err(EngineError::Stored { path, problem: format!("is missing: {missing}") });
    }
    let folder = DataFolder::open(data)?;
    let key = open(&folder, config.registry_key_file.as_deref())?;
    Ok((folder, key))
}

fn sealing_key(path: &Path) -> Result<SealingKey, EngineError> {
    // Never made here: a path that is misspelt must not seal the log's key with what nobody keeps.
    load_sealing_key(path).map_err(|e| match e {
        KeyFileError::Missing { .. } => {
            let (what, path) = ("the registry's key", path.display());
            let why = format!(
                "the key file {path} (registry.key_file) is missing; restore it from its backup, or for a new log make \
                 one with `cairn keys new-key-file {path}`"
            );
            EngineError::wrong_state(what, "opened", why)
        }
        other => other.into(),
    })
}
