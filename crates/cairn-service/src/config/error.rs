//! Why settings are refused.

use std::path::PathBuf;

use cairn_durable::DurableError;
use thiserror::Error;

/// Why settings are refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read, or is too large.
    #[error("the settings are not read: {0}; check the path, the permissions and the size of the file")]
    Read(#[from] DurableError),
    /// The file of a token cannot be read, or is too large.
    #[error("the token is not read: {0}; name the file that holds it (--token-file; for a daemon `access.token_file`)")]
    Token(DurableError),
    /// Others on this machine could read the token.
    #[error(
        "{}: mode {mode:o} lets others read the token in it, expected 600; run `chmod 600 {}`",
        path.display(),
        path.display()
    )]
    TokenTooOpen {
        /// The token's file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// The file is no TOML, or a value has the wrong type.
    #[error("{place}: {cause}")]
    Toml {
        /// File or message.
        place: String,
        /// What the reader said, with line and column.
        cause: String,
    },
    /// A key that does not exist. Its value may be a secret, and is not said.
    #[error("{place}: unknown key `{key}`; allowed there: {allowed}")]
    UnknownKey {
        /// File or message.
        place: String,
        /// The whole key.
        key: String,
        /// The keys of that table.
        allowed: String,
    },
    /// A value that is not allowed.
    #[error("key `{key}` = {value}: allowed is {allowed}")]
    OutOfRange {
        /// The whole key.
        key: String,
        /// Its value.
        value: String,
        /// What would do.
        allowed: String,
    },
    /// An entry of a list that will not do. It goes by its number, since its text may be a secret.
    #[error("entry {number} of `{key}` {what}")]
    Entry {
        /// The whole key.
        key: String,
        /// Which entry, from 1.
        number: usize,
        /// What is wrong with it, behind its name.
        what: String,
    },
}

pub(super) fn out_of_range(key: &str, value: impl ToString, allowed: impl ToString) -> ConfigError {
    ConfigError::OutOfRange { key: key.into(), value: value.to_string(), allowed: allowed.to_string() }
}
