//! What can go wrong in stage 2, each naming the thing, the place and the remedy.

use thiserror::Error;

/// Errors of stage 2.
#[derive(Debug, Error)]
pub enum MarkError {
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
    /// The plan does not fit together.
    #[error("plan: {0}")]
    Plan(String),
    /// A number that is not finite appeared; the state is the last good one.
    #[error(
        "step {step}: {place} is not finite; the step was not taken. Lower `mark.learning_rate_networks` or `mark.learning_rate_carrier`"
    )]
    NotFinite {
        /// The step that made it.
        step: u64,
        /// Which quantity.
        place: String,
    },
    /// The networks failed.
    #[error(transparent)]
    Network(#[from] cairn_nn::NnError),
    /// The field failed.
    #[error(transparent)]
    Field(#[from] cairn_field::FieldError),
    /// A stored object cannot be read.
    #[error("{what}: {why}; train the scene again or restore the file from a backup")]
    Stored {
        /// What was being read.
        what: &'static str,
        /// What is wrong with it.
        why: String,
    },
}

impl From<candle_core::Error> for MarkError {
    fn from(error: candle_core::Error) -> Self {
        Self::Network(error.into())
    }
}
