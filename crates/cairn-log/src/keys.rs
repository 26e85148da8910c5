//! Key files: plain, sealed by a passphrase, or sealed by a key file; all readable by their owner alone.
//!
//! Where a passphrase comes from is the caller's business (a terminal, a file), but never the environment: child
//! processes inherit that, and the system shows it.

use std::{
    fmt, fs,
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use zeroize::Zeroizing;

use crate::format::{
    cosignature::WitnessVerifier,
    key::{KeyError, OwnerKey, PLAIN, PublicKey, is_secret},
    note::NoteVerifier,
    sealed::{BEGIN, MAX_TEXT, Passphrase, SealError, SealedBy, SealedKey, SealingKey, Secret},
};

/// What a secret's file is to hold.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// An owner's key.
    Key,
    /// A passphrase.
    Passphrase,
    /// A key file to seal keys with.
    SealingKey,
}

impl Kind {
    /// It, in words.
    const fn name(self) -> &'static str {
        match self {
            Self::Key => PLAIN,
            Self::Passphrase => "a passphrase",
            Self::SealingKey => "a key file to seal keys with (made by `cairn keys new-key-file`)",
        }
    }

    /// What makes such a file.
    const fn remedy(self) -> &'static str {
        match self {
            Self::Key => "is the path right? `cairn keys new` makes a key",
            Self::Passphrase => "write the passphrase into it, one line that you alone may read",
            Self::SealingKey => "`cairn keys new-key-file` makes one",
        }
    }
}

/// Why a key file cannot be read, opened or written.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
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
    /// There is no such file.
    #[error("{path}: there is no such file; {remedy}", path = .path.display())]
    Missing {
        /// Where it should be.
        path: PathBuf,
        /// What makes one.
        remedy: &'static str,
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
    /// The key is sealed, and nothing was given to open it.
    #[error("{path}: the key in it is sealed by {by}; {}", .by.remedy(), path = .path.display())]
    Sealed {
        /// The key's file.
        path: PathBuf,
        /// What with.
        by: SealedBy,
    },
    /// The key is plain, and a secret was given to open it.
    #[error(
        "{path}: the key in it is not sealed; seal it (`cairn keys seal`), or give neither passphrase nor key file",
        path = .path.display()
    )]
    NotSealed {
        /// The key's file.
        path: PathBuf,
    },
    /// The passphrase could not be asked for.
    #[error("{path}: cannot ask for the passphrase ({cause}); give it in a file (--passphrase-file)", path = .path.display())]
    Ask {
        /// The key's file.
        path: PathBuf,
        /// Why not.
        cause: String,
    },
    /// A sealed key is damaged, or does not open.
    #[error("{path}: {error}", path = .path.display())]
    Seal {
        /// The key's file.
        path: PathBuf,
        /// What is wrong.
        error: SealError,
    },
    /// A key or a passphrase is wrong in itself.
    #[error(transparent)]
    Key(#[from] KeyError),
}

/// How a key goes into its file.
#[derive(Debug)]
pub enum Seal {
    /// As plain PKCS#8 PEM.
    Plain,
    /// Sealed by a passphrase.
    Passphrase(Passphrase),
    /// Sealed by a key file.
    KeyFile(SealingKey),
}

impl Seal {
    fn text(&self, key: &OwnerKey, path: &Path) -> Result<Zeroizing<String>, KeyFileError> {
        let secret = match self {
            Self::Plain => return Ok(key.to_pem()?),
            Self::Passphrase(passphrase) => Secret::Passphrase(passphrase),
            Self::KeyFile(key) => Secret::KeyFile(key),
        };
        Ok(Zeroizing::new(SealedKey::seal(key, secret).map_err(sealing(path))?.to_text()))
    }
}

/// Asks a person for the passphrase of the file named.
pub type Ask<'a> = dyn Fn(&Path) -> Result<Passphrase, KeyFileError> + 'a;

/// What a key's file is opened with.
pub enum Unlock<'a> {
    /// Nothing: only a plain key opens.
    Nothing,
    /// A passphrase; a key that it does not seal is refused.
    Passphrase(Passphrase),
    /// A key file; a key that it does not seal is refused.
    KeyFile(SealingKey),
    /// A plain key opens as it is; for one sealed by a passphrase, that is asked for.
    Ask(&'a Ask<'a>),
}

impl fmt::Debug for Unlock<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nothing => "Nothing",
            Self::Passphrase(_) => "Passphrase(secret)",
            Self::KeyFile(_) => "KeyFile(secret)",
            Self::Ask(_) => "Ask",
        })
    }
}

/// A key's file, read and not opened.
#[derive(Debug)]
pub enum StoredKey {
    /// Plain PKCS#8 PEM.
    Plain(OwnerKey),
    /// Sealed.
    Sealed(SealedKey),
}

