//! Everything that can go wrong in the engine, each with what was asked, what is
//! expected, and what to do. The edge turns these into gRPC codes.

use std::path::{Path, PathBuf};

use crate::auth::AccessError;
use cairn_durable::DurableError;
use cairn_field::FieldError;
use cairn_log::{PublicKey, RecordError, RegistryError};
use cairn_mark::MarkError;
use cairn_scene::CaptureError;
use cairn_scene::cluster::ClusterError;
use cairn_scene::metrics::MetricError;
use cairn_share::ShareError;
use thiserror::Error;

use crate::config::ConfigError;
use crate::export::paths::PathError;

/// Most characters of a name that are compared with others: what is asked for may be as long as a message.
const MAX_COMPARED: usize = 128;

/// Why the engine did not do it.
#[derive(Debug, Error)]
pub enum EngineError {
    /// An argument that is not allowed.
    #[error("{what} is {got}; allowed is {expected}")]
    Invalid {
        /// The argument.
        what: String,
        /// What was given.
        got: String,
        /// What would do.
        expected: String,
    },
    /// Over one of the settings' limits.
    #[error("{what} is {got}, the limit `{key}` is {limit}; bring less, or have the limit raised")]
    OverLimit {
        /// What is too large.
        what: String,
        /// The setting.
        key: &'static str,
        /// Its value.
        limit: u64,
        /// What was brought.
        got: u64,
    },
    /// It does not exist.
    #[error("there is no {kind} {name:?}; there {there}")]
    NotFound {
        /// Scene, view, job, identity.
        kind: &'static str,
        /// What was asked for.
        name: String,
        /// What there is, shortened, with its verb.
        there: String,
    },
    /// The scene was not trained yet.
    #[error("scene {scene:?} has no model yet; train it first (cairn train {scene})")]
    NotTrained {
        /// The scene.
        scene: String,
    },
    /// The state does not allow it now.
    #[error("{what} cannot be {operation}: {why}")]
    WrongState {
        /// The thing.
        what: String,
        /// What was to be done with it.
        operation: &'static str,
        /// Why not.
        why: String,
    },
    /// The queue is full.
    #[error("the queue holds {limit} trainings, its limit `limits.queue_length`; try again when one has begun")]
    QueueFull {
        /// The limit.
        limit: usize,
    },
    /// The daemon is going down.
    #[error("the daemon is shutting down; try again when it is back")]
    ShuttingDown,
    /// There is nothing to read.
    #[error(
        "there is no data folder {}; name another with --data, or begin one with `cairn scene import`",
        path.display()
    )]
    NoFolder {
        /// What was named.
        path: PathBuf,
    },
    /// Another process has the data folder.
    #[error(
        "the data folder {} is in use by process {pid}; stop that process, talk to its daemon with --connect, or use \
         another folder",
        path.display()
    )]
    Locked {
        /// The folder.
        path: PathBuf,
        /// Who has it; `unknown` where its lock file does not say.
        pid: String,
    },
    /// An erasure request that is none, or not for this log.
    #[error(transparent)]
    Erasure(#[from] RecordError),
    /// An erasure request by a key that the record does not belong to.
    #[error("record {index} is not key {key}'s to erase: {why}")]
    NotYours {
        /// The record's place in the log.
        index: u64,
        /// The key that asks.
        key: PublicKey,
        /// Whose it is.
        why: String,
    },
    /// The file system said no.
    #[error("cannot {operation} {}: {source}", path.display())]
    Io {
        /// What was to be done.
        operation: &'static str,
        /// With what.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A stored file is damaged or of an unknown version.
    #[error("{}: {problem}; restore it from a backup or delete what it belongs to", path.display())]
    Stored {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A witness saw more of the log than there is, or another log; or it cannot be asked.
    #[error("{0}; restore the newest backup of the log, and never let it go on from an older one")]
    Witness(#[from] cairn_log::witness::WitnessError),
    /// A thread of the engine died; its message.
    #[error("internal failure: {0}; please report it")]
    Internal(String),
    /// Reading captures and photographs.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Grouping views.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    /// Stage 1 and rendering.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// Shares.
    #[error(transparent)]
    Share(#[from] ShareError),
    /// Stage 2 and detection.
    #[error(transparent)]
    Mark(#[from] MarkError),
    /// Scoring.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// Camera paths.
    #[error(transparent)]
    Path(#[from] PathError),
    /// Settings.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A key file.
    #[error(transparent)]
    KeyFile(#[from] cairn_log::keys::KeyFileError),
    /// The log of owner records. Boxed: it is much larger than the others.
    #[error(transparent)]
    Registry(Box<RegistryError>),
    /// Accounts, tokens, roles and quotas. Boxed likewise.
    #[error(transparent)]
    Access(Box<AccessError>),
}

impl From<AccessError> for EngineError {
    fn from(error: AccessError) -> Self {
        Self::Access(Box::new(error))
    }
}

impl From<RegistryError> for EngineError {
    fn from(error: RegistryError) -> Self {
        Self::Registry(Box::new(error))
    }
}

impl EngineError {
    /// Wraps what the file system said.
    pub fn io(operation: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { operation, path, source }
    }

    /// What the state does not allow now.
    pub fn wrong_state(what: impl Into<String>, operation: &'static str, why: impl Into<String>) -> Self {
        Self::WrongState { what: what.into(), operation, why: why.into() }
    }

    /// Holds `what`, of which there is `got`, to the setting `key`.
    ///
    /// # Errors
    /// [`EngineError::OverLimit`] for more than its value, `limit`.
    pub fn within(what: impl Into<String>, key: &'static str, limit: u64, got: u64) -> Result<(), Self> {
        if got <= limit { Ok(()) } else { Err(Self::OverLimit { what: what.into(), key, limit, got }) }
    }

    /// A file of more than `limit` bytes.
    pub fn too_large(path: PathBuf, limit: u64) -> Self {
        Self::Stored { path, problem: format!("more than {limit} bytes, the most that such a file may have") }
    }

    /// An argument that is not allowed.
    pub fn invalid(what: impl Into<String>, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::Invalid { what: what.into(), got: got.to_string(), expected: expected.into() }
    }

    /// A thing that people named is not there: [`Self::not_found`] with the most similar names first.
    pub fn misnamed<'a>(kind: &'static str, name: &str, there: impl Iterator<Item = &'a str>) -> Self {
        let asked: String = name.chars().take(MAX_COMPARED).flat_map(char::to_lowercase).collect();
        let mut there: Vec<&str> = there.collect();
        // Stable: of equally similar ones the order stays.
        there.sort_by_cached_key(|there| difference(&asked, there));
        Self::not_found(kind, name, there.into_iter())
    }

    /// A thing that is not there, and the first of those that are.
    pub fn not_found<'a>(kind: &'static str, name: &str, there: impl Iterator<Item = &'a str>) -> Self {
        let mut there: Vec<&str> = there.take(9).collect();
        if there.len() == 9 {
            there[8] = "...";
        }
        let there = if there.is_empty() { "are none yet".to_owned() } else { format!("is: {}", there.join(", ")) };
        Self::NotFound { kind, name: name.to_owned(), there }
    }
}

/// How many characters names differ in, the letters' case and folders before the name aside.
fn difference(asked: &str, there: &str) -> usize {
    let there = there.chars().take(MAX_COMPARED).flat_map(char::to_lowercase).collect::<String>();
    let file = there.rsplit('/').next().unwrap_or(&there);
    strsim::osa_distance(asked, &there).min(strsim::osa_distance(asked, file))
}

impl From<DurableError> for EngineError {
    fn from(error: DurableError) -> Self {
        match error {
            DurableError::Io { operation, path, cause } => Self::Io { operation, path, source: cause },
            DurableError::TooLarge { path, limit, .. } => Self::too_large(path, limit),
            // The lock file lies in the folder that it is about.
            DurableError::Locked { path, pid } => {
                Self::Locked { path: path.parent().map_or(path.clone(), Path::to_path_buf), pid }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_names_the_nearest_are_said() {
        let names: Vec<String> = (1..200).map(|n| format!("images/view_{n:03}.jpg")).collect();
        let said = |asked: &str| EngineError::misnamed("view", asked, names.iter().map(String::as_str)).to_string();
        assert!(said("view_57.jpg").contains("there is: images/view_057.jpg, "), "{}", said("view_57.jpg"));
        assert!(said("images/VIEW_120.jpeg").contains("there is: images/view_120.jpg, "));
        assert!(said("").ends_with(", ..."));
        assert!(said(&"x".repeat(1 << 20)).contains("there is: images/view_001.jpg, "));
        // Of numbers the order says more than the letters.
        let jobs = ["job-000030", "job-000029", "job-000003"].into_iter();
        let said = EngineError::not_found("job", "job-000004", jobs).to_string();
        assert!(said.contains("there is: job-000030, job-000029, job-000003"), "{said}");
    }
}
