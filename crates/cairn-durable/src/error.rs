//! The error of everything here: it names the operation and the path.

use std::io;
use std::path::{Path, PathBuf};

/// Why a file could not be read, written or locked.
#[derive(Debug, thiserror::Error)]
pub enum DurableError {
    /// The file system refused.
    #[error("cannot {operation} {}: {cause}", path.display())]
    Io {
        /// What was tried, a verb such as `read` or `flush`.
        operation: &'static str,
        /// On what.
        path: PathBuf,
        /// What the system answered. Not a `source`: the message has it already.
        cause: io::Error,
    },
    /// The file holds more than its reader accepts. None of it was kept.
    #[error("{} has {} bytes, at most {limit} are read", path.display(), got.map_or("more".into(), |n| n.to_string()))]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The most that is read, bytes.
        limit: u64,
        /// Its length, bytes; `None` where that shows only in reading (a pipe, or a file that grows).
        got: Option<u64>,
    },
    /// Another process holds the lock.
    #[error("{} is held by process {pid}; stop that process, or use another folder", path.display())]
    Locked {
        /// The lock file.
        path: PathBuf,
        /// The holder's process id; `unknown` where the file does not say.
        pid: String,
    },
}

impl DurableError {
    /// Wraps what the file system answered.
    pub fn io(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_path_buf();
        move |cause| Self::Io { operation, path: path.clone(), cause }
    }

    /// What the system answered, without operation and path, for errors that name these themselves.
    pub fn into_cause(self) -> io::Error {
        match self {
            Self::Io { cause, .. } => cause,
            other => other.into(),
        }
    }

    /// Whether it says that there is no such file.
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::Io { cause, .. } if cause.kind() == io::ErrorKind::NotFound)
    }
}

impl From<DurableError> for io::Error {
    fn from(error: DurableError) -> Self {
        let kind = match &error {
            DurableError::Io { cause, .. } => cause.kind(),
            DurableError::TooLarge { .. } => io::ErrorKind::FileTooLarge,
            DurableError::Locked { .. } => io::ErrorKind::WouldBlock,
        };
        Self::new(kind, error.to_string())
    }
}