impl StoredKey {
    /// Reads a key's file of any kind.
    ///
    /// # Errors
    /// [`KeyFileError::TooOpen`], [`KeyFileError::NotAKey`], [`KeyFileError::Seal`], [`KeyFileError::Io`].
    pub fn read(path: &Path) -> Result<Self, KeyFileError> {
        let Read { text, open_to_others } = read(path, Kind::Key)?;
        if text.starts_with(BEGIN) {
            return SealedKey::parse(&text).map(Self::Sealed).map_err(sealing(path));
        }
        let plain = OwnerKey::from_pem(&text).map_err(|e| {
            let line = text.trim();
            if line.parse::<NoteVerifier>().is_ok() || line.parse::<WitnessVerifier>().is_ok() {
                let cause = "it is a verifier key (vkey), the public half".to_owned();
                return KeyFileError::NotAKey { path: path.into(), what: PLAIN, cause };
            }
            let cause = if let KeyError::Pem { cause } = e { cause } else { e.to_string() };
            KeyFileError::NotAKey { path: path.into(), what: PLAIN, cause }
        })?;
        // What reads as a key is one, whatever its text looked like.
        must_be_private(path, open_to_others)?;
        Ok(Self::Plain(plain))
    }

    /// The public half. Of a sealed key it is what the file states, certain only once opened.
    pub fn public(&self) -> PublicKey {
        match self {
            Self::Plain(key) => key.public(),
            Self::Sealed(sealed) => sealed.public(),
        }
    }

    /// What it is sealed with; nothing for a plain key.
    pub const fn sealed_by(&self) -> Option<SealedBy> {
        match self {
            Self::Plain(_) => None,
            Self::Sealed(sealed) => Some(sealed.by()),
        }
    }
}

/// Reads and opens the key in the file `path`.
///
/// # Errors
/// As [`StoredKey::read`]; [`KeyFileError::Sealed`] where nothing was brought to open it, [`KeyFileError::NotSealed`] where
/// something was and the key is plain, [`KeyFileError::Seal`] where it does not open.
pub fn load_key(path: &Path, unlock: &Unlock<'_>) -> Result<OwnerKey, KeyFileError> {
    let sealed = match (StoredKey::read(path)?, unlock) {
        (StoredKey::Plain(key), Unlock::Nothing | Unlock::Ask(_)) => return Ok(key),
        (StoredKey::Plain(_), _) => return Err(KeyFileError::NotSealed { path: path.into() }),
        (StoredKey::Sealed(sealed), _) => sealed,
    };
    let asked;
    let secret = match (unlock, sealed.by()) {
        (Unlock::Passphrase(passphrase), _) => Secret::Passphrase(passphrase),
        (Unlock::KeyFile(key), _) => Secret::KeyFile(key),
        (Unlock::Ask(ask), SealedBy::Passphrase(_)) => {
            asked = ask(path)?;
            Secret::Passphrase(&asked)
        }
        (Unlock::Nothing | Unlock::Ask(_), by) => return Err(KeyFileError::Sealed { path: path.into(), by }),
    };
    sealed.open(secret).map_err(sealing(path))
}

/// Writes a key to a new file, mode 600, whole or not at all; one that is there is never replaced.
///
/// # Errors
/// [`KeyFileError::Exists`], [`KeyFileError::Io`], [`KeyFileError::Seal`].
pub fn save_key(path: &Path, key: &OwnerKey, seal: &Seal) -> Result<(), KeyFileError> {
    write(path, &seal.text(key, path)?, There::Stays)
}

/// Replaces a key's file by the same key in another seal, at one stroke: at every moment one of the two is there, whole.
///
/// The disk may keep the old file's bytes where no name leads any more; who must be sure makes a new key and rotates.
///
/// # Errors
/// [`KeyFileError::Io`], [`KeyFileError::Seal`].
pub fn reseal_key(path: &Path, key: &OwnerKey, seal: &Seal) -> Result<(), KeyFileError> {
    write(path, &seal.text(key, path)?, There::Goes)
}

/// Reads a passphrase that opens a key. Its file is private to its owner and has one line, whose end does not count.
///
/// # Errors
/// [`KeyFileError::TooOpen`], [`KeyFileError::Io`], [`KeyFileError::NotAKey`].
pub fn load_passphrase(path: &Path) -> Result<Passphrase, KeyFileError> {
    let line = passphrase_line(path)?;
    if line.chars().any(char::is_control) {
        let cause = "it has control characters or more than one line".to_owned();
        return Err(KeyFileError::NotAKey { path: path.into(), what: Kind::Passphrase.name(), cause });
    }
    Ok(Passphrase::typed(line))
}

