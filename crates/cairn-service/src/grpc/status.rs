//! One place where errors become gRPC codes. The matches are exhaustive without
//! `_`, so that a new error cannot slip through with a code that nobody chose.

use crate::auth::AccountError;
use crate::auth::error::FileError;
use crate::auth::registration::RegistrationError;
use crate::auth::{AccessError, TokenError};
use cairn_field::FieldError;
use cairn_log::RegistryError;
use cairn_mark::MarkError;
use cairn_scene::CaptureError;
use cairn_scene::cluster::ClusterError;
use cairn_share::ShareError;
use tonic::{Code, Status};

use crate::error::EngineError;

/// The status that a client sees. What went wrong inside is logged as well.
impl From<EngineError> for Status {
    fn from(error: EngineError) -> Self {
        let code = code(&error);
        if matches!(code, Code::Internal | Code::DataLoss) {
            tracing::error!(%error, ?code, "a request failed inside");
        }
        Self::new(code, error.to_string())
    }
}

/// The status of a caller who is not let in, or not let do it.
pub fn refuse(error: impl Into<AccessError>) -> Status {
    EngineError::from(error.into()).into()
}

fn code(error: &EngineError) -> Code {
    match error {
        EngineError::Invalid { .. }
        | EngineError::OverLimit { .. }
        | EngineError::Config(_)
        | EngineError::KeyFile(_)
        | EngineError::Erasure(_) => Code::InvalidArgument,
        EngineError::NotYours { .. } => Code::PermissionDenied,
        EngineError::NotFound { .. } | EngineError::NoFolder { .. } => Code::NotFound,
        EngineError::NotTrained { .. }
        | EngineError::WrongState { .. }
        | EngineError::Witness(_)
        | EngineError::Path(_) => Code::FailedPrecondition,
        EngineError::QueueFull { .. } => Code::ResourceExhausted,
        EngineError::ShuttingDown | EngineError::Locked { .. } => Code::Unavailable,
        EngineError::Stored { .. } => Code::DataLoss,
        EngineError::Io { .. } | EngineError::Internal(_) | EngineError::Metric(_) => Code::Internal,
        EngineError::Capture(error) => capture(error),
        EngineError::Cluster(error) => cluster(error),
        EngineError::Field(error) => field(error),
        EngineError::Share(error) => share(error),
        EngineError::Mark(error) => mark(error),
        EngineError::Registry(error) => registry(error),
        EngineError::Access(error) => access(error),
    }
}

/// Unauthenticated: nobody known says so. Permission denied: somebody known, who may not.
fn access(error: &AccessError) -> Code {
    match error {
        AccessError::Token(error) => match error {
            TokenError::Missing { .. }
            | TokenError::Malformed { .. }
            | TokenError::Version { .. }
            | TokenError::BadSignature { .. }
            | TokenError::WrongMethod { .. }
            | TokenError::WrongScene { .. }
            | TokenError::WrongDaemon { .. }
            | TokenError::NotYet { .. }
            | TokenError::Expired { .. }
            | TokenError::Lifetime { .. }
            | TokenError::Replayed => Code::Unauthenticated,
            TokenError::TooLong { .. } => Code::InvalidArgument,
            TokenError::Random(_) => Code::Internal,
            TokenError::MemoryFull { .. } => Code::ResourceExhausted,
        },
        AccessError::Account(error) => match error {
            AccountError::Unknown { .. } => Code::Unauthenticated,
            AccountError::NoSuch { .. } => Code::NotFound,
            AccountError::Waiting { .. }
            | AccountError::Disabled { .. }
            | AccountError::Rotated { .. }
            | AccountError::Ended { .. }
            | AccountError::Closed => Code::PermissionDenied,
            AccountError::TooMany { .. } => Code::ResourceExhausted,
            AccountError::Name { .. } => Code::InvalidArgument,
            AccountError::Exists { .. } => Code::AlreadyExists,
            AccountError::NotWaiting { .. } | AccountError::LastOperator { .. } => Code::FailedPrecondition,
        },
        AccessError::Registration(error) => match error {
            RegistrationError::Random(_) => Code::Internal,
            RegistrationError::ForeignNonce | RegistrationError::ExpiredNonce { .. } => Code::FailedPrecondition,
            RegistrationError::BadSignature { .. } => Code::Unauthenticated,
        },
        AccessError::Denied(_) => Code::PermissionDenied,
        AccessError::Quota(_) => Code::ResourceExhausted,
        AccessError::File(FileError::Io { .. }) => Code::Internal,
        AccessError::File(FileError::Stored { .. }) => Code::DataLoss,
    }
}

