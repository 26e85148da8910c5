//! A SHA-256 digest as a type of its own, so that a hash cannot be of any other
//! length once it is past the door.
//!
//! Written as lowercase hex in records and reports, as standard base64 in
//! checkpoints and proofs (what RFC 6962 logs and C2SP notes use).

use std::io::{self, Read};
use std::str::FromStr;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use sha2::{Digest as _, Sha256};

/// 32 bytes of SHA-256.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

/// Why some bytes or text are not a [`Digest`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DigestError {
    /// Not 32 bytes.
    #[error("a SHA-256 digest is 32 bytes, got {got}")]
    Length {
        /// How many bytes there were.
        got: usize,
    },
    /// Not 64 lowercase hexadecimal digits.
    #[error("a SHA-256 digest is written as 64 lowercase hexadecimal digits, got {got:?}")]
    Hex {
        /// The start of the offending text.
        got: String,
    },
    /// Not canonical standard base64.
    #[error("a hash is written as standard base64 with padding, got {got:?}")]
    Base64 {
        /// The start of the offending text.
        got: String,
    },
}

impl Digest {
    /// Length in bytes.
    pub const LEN: usize = 32;

    /// SHA-256 of `bytes`.
    pub fn of(bytes: impl AsRef<[u8]>) -> Self {
        Self::of_parts(&[bytes.as_ref()])
    }

    /// SHA-256 of the parts one after the other, without separators.
    pub fn of_parts(parts: &[&[u8]]) -> Self {
        let mut hasher = Sha256::new();
        for part in parts {
            hasher.update(part);
        }
        Self(hasher.finalize().into())
    }

    /// SHA-256 of all that `reader` has left, read in pieces, and how many bytes that were.
    ///
    /// # Errors
    /// What the reader fails with.
    pub fn of_all(reader: &mut (impl Read + ?Sized)) -> io::Result<(Self, u64)> {
        let (mut hasher, mut size, mut piece) = (Sha256::new(), 0, vec![0; 1 << 16]);
        loop {
            let count = match reader.read(&mut piece) {
                Ok(0) => return Ok((Self(hasher.finalize().into()), size)),
                Ok(count) => count,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
                Err(e) => return Err(e),
            };
            hasher.update(&piece[..count]);
            size += count as u64;
        }
    }

    /// Takes 32 bytes as a digest.
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The 32 bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Standard base64 with padding, as in checkpoints.
    pub fn to_base64(&self) -> String {
        STANDARD.encode(self.0)
    }

    /// Reads standard base64 with padding.
    ///
    /// # Errors
    /// [`DigestError`] where the text is not canonical base64 of 32 bytes.
    pub fn from_base64(text: &str) -> Result<Self, DigestError> {
        let bytes = STANDARD.decode(text).map_err(|_| DigestError::Base64 { got: clip(text) })?;
        Self::try_from(bytes.as_slice())
    }
}

/// Salted commitment `SHA-256(label | 0x00 | salt | data)`: says nothing about `data` without the salt.
///
/// `label` separates the uses (it must not hold a zero byte); the salt's fixed length makes the split unambiguous.
pub fn commitment(label: &str, salt: &Digest, data: &[u8]) -> Digest {
    Digest::of_parts(&[label.as_bytes(), &[0], salt.as_bytes(), data])
}

pub(crate) fn clip(text: &str) -> String {
    text.chars().take(80).collect()
}

/// Hashes in base64, a line each.
pub(crate) fn lines(hashes: &[Digest]) -> String {
    hashes.iter().map(|hash| hash.to_base64() + "\n").collect()
}

/// A number in decimal, spelt in the one way that has no leading zeros and no sign.
pub(crate) fn decimal<T: FromStr + ToString>(text: &str) -> Option<T> {
    text.parse::<T>().ok().filter(|number| number.to_string() == text)
}

impl TryFrom<&[u8]> for Digest {
    type Error = DigestError;

    fn try_from(bytes: &[u8]) -> Result<Self, DigestError> {
        bytes.try_into().map(Self).map_err(|_| DigestError::Length { got: bytes.len() })
    }
}

impl FromStr for Digest {
    type Err = DigestError;

    fn from_str(text: &str) -> Result<Self, DigestError> {
        let refuse = || DigestError::Hex { got: clip(text) };
        if text.bytes().any(|b| b.is_ascii_uppercase()) {
            return Err(refuse());
        }
        let mut bytes = [0; 32];
        hex::decode_to_slice(text, &mut bytes).map_err(|_| refuse())?;
        Ok(Self(bytes))
    }
}

/// 32 bytes as text and in JSON: lowercase hexadecimal digits.
macro_rules! as_hex {
    ($type:ident) => {
        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(&hex::encode(self.0))
            }
        }

        impl std::fmt::Debug for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, concat!(stringify!($type), "({})"), self)
            }
        }

        impl serde::Serialize for $type {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> serde::Deserialize<'de> for $type {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = <String as serde::Deserialize>::deserialize(deserializer)?;
                text.parse().map_err(serde::de::Error::custom)
            }
        }
    };
}
pub(crate) use as_hex;

as_hex!(Digest);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_piece_by_piece_has_the_digest_of_the_whole() {
        // More than a piece, and bytes that come before it.
        let bytes: Vec<u8> = (0..200_000u32).map(|i| i as u8).collect();
        let mut reader = bytes.as_slice();
        reader.read_exact(&mut [0; 3]).unwrap();
        assert_eq!(Digest::of_all(&mut reader).unwrap(), (Digest::of(&bytes[3..]), 199_997));
        assert_eq!(Digest::of_all(&mut io::empty()).unwrap(), (Digest::of([]), 0));
    }

    #[test]
    fn known_answer_and_both_spellings() {
        let empty = Digest::of("");
        assert_eq!(empty.to_string(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
        assert_eq!(empty.to_base64(), "47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=");
        assert_eq!(empty.to_string().parse(), Ok(empty));
        assert_eq!(Digest::from_base64(&empty.to_base64()), Ok(empty));
    }

    #[test]
    fn only_one_spelling_is_read() {
        let text = Digest::of("x").to_string();
        assert!(text.to_uppercase().parse::<Digest>().is_err());
        assert!(text[..62].parse::<Digest>().is_err());
        assert_eq!(Digest::try_from(&[0_u8; 31][..]), Err(DigestError::Length { got: 31 }));
        // The last base64 digit of 32 bytes carries two bits that must be zero.
        assert!(Digest::from_base64("47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFV=").is_err());
        assert!(Digest::from_base64("47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU").is_err());
    }

    #[test]
    fn a_commitment_depends_on_label_salt_and_data() {
        let (a, b) = (Digest::of("a"), Digest::of("b"));
        let base = commitment("one", &a, b"data");
        assert_ne!(base, commitment("two", &a, b"data"));
        assert_ne!(base, commitment("one", &b, b"data"));
        assert_ne!(base, commitment("one", &a, b"dato"));
    }
}
