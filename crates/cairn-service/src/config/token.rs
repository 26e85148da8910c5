//! The bearer token of `access.token_file`, and reading a small file.

use std::path::Path;

use cairn_durable::{read_limited, read_secret};

use super::error::{ConfigError, out_of_range};

/// Largest settings or token file, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// A bearer token; never printed.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// The secret itself, to be compared or sent and not to be shown.
    pub fn secret(&self) -> &str {
        &self.0
    }

    /// Reads the token in `path`: one line of 16 to 512 printable ASCII characters, in a file that its owner alone may read.
    ///
    /// # Errors
    /// [`ConfigError`] when it cannot be read, is no such line, or others may read it.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let (bytes, open_to_others) = read_secret(path, MAX_FILE_BYTES).map_err(ConfigError::Token)?;
        let text = text(path, bytes)?;
        let token = text.trim();
        if !(16..=512).contains(&token.len()) || !token.bytes().all(|b| b.is_ascii_graphic()) {
            // The value is a secret: its length must do.
            let value = format!("a token of {} bytes in {}", token.len(), path.display());
            return Err(out_of_range("access.token_file", value, "16 to 512 printable ASCII characters on one line"));
        }
        if let Some(mode) = open_to_others {
            return Err(ConfigError::TokenTooOpen { path: path.to_path_buf(), mode });
        }
        Ok(Self(token.to_owned()))
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(secret)")
    }
}

/// The text of a settings file.
pub(super) fn read(path: &Path) -> Result<String, ConfigError> {
    text(path, read_limited(path, MAX_FILE_BYTES)?)
}

fn text(path: &Path, bytes: Vec<u8>) -> Result<String, ConfigError> {
    let no_text = |e| ConfigError::Toml { place: path.display().to_string(), cause: format!("not UTF-8: {e}") };
    String::from_utf8(bytes).map_err(no_text)
}