fn capture(error: &CaptureError) -> Code {
    match error {
        CaptureError::Io { .. } | CaptureError::NotFinite { .. } => Code::Internal,
        CaptureError::NotACapture { .. }
        | CaptureError::NoCameras { .. }
        | CaptureError::InCapture { .. }
        | CaptureError::Malformed { .. }
        | CaptureError::UnsupportedCamera { .. }
        | CaptureError::Lens { .. }
        | CaptureError::Pose { .. }
        | CaptureError::PhotographMissing { .. }
        | CaptureError::NotAPicture { .. }
        | CaptureError::NotASound { .. }
        | CaptureError::SoundTooLong { .. }
        | CaptureError::TooLarge { .. }
        | CaptureError::SizeMismatch { .. }
        | CaptureError::HoldOut { .. }
        | CaptureError::MaskSize { .. }
        | CaptureError::Contributors { .. }
        | CaptureError::SceneName { .. } => Code::InvalidArgument,
        CaptureError::SceneExists { .. } => Code::AlreadyExists,
        CaptureError::UnknownVersion { .. } | CaptureError::Altered { .. } => Code::DataLoss,
        CaptureError::NoSuchView { .. } => Code::NotFound,
    }
}

fn cluster(error: &ClusterError) -> Code {
    match error {
        ClusterError::Setting { .. } => Code::InvalidArgument,
        ClusterError::TooFewViews { .. } | ClusterError::TooFewPoses { .. } | ClusterError::NoContributor { .. } => {
            Code::FailedPrecondition
        }
        ClusterError::ContributorCount { .. } => Code::Internal,
        ClusterError::NotFinite { .. } | ClusterError::Damaged { .. } => Code::DataLoss,
    }
}

fn share(error: &ShareError) -> Code {
    match error {
        ShareError::Photographs { .. } | ShareError::Entries => Code::FailedPrecondition,
        ShareError::OtherField { .. } => Code::DataLoss,
        ShareError::File(error) => field(error),
    }
}

fn field(error: &FieldError) -> Code {
    match error {
        FieldError::Setting { .. } => Code::InvalidArgument,
        FieldError::Frame(_) | FieldError::Views(_) => Code::FailedPrecondition,
        FieldError::NotFinite { .. } | FieldError::Read { .. } => Code::Internal,
        FieldError::Stored { .. } => Code::DataLoss,
    }
}

fn mark(error: &MarkError) -> Code {
    match error {
        MarkError::Setting { .. } | MarkError::Signal { .. } => Code::InvalidArgument,
        MarkError::Plan(_) | MarkError::NotLearnt { .. } => Code::FailedPrecondition,
        MarkError::Stopped => Code::Cancelled,
        MarkError::NotFinite { .. } | MarkError::Network(_) | MarkError::Metric(_) => Code::Internal,
        MarkError::Field(error) => field(error),
        MarkError::Stored { .. } => Code::DataLoss,
    }
}

fn registry(error: &RegistryError) -> Code {
    match error {
        RegistryError::Record(_) | RegistryError::WrongOrigin { .. } | RegistryError::Key(_) => Code::InvalidArgument,
        RegistryError::NonceForeign { .. }
        | RegistryError::NonceUsed { .. }
        | RegistryError::NonceExpired { .. }
        | RegistryError::SeenForeign { .. }
        | RegistryError::OwnerRotated { .. }
        | RegistryError::OwnerRevoked { .. }
        | RegistryError::ReplacesRevoked { .. }
        | RegistryError::ReplacesUnknown { .. } => Code::FailedPrecondition,
        RegistryError::ReplacesForeign { .. } => Code::PermissionDenied,
        RegistryError::NoSuchRecord { .. } | RegistryError::NotARecord { .. } | RegistryError::Erased { .. } => {
            Code::NotFound
        }
        RegistryError::Proof(_) => Code::InvalidArgument,
        RegistryError::Answer(_) => Code::ResourceExhausted,
        RegistryError::Locked { .. } | RegistryError::Halted { .. } => Code::Unavailable,
        RegistryError::WrongStore { .. } | RegistryError::Origin(_) => Code::FailedPrecondition,
        RegistryError::AnchorMissing { .. } => Code::FailedPrecondition,
        RegistryError::Inconsistent { .. }
        | RegistryError::RolledBack { .. }
        | RegistryError::BadAnchor { .. }
        | RegistryError::Map(_)
        | RegistryError::Pack(_)
        | RegistryError::Rebuild { .. } => Code::DataLoss,
        RegistryError::Store(_) => Code::Internal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_say_whose_turn_it_is() {
        let not_found = EngineError::not_found("scene", "x", ["a", "b"].into_iter());
        let answer = Status::from(not_found);
        assert_eq!(answer.code(), Code::NotFound);
        assert_eq!(answer.message(), "there is no scene \"x\"; there is: a, b");
        assert_eq!(Status::from(EngineError::QueueFull { limit: 3 }).code(), Code::ResourceExhausted);
        assert_eq!(Status::from(EngineError::ShuttingDown).code(), Code::Unavailable);
        let taken = CaptureError::SceneExists { path: "x".into() };
        assert_eq!(Status::from(EngineError::from(taken)).code(), Code::AlreadyExists);
        let record = RegistryError::NoSuchRecord { index: 1, size: 0 };
        assert_eq!(Status::from(EngineError::from(record)).code(), Code::NotFound);
    }
}
