//! Refusals as people read them.

use tonic::Status;

/// What a daemon's refusal says, with its code.
pub fn refused(status: Status) -> anyhow::Error {
    anyhow::anyhow!("{} ({:?})", status.message(), status.code())
}
