//! Why a call was not let in, in one type, so that the edge has one match to make.

use std::path::PathBuf;

use cairn_durable::DurableError;

use crate::auth::accounts::AccountError;
use crate::auth::quota::QuotaError;
use crate::auth::registration::RegistrationError;
use crate::auth::roles::Role;
use crate::auth::token::TokenError;

/// Everything that access can say no with.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// The token.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The account.
    #[error(transparent)]
    Account(#[from] AccountError),
    /// A registration.
    #[error(transparent)]
    Registration(#[from] RegistrationError),
    /// The role, or whose it is.
    #[error(transparent)]
    Denied(#[from] Denied),
    /// A quota.
    #[error(transparent)]
    Quota(#[from] QuotaError),
    /// A stored file.
    #[error(transparent)]
    File(#[from] FileError),
}

/// The account is known and may not.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Denied {
    /// The role does not reach so far.
    #[error("{method} needs the role {needed}; {name:?} is {role}; an operator can change that (cairn access role)")]
    Role {
        /// The account's name.
        name: String,
        /// Its role.
        role: Role,
        /// The gRPC path.
        method: String,
        /// The roles that would do.
        needed: String,
    },
    /// A contributor's reach ends at what is theirs.
    #[error(
        "{what} belongs to another account, and a contributor changes only what is theirs; ask its owner or a curator"
    )]
    NotYours {
        /// The scene, job or record.
        what: String,
    },
}

/// A stored file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file system said no.
    #[error("cannot {operation} {}: {source}; check its permissions and the disk's room", path.display())]
    Io {
        /// What was to be done.
        operation: &'static str,
        /// With what.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is damaged or of an unknown version.
    #[error("{}: {problem}; restore it from a backup", path.display())]
    Stored {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
}

impl From<DurableError> for FileError {
    fn from(error: DurableError) -> Self {
        match error {
            DurableError::Io { operation, path, cause } => Self::Io { operation, path, source: cause },
            DurableError::TooLarge { path, limit, .. } => {
                Self::Stored { path, problem: format!("more than {limit} bytes, the most that such a file may have") }
            }
            DurableError::Locked { ref path, .. } => {
                Self::Io { operation: "lock", path: path.clone(), source: error.into() }
            }
        }
    }
}
