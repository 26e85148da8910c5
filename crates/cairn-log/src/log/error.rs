//! Everything that the registry can refuse or fail at, one variant a case, so
//! that an edge can map each to its own status without a catch-all.

use std::path::PathBuf;

use cairn_durable::DurableError;

use crate::{
    format::{
        answer::AnswerGap,
        digest::Digest,
        key::{KeyError, PublicKey},
        merkle::ProofError,
        note::NoteError,
        packs::PackError,
        record::RecordError,
    },
    log::{map::MapError, store::StoreError},
};

/// What the registry can refuse or fail at.
#[derive(Debug, thiserror::Error)]
pub enum RegistryError {
    /// The envelope or the record in it is malformed, of an unknown type or version, or not signed by its owner.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The record, or a checkpoint, is another log's.
    #[error("meant for log {got:?}, this is {expected:?}; sign it again for this log")]
    WrongOrigin {
        /// This log.
        expected: String,
        /// The log that it names.
        got: String,
    },
    /// The nonce was not issued by this registry for this scene and owner.
    #[error("nonce {nonce} was not issued here for scene {scene:?} and this owner; ask for a nonce and sign again")]
    NonceForeign {
        /// The record's nonce.
        nonce: Digest,
        /// The record's scene.
        scene: String,
    },
    /// The nonce was used by another record.
    #[error("nonce {nonce} was used by record {index}; ask for a new nonce and sign again")]
    NonceUsed {
        /// The record's nonce.
        nonce: Digest,
        /// The record that used it; where it stands in the same batch, the index that it gets.
        index: u64,
    },
    /// The nonce is too old.
    #[error("nonce issued at log size {issued} is no longer good at size {size}; ask for a new nonce and sign again")]
    NonceExpired {
        /// Log size when it was issued.
        issued: u64,
        /// Log size now.
        size: u64,
    },
    /// The checkpoint that the signer saw is none of this log's.
    #[error(
        "the record's checkpoint (size {size}, root {root}) is none of this log; fetch the checkpoint and sign again"
    )]
    SeenForeign {
        /// Its size.
        size: u64,
        /// Its root.
        root: Digest,
    },
    /// The record named in `replaces` is not in the log.
    #[error("the record {replaces} named in `replaces` is not in this log")]
    ReplacesUnknown {
        /// Its digest.
        replaces: Digest,
    },
    /// The record named in `replaces` is another owner's, and that owner did not sign.
    #[error("the record {replaces} named in `replaces` belongs to {owner}, who did not sign this one")]
    ReplacesForeign {
        /// Its digest.
        replaces: Digest,
        /// Its owner, or after rotations the key in that one's place.
        owner: PublicKey,
    },
    /// Another key took the owner's key's place.
    #[error("key {owner} was rotated by record {index}; sign with the key that follows it")]
    OwnerRotated {
        /// The key.
        owner: String,
        /// The rotation; where it stands in the same batch, the index that it gets.
        index: u64,
    },
    /// The owner's key was revoked.
    #[error(
        "key {owner} was revoked by record {index}, and no key follows it; make a new one (`cairn keys new`), which signs for \
         itself"
    )]
    OwnerRevoked {
        /// The key.
        owner: String,
        /// The revocation; where it stands in the same batch, the index that it gets.
        index: u64,
    },
    /// The record named in `replaces` belongs to a key that was revoked.
    #[error(
        "the record {replaces} named in `replaces` belongs to the key with id {owner}, which record {index} revoked. \
         It can no longer be replaced or taken back"
    )]
    ReplacesRevoked {
        /// Its digest.
        replaces: Digest,
        /// Id of its owner's key, or of the one that rotations put in its place.
        owner: Digest,
        /// What ended that key.
        index: u64,
    },
    /// No such record.
    #[error("no record {index}, the log holds {size}")]
    NoSuchRecord {
        /// The index asked for.
        index: u64,
        /// The log's size.
        size: u64,
    },
    /// A map leaf stands there, which is the registry's own.
    #[error("log entry {index} is a map leaf, not a record; ask for one of the records before it")]
    NotARecord {
        /// The index asked for.
        index: u64,
    },
    /// The record was erased at its owner's wish.
    #[error("record {index} was erased; its leaf and every proof of it stay, its contents do not")]
    Erased {
        /// The index asked for.
        index: u64,
    },
    /// No such proof.
    #[error("cannot prove that: {0}")]
    Proof(#[from] ProofError),
    /// Another process or handle writes to this store.
    #[error("{path}: the store is in use by process {pid}; stop it, or use another folder", path = .path.display())]
    Locked {
        /// The lock file.
        path: PathBuf,
        /// Who holds it.
        pid: String,
    },
    /// The store belongs to another log, key or format version.
    #[error(
        "store: {what} is {got:?}, expected {expected:?}; open it with the settings that it was made with, or, where it is an \
         earlier release's format, move its working folder away and run `cairn registry rebuild`"
    )]
    WrongStore {
        /// `format`, `origin` or `registry key`.
        what: &'static str,
        /// What was asked for.
        expected: String,
        /// What the store says.
        got: String,
    },
    /// The store contradicts what was signed, or itself.
    #[error(
        "store, {place}: {what}; restore a backup that holds at least the last signed checkpoint, or have the working \
         state made again (`cairn registry rebuild`)"
    )]
    Inconsistent {
        /// The entry.
        place: String,
        /// What is wrong, with expected and got.
        what: String,
    },
    /// The log is older than what its anchor says was signed, or another.
    #[error(
        "the anchor {anchor} says that a checkpoint over {anchored} log entries was signed, the data folder holds {size}: \
         {what}; it was restored from an older backup: restore the newest one, or, where its envelopes are newer than its \
         working folder, have that made again (`cairn registry rebuild`), and never let it go on from an older one"
    )]
    RolledBack {
        /// The anchor's file.
        anchor: String,
        /// The size that was signed, or about to be.
        anchored: u64,
        /// The log's size.
        size: u64,
        /// What does not fit.
        what: String,
    },
    /// A log that is not empty has no anchor.
    #[error(
        "the anchor {anchor} is missing, and the log holds {size} entries; restore the file, or, where the setting is new or \
         the file lost for good, see that the log is the newest (a witness, a follower, a receipt) and run `cairn registry \
         anchor --accept`"
    )]
    AnchorMissing {
        /// The anchor's file.
        anchor: String,
        /// The log's size.
        size: u64,
    },
    /// The anchor cannot be read, or is another log's.
    #[error(
        "the anchor {anchor}: {what}; restore the file, or move it away, see that the log is the newest (a witness, a \
         follower, a receipt) and run `cairn registry anchor --accept`"
    )]
    BadAnchor {
        /// The anchor's file.
        anchor: String,
        /// What is wrong with it.
        what: String,
    },
    /// The stored map contradicts itself.
    #[error("store, map: {0}; restore a backup that holds at least the last signed checkpoint")]
    Map(#[from] MapError),
    /// The working state cannot be made again from what is public.
    #[error("cannot make the working state again: {place}: {what}")]
    Rebuild {
        /// The file or entry.
        place: String,
        /// What is wrong, with expected and got.
        what: String,
    },
    /// A pack of envelopes is damaged.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// The answer would hold too much.
    #[error(transparent)]
    Answer(#[from] AnswerGap),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// An earlier failure leaves open what is on disk, so nothing more is written.
    #[error("the registry stopped writing after a failure ({cause}); repair its cause and start again")]
    Halted {
        /// The failure.
        cause: String,
    },
    /// The registry's key, or no random numbers.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The origin is no key name.
    #[error("origin: {0}")]
    Origin(#[from] NoteError),
}

impl RegistryError {
    /// The failure of a shared write, for one more of those who waited for it.
    pub(super) fn again(&self) -> Self {
        match self {
            Self::Store(e) => Self::Store(e.clone()),
            other => Self::Halted { cause: other.to_string() },
        }
    }
}

impl From<DurableError> for RegistryError {
    fn from(error: DurableError) -> Self {
        match error {
            DurableError::Locked { path, pid } => Self::Locked { path, pid },
            error => Self::Store(error.into()),
        }
    }
}

/// Stored bytes that contradict each other or what was signed.
pub(super) fn inconsistent(place: &str, what: String) -> RegistryError {
    RegistryError::Inconsistent { place: place.to_owned(), what }
}
