//! Ed25519 keys of owners, of the registry and of those who verify.
//!
//! Verification and the public half: [`PublicKey`]. The secret half: [`OwnerKey`], wiped from memory when dropped and
//! never printed. On disk a key is plain PEM where that is asked for, and else sealed (`SealedKey`) by a passphrase or
//! by the key in another file (`load_key`, `save_key`); every such file is its owner's alone to read.

mod file;
mod owner;
mod public;
#[cfg(feature = "sealed-keys")]
mod sealed;
#[cfg(feature = "sealed-keys")]
mod unlock;

use std::{
    io,
    path::{Path, PathBuf},
};

pub use owner::OwnerKey;
pub use public::PublicKey;
#[cfg(feature = "sealed-keys")]
pub use sealed::{SealError, SealedBy, SealedKey, Secret};
#[cfg(feature = "sealed-keys")]
pub use unlock::{Ask, Passphrase, Seal, SealingKey, StoredKey, Unlock, load_key, reseal_key, save_key};

/// Bytes of an Ed25519 signature.
pub const SIGNATURE_LEN: usize = 64;

/// What can be wrong with a key, a key file or a signature.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The operating system gave no random bytes.
    #[error("cannot make a key: the operating system gave no random bytes ({0})")]
    Random(String),
    /// The bytes are not a point of the curve, or not its canonical encoding.
    #[error(
        "public key {got} is not a canonical Ed25519 point: 32 bytes, given as 64 hexadecimal digits, are expected"
    )]
    Malformed {
        /// The key, or the start of the text.
        got: String,
    },
    /// The point has small order.
    #[error(
        "public key {got} has small order: one signature under it fits many messages; make a new key with `OwnerKey::generate`"
    )]
    SmallOrder {
        /// The key in hex.
        got: String,
    },
    /// The signature is not one by this key over this message.
    #[error("signature does not verify under key {key}")]
    BadSignature {
        /// The key in hex.
        key: String,
    },
    /// The file is not what it should be.
    #[error("{path}: not {what} ({cause})", path = .path.display())]
    NotAKey {
        /// The file.
        path: PathBuf,
        /// What was expected.
        what: &'static str,
        /// What the reader said; never holds key material.
        cause: String,
    },
    /// Others on this machine could read the secret.
    #[error("{path}: mode {mode:o} lets others read the secret in it, expected 600; run `chmod 600` on it", path = .path.display())]
    TooOpen {
        /// The key file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// A key file is never overwritten.
    #[error("{path}: exists already and is not overwritten; move it away first", path = .path.display())]
    Exists {
        /// The key file.
        path: PathBuf,
    },
    /// Reading or writing failed.
    #[error("{path}: cannot {what} this file: {source}", path = .path.display())]
    Io {
        /// The key file.
        path: PathBuf,
        /// `read` or `write`.
        what: &'static str,
        /// The operating system's answer.
        source: io::Error,
    },
    /// The key is sealed, and nothing was brought to open it.
    #[error(
        "{path}: the key in it is sealed by a {by}; give that (--passphrase-file or --key-file, for a daemon \
         `registry.key_file` in its settings)",
        path = .path.display()
    )]
    Sealed {
        /// The key's file.
        path: PathBuf,
        /// `passphrase` or `key file`.
        by: &'static str,
    },
    /// The key is plain, and a secret was brought to open it.
    #[error(
        "{path}: the key in it is not sealed; seal it (`cairn keys seal`), or give neither passphrase nor key file",
        path = .path.display()
    )]
    NotSealed {
        /// The key's file.
        path: PathBuf,
    },
    /// A passphrase that is none.
    #[error("this passphrase will not do: {0}; take another")]
    Passphrase(&'static str),
    /// Nobody could be asked for the passphrase.
    #[error("{path}: cannot ask for the passphrase ({cause}); give it in a file (--passphrase-file)", path = .path.display())]
    Ask {
        /// The key's file.
        path: PathBuf,
        /// Why not.
        cause: String,
    },
    /// A sealed key is damaged, or does not open.
    #[cfg(feature = "sealed-keys")]
    #[error("{path}: {error}", path = .path.display())]
    Seal {
        /// The key's file.
        path: PathBuf,
        /// What is wrong.
        error: SealError,
    },
}

impl KeyError {
    /// The same error, where it names no file yet, in the file `path`.
    fn at(mut self, path: &Path) -> Self {
        match &mut self {
            Self::NotAKey { path: named, .. } => *named = path.into(),
            #[cfg(feature = "sealed-keys")]
            Self::Seal { path: named, .. } => *named = path.into(),
            _ => {}
        }
        self
    }
}
