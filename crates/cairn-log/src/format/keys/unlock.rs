//! What keys are sealed with, and key files as a whole: plain, sealed by a passphrase, or sealed by a key file.
//!
//! Where a passphrase comes from is the caller's business (a terminal, a file), but never the environment: that is
//! inherited, and shown by the system.

use std::{fmt, path::Path};

use zeroize::Zeroizing;

use super::{
    KeyError, OwnerKey, PublicKey,
    file::{self, There},
    sealed::{SealedBy, SealedKey, Secret},
};

/// A passphrase: 8 (NIST SP 800-63B, 5.1.1) to 1024 characters on one line. Wiped when dropped, never printed.
#[derive(Clone)]
pub struct Passphrase(Zeroizing<String>);

impl Passphrase {
    /// Takes it as typed.
    ///
    /// # Errors
    /// [`KeyError::Passphrase`] where it is too short, too long or not one line.
    pub fn new(text: Zeroizing<String>) -> Result<Self, KeyError> {
        let characters = text.chars().count();
        if !(8..=1024).contains(&characters) {
            return Err(KeyError::Passphrase("it has fewer than 8 or more than 1024 characters"));
        }
        if text.chars().any(char::is_control) {
            return Err(KeyError::Passphrase("it has control characters or more than one line"));
        }
        Ok(Self(text))
    }

    /// Reads it from a file that nobody else may read: one line, its end not counting.
    ///
    /// # Errors
    /// [`KeyError::TooOpen`], [`KeyError::Io`], [`KeyError::NotAKey`], [`KeyError::Passphrase`].
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let text = file::read(path, "a passphrase")?;
        let line = text.strip_suffix('\n').unwrap_or(&text);
        let line = line.strip_suffix('\r').unwrap_or(line);
        Self::new(Zeroizing::new(line.to_owned()))
    }

    pub(super) fn bytes(&self) -> &[u8] {
        self.0.as_bytes()
    }
}

impl PartialEq for Passphrase {
    /// For what was typed twice; takes its time from the text.
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Passphrase(secret)")
    }
}

/// The 32 random bytes that keys are sealed with where nobody is there to type: a service's, kept apart from the keys.
/// Wiped when dropped, never printed.
#[derive(Clone)]
pub struct SealingKey(Zeroizing<[u8; 32]>);

/// What a file of it begins with: kind and format version.
const SEALING_KEY: &str = "cairn-key-file-v1 ";

impl SealingKey {
    /// A new one from the operating system's random numbers.
    ///
    /// # Errors
    /// [`KeyError::Random`] where the system has none to give.
    pub fn generate() -> Result<Self, KeyError> {
        let mut bytes = Zeroizing::new([0; 32]);
        getrandom::fill(bytes.as_mut()).map_err(|e| KeyError::Random(e.to_string()))?;
        Ok(Self(bytes))
    }

    /// Writes it to a new file, mode 600: `cairn-key-file-v1 ` and 64 hexadecimal digits.
    ///
    /// # Errors
    /// [`KeyError::Exists`] or [`KeyError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), KeyError> {
        let digits = Zeroizing::new(hex::encode(self.0.as_ref()));
        let text = Zeroizing::new([SEALING_KEY, digits.as_str(), "\n"].concat());
        file::write(path, &text, There::Stays)
    }

    /// Reads such a file.
    ///
    /// # Errors
    /// [`KeyError::TooOpen`], [`KeyError::NotAKey`], [`KeyError::Io`].
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let what = "a key file to seal keys with (made by `cairn keys new-key-file`)";
        let not = |cause: &str| KeyError::NotAKey { path: path.into(), what, cause: cause.into() };
        let text = file::read(path, what)?;
        let digits = text.strip_prefix(SEALING_KEY).and_then(|t| t.strip_suffix('\n'));
        let digits = digits.ok_or_else(|| not("it does not begin with `cairn-key-file-v1`"))?;
        let mut bytes = Zeroizing::new([0; 32]);
        hex::decode_to_slice(digits, bytes.as_mut()).map_err(|_| not("64 hexadecimal digits are expected"))?;
        Ok(Self(bytes))
    }

    pub(super) const fn bytes(&self) -> &Zeroizing<[u8; 32]> {
        &self.0
    }
}

