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
    /// What an identity brought cannot be hidden.
    #[error("identity {identity}, hidden signal: {problem}")]
    Signal {
        /// The identity, 1 and up.
        identity: usize,
        /// What is wrong, what is allowed, and what to do.
        problem: String,
    },
    /// A number that is not finite appeared; a trainer's state is the last good one.
    #[error("{}", not_finite(*step, place))]
    NotFinite {
        /// The step that made it, or after which it was read; `None` for a detector at work.
        step: Option<u64>,
        /// Which quantity.
        place: String,
    },
    /// Training ended before the marks could be read, so that the detector never trained.
    #[error(
        "after {steps} steps the classifier's cross-entropy is {classify:.3} nats and did not fall below `mark.classify_until` = {until} in time: the marks were not learnt. Train again with more `mark.steps`, or with stronger marks (a lower `mark.budget_db`; without a budget, a lower `mark.weight_picture`)"
    )]
    NotLearnt {
        /// Steps done.
        steps: u64,
        /// Running mean of the cross-entropy at the end, nats.
        classify: f64,
        /// What it had to fall below, nats.
        until: f64,
    },
    /// The caller's `progress` asked to stop; nothing was made.
    #[error(
        "stopped, as asked, before stage 2's first step or after its last; start it, or resume its checkpoint, to go on"
    )]
    Stopped,
    /// The networks failed.
    #[error(transparent)]
    Network(#[from] cairn_nn::NnError),
    /// The field failed.
    #[error(transparent)]
    Field(#[from] cairn_field::FieldError),
    /// Recovered signals could not be scored.
    #[error(transparent)]
    Metric(#[from] cairn_scene::metrics::MetricError),
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

fn not_finite(step: Option<u64>, place: &str) -> String {
    match step {
        Some(step) => format!(
            "step {step}: {place} is not finite; the last good state is kept. Lower `mark.learning_rate_networks` or `mark.learning_rate_carrier`"
        ),
        None => format!(
            "{place} is not finite; restore the detector from a backup, or train the scene again with a lower `mark.learning_rate_networks`"
        ),
    }
}
