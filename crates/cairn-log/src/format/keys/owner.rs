//! The secret half of a key: signs, and is written down only where asked.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use ed25519_dalek::{
    Signer as _, SigningKey,
    pkcs8::{DecodePrivateKey as _, EncodePrivateKey as _, KeypairBytes, spki::der::pem::LineEnding},
};
use zeroize::Zeroizing;

use super::{KeyError, PublicKey, SIGNATURE_LEN, file};
#[cfg(feature = "store")]
use crate::digest::Digest;

/// What a file of a plain key is.
pub(super) const PLAIN: &str = "an Ed25519 private key in PKCS#8 PEM";

/// An Ed25519 signing key, of an owner or of the registry itself. Wiped when dropped.
#[derive(Clone)]
pub struct OwnerKey(SigningKey);

impl OwnerKey {
    /// A new key from the operating system's random numbers.
    ///
    /// # Errors
    /// [`KeyError::Random`] where the system has none to give.
    pub fn generate() -> Result<Self, KeyError> {
        let mut seed = Zeroizing::new([0_u8; 32]);
        getrandom::fill(seed.as_mut()).map_err(|e| KeyError::Random(e.to_string()))?;
        Ok(Self::from_seed(&seed))
    }

    /// The key of a 32-byte secret seed (RFC 8032).
    pub fn from_seed(seed: &[u8; 32]) -> Self {
        Self(SigningKey::from_bytes(seed))
    }

    /// The public half.
    pub fn public(&self) -> PublicKey {
        PublicKey(self.0.verifying_key().to_bytes())
    }

    /// Signs a message (deterministic, RFC 8032).
    pub fn sign(&self, message: &[u8]) -> [u8; SIGNATURE_LEN] {
        self.0.sign(message).to_bytes()
    }

    /// PKCS#8 PEM, as `openssl pkey` reads it (version 1: without the public half).
    ///
    /// # Errors
    /// [`KeyError::NotAKey`] with an empty path where the encoder fails.
    pub fn to_pem(&self) -> Result<Zeroizing<String>, KeyError> {
        let mut pair = KeypairBytes { secret_key: self.0.to_bytes(), public_key: None };
        let pem = pair.to_pkcs8_pem(LineEnding::LF);
        zeroize::Zeroize::zeroize(&mut pair.secret_key);
        pem.map_err(|e| KeyError::NotAKey { path: PathBuf::new(), what: PLAIN, cause: e.to_string() })
    }

    /// Reads PKCS#8 PEM, version 1 or 2.
    ///
    /// # Errors
    /// [`KeyError::NotAKey`] with an empty path.
    pub fn from_pem(pem: &str) -> Result<Self, KeyError> {
        SigningKey::from_pkcs8_pem(pem).map(Self).map_err(|e| KeyError::NotAKey {
            path: PathBuf::new(),
            what: PLAIN,
            cause: e.to_string(),
        })
    }

    /// Writes the key to a new file as plain PEM, readable by its owner alone.
    ///
    /// The file appears whole or not at all, mode 600, and never replaces one that is there.
    ///
    /// # Errors
    /// [`KeyError::Exists`] or [`KeyError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), KeyError> {
        file::write(path, &self.to_pem()?, file::There::Stays)
    }

    /// Reads a key file in plain PEM. For sealed ones: `load_key`.
    ///
    /// # Errors
    /// [`KeyError::TooOpen`] where group or others may read it, [`KeyError::NotAKey`], [`KeyError::Io`].
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let text = file::read(path, PLAIN)?;
        if text.starts_with(file::SEALED) {
            return Err(KeyError::NotAKey { path: path.into(), what: PLAIN, cause: "it is a sealed key".into() });
        }
        Self::from_pem(&text).map_err(|e| e.at(path))
    }

    /// The 32-byte secret seed (RFC 8032).
    #[cfg(feature = "sealed-keys")]
    pub(super) fn seed(&self) -> Zeroizing<[u8; 32]> {
        Zeroizing::new(self.0.to_bytes())
    }

    /// A secret of its own for another purpose, derived from this key.
    #[cfg(feature = "store")]
    pub(crate) fn derive(&self, label: &str) -> Zeroizing<[u8; 32]> {
        let seed = Zeroizing::new(self.0.to_bytes());
        Zeroizing::new(*Digest::of_parts(&[label.as_bytes(), &[0], seed.as_ref()]).as_bytes())
    }
}

impl fmt::Debug for OwnerKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "OwnerKey(secret of {})", self.public())
    }
}
