//! Where passphrases and key files come from: a file, or the terminal. Never the environment, which is inherited and
//! shown by the system.

use std::path::{Path, PathBuf};

use cairn_log::OwnerKey;
use cairn_log::{
    KeyError,
    format::sealed::Passphrase,
    keys::{KeyFileError, Seal, Unlock, load_key, load_new_passphrase, load_passphrase, load_sealing_key},
};
use zeroize::Zeroizing;

/// What opens the owner's key where it is sealed.
#[derive(Clone, Debug, Default, clap::Args)]
#[group(multiple = false)]
pub struct UnlockArgs {
    /// The file with the key's passphrase (one line, readable by you alone); without it a sealed key's is asked for
    #[arg(long, value_name = "FILE")]
    pub passphrase_file: Option<PathBuf>,
    /// The key file that the key is sealed with (see `cairn keys new-key-file`)
    #[arg(long, value_name = "FILE")]
    pub key_file: Option<PathBuf>,
}

impl UnlockArgs {
    /// Opens the key in `path`, asking for its passphrase where that is needed and no file was given.
    ///
    /// # Errors
    /// The key file's; where there is no terminal to ask at.
    pub fn load(&self, path: &Path) -> Result<OwnerKey, KeyFileError> {
        let unlock = match (&self.passphrase_file, &self.key_file) {
            (Some(file), _) => Unlock::Passphrase(load_passphrase(file)?),
            (None, Some(file)) => Unlock::KeyFile(load_sealing_key(file)?),
            (None, None) => Unlock::Ask(&|path| Ok(Passphrase::typed(ask(path, "passphrase")?))),
        };
        load_key(path, &unlock)
    }

    /// How a new key is to be sealed, or an old one anew; without a file the passphrase is asked for, twice.
    ///
    /// # Errors
    /// As [`UnlockArgs::load`]; where the two differ.
    pub fn seal(&self, path: &Path) -> Result<Seal, KeyFileError> {
        Ok(match (&self.passphrase_file, &self.key_file) {
            (Some(file), _) => Seal::Passphrase(load_new_passphrase(file)?),
            (None, Some(file)) => Seal::KeyFile(load_sealing_key(file)?),
            (None, None) => {
                let first = Passphrase::new(ask(path, "new passphrase")?)?;
                if first != Passphrase::typed(ask(path, "the same again")?) {
                    return Err(KeyError::Passphrase("it was typed differently the second time").into());
                }
                Seal::Passphrase(first)
            }
        })
    }
}

/// What a person types at the terminal. Nothing of it is shown, not a star for a letter: its length helps who looks on.
fn ask(path: &Path, what: &str) -> Result<Zeroizing<String>, KeyFileError> {
    let asked = rpassword::prompt_password(format!("{what} for {}: ", path.display()));
    asked.map(Zeroizing::new).map_err(|e| {
        // What opening the terminal of a process without one is answered with: ENXIO, 6 on every Unix.
        let cause = if e.raw_os_error() == Some(6) { "there is no terminal here".to_owned() } else { e.to_string() };
        KeyFileError::Ask { path: path.into(), cause }
    })
}
