//! Why settings are refused.

use std::path::PathBuf;

use thiserror::Error;

/// Why settings are refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the settings in {}: {source}; check the path and its permissions", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
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
