//! Why a call was not let in, in one type, so that the edge has one match to make.

use std::fmt;
use std::path::PathBuf;

use cairn_durable::DurableError;
use cairn_log::{Digest, PublicKey};
use serde::Serialize;

use crate::auth::registration::RegistrationError;
use crate::auth::roles::Role;
use crate::auth::wire::{MAX_TEXT, SKEW_S, VERSION};

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
    #[error(
        "{method} needs the role {needed}; {name:?} is {role}; an operator can change that (cairn access set --role)"
    )]
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

/// Longest name, bytes.
pub const MAX_NAME: usize = 128;

/// Why an account is refused, or something is refused it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AccountError {
    /// Nobody with this key is known.
    #[error("there is no account with the key id {key}; register its key first (cairn access register)")]
    Unknown {
        /// SHA-256 of the public key.
        key: Digest,
    },
    /// There is none to change.
    #[error("there is no account with the public key {key}; see `cairn access list`")]
    NoSuch {
        /// The key.
        key: PublicKey,
    },
    /// Not yet approved.
    #[error("the account {name:?} waits for an operator's approval (cairn access approve)")]
    Waiting {
        /// Its name.
        name: String,
    },
    /// Shut out.
    #[error("the account {name:?} is disabled; ask the daemon's operator")]
    Disabled {
        /// Its name.
        name: String,
    },
    /// Another key took its key's place.
    #[error("the account {name:?} continues under key {heir}, to which its own was rotated; sign with that one")]
    Rotated {
        /// Its name.
        name: String,
        /// The key in its place.
        heir: PublicKey,
    },
    /// Its key ended, with none in its place.
    #[error("the key with id {key} was ended by record {index} of the log; register another one (cairn keys new)")]
    Ended {
        /// The key's id.
        key: Digest,
        /// The record that ended it.
        index: u64,
    },
    /// Nobody is taken in.
    #[error(
        "this daemon takes no registrations (access.registration = \"closed\"); ask its operator to add your public key"
    )]
    Closed,
    /// There are too many.
    #[error("{got} accounts {what}, the most that this daemon keeps; ask its operator")]
    TooMany {
        /// `are there` or `wait for approval`.
        what: &'static str,
        /// How many.
        got: usize,
    },
    /// The name cannot be taken.
    #[error("the account's name has {bytes} bytes{more}; allowed are 1 to {MAX_NAME} without control characters")]
    Name {
        /// Its length.
        bytes: usize,
        /// What else is wrong.
        more: &'static str,
    },
    /// The key has an account already, made otherwise.
    #[error(
        "the key {key} has an account already: {name:?}, {role}; change its role instead (cairn access set --role)"
    )]
    Exists {
        /// The key.
        key: PublicKey,
        /// The account's name.
        name: String,
        /// Its role.
        role: Role,
    },
    /// It is approved already.
    #[error("the account {name:?} is {standing}, not waiting; change its role or enable it instead")]
    NotWaiting {
        /// Its name.
        name: String,
        /// Where it stands.
        standing: String,
    },
    /// Nobody could undo it from afar.
    #[error("{name:?} is the last active operator; make another one first")]
    LastOperator {
        /// Its name.
        name: String,
    },
}

