//! What can go wrong in the field, each naming the thing, the place and the remedy.

use thiserror::Error;

/// Errors of the radiance field.
#[derive(Debug, Error)]
pub enum FieldError {
    /// The capture gives no usable box.
    #[error("no scene box: {0}")]
    Frame(String),
    /// A setting is out of range.
    #[error("setting `{key}` = {value}: allowed is {allowed}")]
    Setting {
        /// The key as written in a configuration file.
        key: &'static str,
        /// What was given.
        value: String,
        /// What would do.
        allowed: &'static str,
    },
    /// Views do not fit what the call needs.
    #[error("views: {0}")]
    Views(String),
    /// A number that is not finite appeared; the state is the last good one.
    #[error(
        "step {step}: {place} is not finite; the step was not taken and the state before it is kept. Lower the learning rate (`learning_rate_density`) or look for a damaged photograph"
    )]
    NotFinite {
        /// The step that made it.
        step: u64,
        /// Which quantity, where.
        place: String,
    },
    /// A stored field or checkpoint cannot be read.
    #[error("{what}: {why}; train the scene again or restore the file from a backup")]
    Stored {
        /// What was being read.
        what: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// A stored field could not be read: whether it is damaged is not known.
    #[error("{what}: cannot be read: {source}; try again, and check the disk where that does not help")]
    Read {
        /// What was being read.
        what: &'static str,
        /// What the file system said.
        source: std::io::Error,
    },
}
