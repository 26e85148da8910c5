//! Where a follower gets a log's public files, and what it keeps of a log.

use cairn_log::format::{Checkpoint, Note, NoteVerifier};

use crate::{code::Code, report::Findings};

/// A log's files, wherever they lie.
pub trait Fetch {
    /// The file at a path below the log's prefix (`checkpoint`, `tile/...`), none where the log has no such file.
    ///
    /// # Errors
    /// [`FollowError::Fetch`], also for a file of more than `limit` bytes.
    fn fetch(&self, path: &str, limit: usize) -> Result<Option<Vec<u8>>, FollowError>;
}

/// Most new entries in one look, so that no forged size makes it endless.
pub const MAX_NEW_ENTRIES: u64 = 1 << 28;

/// Why a look at a log came to no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FollowError {
    /// A file that could not be had.
    #[error("{path}: cannot be fetched: {cause}")]
    Fetch {
        /// Where it was looked for.
        path: String,
        /// What went wrong.
        cause: String,
    },
    /// A file that the log must have and has not.
    #[error("the log does not serve {path}")]
    Missing {
        /// Its path.
        path: String,
    },
    /// A file that is cut off.
    #[error("{path}: {got} bytes, {expected} expected")]
    Short {
        /// Its path.
        path: String,
        /// Bytes that it must have.
        expected: usize,
        /// Bytes that there are.
        got: usize,
    },
    /// The checkpoint kept is not one of this log.
    #[error(
        "the checkpoint last seen is not one that {log} signed: {cause}; give another --state, or the key of its log"
    )]
    State {
        /// The pinned key.
        log: String,
        /// What is wrong with it.
        cause: String,
    },
    /// More than one look takes.
    #[error("{got} new entries, one look takes at most {limit}", limit = MAX_NEW_ENTRIES)]
    TooMany {
        /// How many there would be.
        got: u64,
    },
}

/// A checkpoint whose signature holds.
pub(super) struct Signed {
    pub(super) note: String,
    pub(super) checkpoint: Checkpoint,
}

impl Signed {
    pub(super) fn verify(note: &str, pinned: &NoteVerifier) -> Result<Self, String> {
        let checkpoint = Checkpoint::verify(note, pinned).map_err(|e| e.to_string())?;
        // Only what was verified is kept: lines that nobody known signed may be anything.
        let parsed = Note::parse(note).map_err(|e| e.to_string())?;
        Ok(Self { note: parsed.to_string(), checkpoint })
    }

    /// As [`Signed::verify`], told as a finding.
    pub(super) fn check(note: &str, pinned: &NoteVerifier, place: &str, findings: &mut Findings) -> Option<Self> {
        let signed = Self::verify(note, pinned);
        match &signed {
            Ok(Self { checkpoint, .. }) => {
                let got = format!("size {}, root {}", checkpoint.size, checkpoint.root);
                findings.add(Code::CheckpointVerified, place, "", got);
            }
            Err(cause) => {
                findings.add(Code::CheckpointSignatureInvalid, place, format!("one signed by {pinned}"), cause);
            }
        }
        signed.ok()
    }
}