impl fmt::Debug for SealingKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SealingKey(secret)")
    }
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
    fn text(&self, key: &OwnerKey) -> Result<Zeroizing<String>, KeyError> {
        let secret = match self {
            Self::Plain => return key.to_pem(),
            Self::Passphrase(passphrase) => Secret::Passphrase(passphrase),
            Self::KeyFile(key) => Secret::KeyFile(key),
        };
        Ok(Zeroizing::new(SealedKey::seal(key, secret)?.to_text()))
    }
}

/// Asks somebody for the passphrase of the file named.
pub type Ask<'a> = dyn Fn(&Path) -> Result<Passphrase, KeyError> + 'a;

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
    /// [`KeyError::TooOpen`], [`KeyError::NotAKey`], [`KeyError::Seal`], [`KeyError::Io`].
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let text = file::read(path, super::owner::PLAIN)?;
        if text.starts_with(file::SEALED) {
            let sealed = SealedKey::parse(&text).map_err(|error| KeyError::Seal { path: path.into(), error })?;
            return Ok(Self::Sealed(sealed));
        }
        OwnerKey::from_pem(&text).map(Self::Plain).map_err(|e| e.at(path))
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
/// As [`StoredKey::read`]; [`KeyError::Sealed`] where nothing was brought to open it, [`KeyError::NotSealed`] where
/// something was and the key is plain, [`KeyError::Seal`] where it does not open.
pub fn load_key(path: &Path, unlock: &Unlock<'_>) -> Result<OwnerKey, KeyError> {
    let sealed = match (StoredKey::read(path)?, unlock) {
        (StoredKey::Plain(key), Unlock::Nothing | Unlock::Ask(_)) => return Ok(key),
        (StoredKey::Plain(_), _) => return Err(KeyError::NotSealed { path: path.into() }),
        (StoredKey::Sealed(sealed), _) => sealed,
    };
    let asked;
    let secret = match (unlock, sealed.by()) {
        (Unlock::Passphrase(passphrase), _) => Secret::Passphrase(passphrase),
        (Unlock::KeyFile(key), _) => Secret::KeyFile(key),
        (Unlock::Ask(ask), SealedBy::Passphrase { .. }) => {
            asked = ask(path)?;
            Secret::Passphrase(&asked)
        }
        (Unlock::Nothing | Unlock::Ask(_), by) => {
            let by = if by == SealedBy::KeyFile { "key file" } else { "passphrase" };
            return Err(KeyError::Sealed { path: path.into(), by });
        }
    };
    sealed.open(secret).map_err(|error| KeyError::Seal { path: path.into(), error })
}

/// Writes a key to a new file, mode 600, whole or not at all; one that is there is never replaced.
///
/// # Errors
/// [`KeyError::Exists`], [`KeyError::Io`], [`KeyError::Random`], [`KeyError::Seal`].
pub fn save_key(path: &Path, key: &OwnerKey, seal: &Seal) -> Result<(), KeyError> {
    file::write(path, &seal.text(key)?, There::Stays).map_err(|e| e.at(path))
}

/// Replaces a key's file by the same key in another seal, at one stroke: at every moment one of the two is there, whole.
///
/// The disk may keep the old file's bytes where no name leads any more; who must be sure makes a new key and rotates.
///
/// # Errors
/// [`KeyError::Io`], [`KeyError::Random`], [`KeyError::Seal`].
pub fn reseal_key(path: &Path, key: &OwnerKey, seal: &Seal) -> Result<(), KeyError> {
    file::write(path, &seal.text(key)?, There::Goes).map_err(|e| e.at(path))
}