/// As [`load_passphrase`], of one to seal a key with.
///
/// # Errors
/// As [`load_passphrase`]; [`KeyError::Passphrase`] where it is too short or too long.
pub fn load_new_passphrase(path: &Path) -> Result<Passphrase, KeyFileError> {
    Ok(Passphrase::new(passphrase_line(path)?)?)
}

fn passphrase_line(path: &Path) -> Result<Zeroizing<String>, KeyFileError> {
    let text = read(path, Kind::Passphrase)?.text;
    let line = text.strip_suffix('\n').unwrap_or(&text);
    let line = line.strip_suffix('\r').unwrap_or(line);
    Ok(Zeroizing::new(line.to_owned()))
}

/// Reads a key file that keys are sealed with.
///
/// # Errors
/// [`KeyFileError::TooOpen`], [`KeyFileError::NotAKey`], [`KeyFileError::Io`].
pub fn load_sealing_key(path: &Path) -> Result<SealingKey, KeyFileError> {
    let not =
        |cause: &str| KeyFileError::NotAKey { path: path.into(), what: Kind::SealingKey.name(), cause: cause.into() };
    let Read { text, open_to_others } = read(path, Kind::SealingKey)?;
    let key = SealingKey::parse(&text).map_err(not)?;
    must_be_private(path, open_to_others)?;
    Ok(key)
}

/// Writes a key file to seal keys with, mode 600; one that is there is never replaced.
///
/// # Errors
/// [`KeyFileError::Exists`], [`KeyFileError::Io`].
pub fn save_sealing_key(path: &Path, key: &SealingKey) -> Result<(), KeyFileError> {
    write(path, &key.to_text(), There::Stays)
}

/// A sealing error, in the file `path`.
fn sealing(path: &Path) -> impl FnOnce(SealError) -> KeyFileError {
    move |error| KeyFileError::Seal { path: path.into(), error }
}

/// A file's text, and its permission bits where others may read it or write to it.
struct Read {
    text: Zeroizing<String>,
    open_to_others: Option<u32>,
}

/// Refuses a secret's file that others may read.
fn must_be_private(path: &Path, open_to_others: Option<u32>) -> Result<(), KeyFileError> {
    match open_to_others {
        Some(mode) => Err(KeyFileError::TooOpen { path: path.into(), mode }),
        None => Ok(()),
    }
}

/// Reads a secret's file as text; refuses one that others may read. Where a file does not look like a secret, the caller
/// judges its mode once it is parsed.
///
/// `kind` is what a wrong file is not, for the error.
fn read(path: &Path, kind: Kind) -> Result<Read, KeyFileError> {
    let failed = |source| KeyFileError::Io { path: path.into(), what: "read", source };
    let file = fs::File::open(path).map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => KeyFileError::Missing { path: path.into(), remedy: kind.remedy() },
        _ => failed(e),
    })?;
    let open_to_others = cairn_durable::open_to_others(&file).map_err(failed)?;
    let not = |cause: String| KeyFileError::NotAKey { path: path.into(), what: kind.name(), cause };
    // As large as it can get: a vector that grows leaves copies behind. What the file says of its size is not asked, since
    // a pipe says nothing.
    let mut bytes = Zeroizing::new(Vec::with_capacity(MAX_TEXT as usize + 1));
    file.take(MAX_TEXT + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > MAX_TEXT {
        return Err(not(format!("more than {MAX_TEXT} bytes")));
    }
    match String::from_utf8(std::mem::take(&mut *bytes)) {
        Ok(text) => {
            let text = Zeroizing::new(text);
            must_be_private(path, open_to_others.filter(|_| kind == Kind::Passphrase || is_secret(&text)))?;
            Ok(Read { text, open_to_others })
        }
        Err(e) => {
            drop(Zeroizing::new(e.into_bytes()));
            Err(not("it is no text".into()))
        }
    }
}

/// What becomes of a file that is there already.
#[derive(Clone, Copy, PartialEq, Eq)]
enum There {
    /// It stays, and the write fails.
    Stays,
    /// It is replaced at one stroke.
    Goes,
}

/// Writes a secret's file, mode 600, whole or not at all, and durable on return.
fn write(path: &Path, text: &str, there: There) -> Result<(), KeyFileError> {
    let written = match there {
        There::Stays => cairn_durable::create_secret(path, text.as_bytes()),
        There::Goes => cairn_durable::write_secret(path, text.as_bytes()),
    };
    written.map_err(|error| match error.into_cause() {
        e if e.kind() == io::ErrorKind::AlreadyExists => KeyFileError::Exists { path: path.into() },
        source => KeyFileError::Io { path: path.into(), what: "write", source },
    })
}
