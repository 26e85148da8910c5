//! The public half of a key: who signed, and whether they did.
//!
//! Verification is always the strict kind (RFC 8032 without its loopholes), and a [`PublicKey`] of small order cannot
//! exist, since under such a key one signature fits many messages.

use std::{fmt, str::FromStr};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use ed25519_dalek::{Signature, VerifyingKey};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

use super::KeyError;
use crate::digest::{Digest, clip};

/// An Ed25519 public key, canonical and not of small order.
///
/// Kept as its 32 bytes: the decompressed point is six times as large, and errors carry keys.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct PublicKey(pub(super) [u8; 32]);

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

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(self.to_bytes()))
    }
}

impl fmt::Debug for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PublicKey({self})")
    }
}

impl FromStr for PublicKey {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        let digest: Digest = text.parse().map_err(|_| KeyError::Malformed { got: clip(text) })?;
        Self::from_bytes(digest.as_bytes())
    }
}

impl Serialize for PublicKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for PublicKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
