//! Ed25519 keys of owners, of the registry and of verifiers.
//!
//! [`PublicKey`] verifies, always strictly (RFC 8032 without its loopholes). A key of small order cannot exist here:
//! under such a key one signature fits many messages. [`OwnerKey`] signs; it is wiped from memory when dropped and
//! never printed. The module `keys` reads and writes key files.

use std::{fmt, str::FromStr};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use ed25519_dalek::{
    Signature, Signer as _, SigningKey, VerifyingKey,
    pkcs8::{DecodePrivateKey as _, EncodePrivateKey as _, KeypairBytes, spki::der::pem::LineEnding},
};
use zeroize::Zeroizing;

use crate::format::digest::{Digest, as_hex, clip};

/// Bytes of an Ed25519 signature.
pub const SIGNATURE_LEN: usize = 64;

/// What a plain key's text is.
pub const PLAIN: &str = "an Ed25519 private key in PKCS#8 PEM";

/// Whether a text holds a private key, or is a file that keys are sealed with: what no message may quote.
pub fn is_secret(text: &str) -> bool {
    // In any line: readers of PEM pass over what stands before it (RFC 7468, 2).
    let pem = |line: &str| line.contains("-----BEGIN") && (line.contains("PRIVATE") || line.contains("SEALED"));
    let first = text.trim_start();
    text.lines().any(pem)
        || first.starts_with("cairn-key-file-v1 ")
        // As Go's note package writes a signer's key.
        || first.starts_with("PRIVATE+KEY+")
}

/// What can be wrong with a key, a passphrase or a signature.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
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
    /// The text is no plain key.
    #[error("not {what} ({cause})", what = PLAIN)]
    Pem {
        /// What the reader said; never holds key material.
        cause: String,
    },
    /// The text cannot serve as a passphrase.
    #[error("this passphrase will not do: {0}; take another")]
    Passphrase(&'static str),
}

/// An Ed25519 public key, canonical and not of small order.
///
/// Kept as its 32 bytes: the decompressed point is six times as large, and errors carry keys.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct PublicKey([u8; 32]);

impl PublicKey {
    /// Length in bytes.
    pub const LEN: usize = 32;

    /// Takes the 32 bytes of RFC 8032.
    ///
    /// # Errors
    /// [`KeyError::Malformed`] for bytes that are no curve point or not its one canonical encoding,
    /// [`KeyError::SmallOrder`] for the weak points.
    pub fn from_bytes(bytes: &[u8; 32]) -> Result<Self, KeyError> {
        let malformed = || KeyError::Malformed { got: hex::encode(bytes) };
        // y must be below p = 2^255 - 19; decompression alone would reduce it silently.
        let high = bytes[31] & 0x7f == 0x7f && bytes[1..31].iter().all(|b| *b == 0xff);
        if high && bytes[0] >= 0xed {
            return Err(malformed());
        }
        let key = VerifyingKey::from_bytes(bytes).map_err(|_| malformed())?;
        if key.is_weak() {
            return Err(KeyError::SmallOrder { got: hex::encode(bytes) });
        }
        Ok(Self(*bytes))
    }

    /// The 32 bytes of RFC 8032.
    pub const fn to_bytes(&self) -> [u8; 32] {
        self.0
    }

    /// Standard base64 of the 32 bytes.
    pub fn to_base64(&self) -> String {
        STANDARD.encode(self.to_bytes())
    }

    /// Key id: SHA-256 of the 32 bytes. What leaves and DSSE `keyid` hints carry.
    pub fn id(&self) -> Digest {
        Digest::of(self.to_bytes())
    }

    /// Verifies strictly: canonical S, no small-order R, no small-order key.
    ///
    /// # Errors
    /// [`KeyError::BadSignature`], also where the signature is not 64 bytes.
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> Result<(), KeyError> {
        let bad = || KeyError::BadSignature { key: self.to_string() };
        let signature = Signature::from_slice(signature).map_err(|_| bad())?;
        let key = VerifyingKey::from_bytes(&self.0).map_err(|_| bad())?;
        key.verify_strict(message, &signature).map_err(|_| bad())
    }
}

as_hex!(PublicKey);

impl FromStr for PublicKey {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        let digest: Digest = text.parse().map_err(|_| KeyError::Malformed { got: clip(text) })?;
        Self::from_bytes(digest.as_bytes())
    }
}

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
    /// [`KeyError::Pem`] where the encoder fails.
    pub fn to_pem(&self) -> Result<Zeroizing<String>, KeyError> {
        let mut pair = KeypairBytes { secret_key: self.0.to_bytes(), public_key: None };
        let pem = pair.to_pkcs8_pem(LineEnding::LF);
        zeroize::Zeroize::zeroize(&mut pair.secret_key);
        pem.map_err(|e| KeyError::Pem { cause: e.to_string() })
    }

    /// Reads PKCS#8 PEM, version 1 or 2.
    ///
    /// # Errors
    /// [`KeyError::Pem`].
    pub fn from_pem(pem: &str) -> Result<Self, KeyError> {
        SigningKey::from_pkcs8_pem(pem).map(Self).map_err(|e| KeyError::Pem { cause: e.to_string() })
    }

    /// The 32-byte secret seed (RFC 8032).
    #[cfg(feature = "sealed-keys")]
    pub(crate) fn seed(&self) -> Zeroizing<[u8; 32]> {
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
