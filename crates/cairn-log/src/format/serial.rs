//! How hashes, leaves and lists go through JSON: standard base64, and never more of
//! them than a limit that is known beforehand.

use std::{fmt, marker::PhantomData};

use base64::engine::general_purpose::STANDARD;
use serde::{
    Deserialize, Deserializer, Serializer,
    de::{Error as _, SeqAccess, Visitor},
};

use crate::format::digest::Digest;

/// A hash as base64, for `#[serde(with = "...")]`.
pub(crate) mod hash {
    use super::{Deserialize as _, Deserializer, Digest, Serializer};
    use serde::de::Error as _;

    pub(crate) fn serialize<S: Serializer>(hash: &Digest, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&hash.to_base64())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Digest, D::Error> {
        Digest::from_base64(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

/// A leaf as base64, for `#[serde(with = "...")]`.
pub(crate) mod leaf {
    use super::{Deserialize as _, Deserializer, STANDARD, Serializer};
    use crate::format::leaf::LEAF_LEN;
    use base64::Engine as _;
    use serde::de::Error as _;

    pub(crate) fn serialize<S: Serializer>(leaf: &[u8; LEAF_LEN], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(leaf))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[u8; LEAF_LEN], D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = STANDARD.decode(&text).map_err(|_| D::Error::custom("a leaf is written as standard base64"))?;
        <[u8; LEAF_LEN]>::try_from(bytes.as_slice())
            .map_err(|_| D::Error::custom(format!("a leaf is {LEAF_LEN} bytes, got {}", bytes.len())))
    }
}

/// Hashes as base64.
pub(crate) fn hashes<S: Serializer>(hashes: &[Digest], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(hashes.iter().map(Digest::to_base64))
}

/// At most `MAX` hashes in base64.
pub(crate) fn hashes_up_to<'de, const MAX: usize, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<Digest>, D::Error> {
    let texts: Vec<String> = up_to::<MAX, _, _>(deserializer)?;
    texts.iter().map(|text| Digest::from_base64(text).map_err(D::Error::custom)).collect()
}

/// At most `MAX` of anything; refused at the first one too many.
pub(crate) fn up_to<'de, const MAX: usize, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    struct UpTo<const MAX: usize, T>(PhantomData<T>);
    impl<'de, const MAX: usize, T: Deserialize<'de>> Visitor<'de> for UpTo<MAX, T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a list of at most {MAX}")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Vec<T>, A::Error> {
            // No allocation ahead: the length is known only once the last one has been read.
            let mut all = Vec::new();
            while let Some(one) = seq.next_element()? {
                if all.len() == MAX {
                    return Err(A::Error::invalid_length(MAX + 1, &self));
                }
                all.push(one);
            }
            Ok(all)
        }
    }
    deserializer.deserialize_seq(UpTo::<MAX, T>(PhantomData))
}

/// A field that may be null and may not be left out.
pub(crate) fn nullable<'de, T: Deserialize<'de>, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Option::deserialize(deserializer)
}