/// Why a token is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// A guarded call came without one.
    #[error(
        "{method} needs a signed token; name your account's key (--account FILE), or register one (cairn access register)"
    )]
    Missing {
        /// The call's method.
        method: String,
    },
    /// It cannot be read.
    #[error("the token cannot be read: {field}; expected is `Cairn` and base64url of at most {MAX_TEXT} characters")]
    Malformed {
        /// Where it went wrong.
        field: &'static str,
    },
    /// Its version is not known.
    #[error("the token has version {got}, this release reads {VERSION}")]
    Version {
        /// Its version.
        got: u8,
    },
    /// A field is too long to be signed.
    #[error("no token can be signed: {field} is too long")]
    TooLong {
        /// The field.
        field: &'static str,
    },
    /// The operating system gave no random bytes.
    #[error("no token can be signed: the operating system gave no random bytes ({0})")]
    Random(String),
    /// The signature is not the named key's.
    #[error("the token's signature does not verify under the key that it names, {key}")]
    BadSignature {
        /// The key's id.
        key: Digest,
    },
    /// For another method.
    #[error("the token is for {token}, the call is {call}; sign one for this call")]
    WrongMethod {
        /// The token's.
        token: String,
        /// The call's.
        call: String,
    },
    /// For another scene.
    #[error("the token is about scene {token:?}, the call about {call:?}; sign one for this call")]
    WrongScene {
        /// The token's.
        token: String,
        /// The call's.
        call: String,
    },
    /// For another daemon, or for an earlier run of this one.
    #[error("the token is for {token}, this is {here}; ask the daemon who it is (AccessService.About) and sign again")]
    WrongDaemon {
        /// The token's.
        token: String,
        /// This one.
        here: String,
    },
    /// From the future.
    #[error(
        "the token was issued at {issued}, it is {now} here (seconds since 1970, {SKEW_S} s of difference are allowed); set the clocks"
    )]
    NotYet {
        /// Its time.
        issued: u64,
        /// The daemon's.
        now: u64,
    },
    /// From the past.
    #[error(
        "the token expired at {expires}, it is {now} here (seconds since 1970, {SKEW_S} s of difference are allowed); sign a new one or set the clocks"
    )]
    Expired {
        /// Its end.
        expires: u64,
        /// The daemon's time.
        now: u64,
    },
    /// It lives longer than the daemon allows, or ends before it begins.
    #[error("the token lives from {issued} to {expires}; allowed are 0 to {longest_s} s (access.token_lifetime_s)")]
    Lifetime {
        /// Its time.
        issued: u64,
        /// Its end.
        expires: u64,
        /// The longest allowed.
        longest_s: u64,
    },
    /// It was used before.
    #[error("the token was used already; every call needs its own")]
    Replayed,
    /// No room to remember it, and an unremembered token could be used twice.
    #[error(
        "{limit} tokens of {whose} are remembered, as many as fit; the next is forgotten at {frees} (seconds since 1970): try again then"
    )]
    MemoryFull {
        /// `this account` or `all accounts`.
        whose: &'static str,
        /// How many.
        limit: usize,
        /// When there is room again.
        frees: u64,
    },
}

/// Kinds of quotas, which are written as their settings' keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Bytes of photographs stored.
    Bytes,
    /// Views stored.
    Views,
    /// Seconds of training within a rolling day.
    TrainingSeconds,
    /// Trainings that have not ended.
    QueuedJobs,
    /// Owner records submitted, in all.
    Records,
    /// Owner records submitted within a rolling day.
    RecordsPerDay,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// When a used-up quota has room again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frees {
    /// When a scene is deleted, or views of it are removed.
    OnDelete,
    /// When a training ends or is cancelled.
    OnEnd,
    /// At this time, seconds since 1970.
    At(u64),
    /// When an operator allows more.
    OnRaise,
}

impl fmt::Display for Frees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OnDelete => f.write_str("deleting a scene frees what it takes, removing views what they take"),
            Self::OnEnd => f.write_str("it frees when a training ends or is cancelled"),
            Self::At(time) => write!(f, "it frees at {time} (seconds since 1970)"),
            Self::OnRaise => f.write_str("it does not free by itself; an operator can raise it (cairn access quota)"),
        }
    }
}

/// A quota that does not allow it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the owner's quota `{kind}` is {limit}: {used} used, {needed} more asked for; {frees}")]
pub struct QuotaError {
    /// Which.
    pub kind: Kind,
    /// How much is allowed.
    pub limit: u64,
    /// How much of it is used.
    pub used: u64,
    /// How much more was asked for.
    pub needed: u64,
    /// When there is room again.
    pub frees: Frees,
}
