//! Why settings are refused.

use cairn_durable::DurableError;
use thiserror::Error;

/// Why settings are refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read, or is too large.
    #[error("the settings are not read: {0}; check the path, the permissions and the size of the file")]
    Read(#[from] DurableError),
    /// The file is no TOML, or a value has the wrong type.
    #[error("{place}: {cause}")]
    Toml {
        /// File or message.
        place: String,
        /// What the reader said, with line and column.
        cause: String,
    },
    /// A key that does not exist.
    #[error("{place}: unknown key `{key}` = {value}; allowed there: {allowed}")]
    UnknownKey {
        /// File or message.
        place: String,
        /// The whole key.
        key: String,
        /// Its value.
        value: String,
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
}

pub(super) fn out_of_range(key: &str, value: impl ToString, allowed: impl ToString) -> ConfigError {
    ConfigError::OutOfRange { key: key.into(), value: value.to_string(), allowed: allowed.to_string() }
}
