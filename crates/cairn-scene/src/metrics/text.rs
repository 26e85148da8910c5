//! How much of a hidden text came back, in characters and in bits: a text that
//! is one bit off in every character has no right character and 7/8 right bits,
//! and only the two figures together tell noise from nonsense.

use serde::{Deserialize, Serialize};

use crate::metrics::answers::Accuracy;
use crate::metrics::error::MetricError;

/// What [`text_accuracy`] counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TextAccuracy {
    /// Right bytes of the text (a character of ASCII is one byte).
    pub characters: Accuracy,
    /// Right bits, eight a byte.
    pub bits: Accuracy,
}

/// Compares a recovered text with the true one, byte by byte in place (no
/// alignment: a hidden text has a fixed length). A byte that is missing or
/// too many counts as wrong, with all of its bits.
///
/// # Errors
/// [`MetricError::Empty`] when the true text has no bytes.
pub fn text_accuracy(recovered: &[u8], truth: &[u8]) -> Result<TextAccuracy, MetricError> {
    if truth.is_empty() {
        return Err(MetricError::Empty { what: "the true text" });
    }
    let asked = recovered.len().max(truth.len()) as u64;
    let pairs = || recovered.iter().zip(truth);
    let right = pairs().filter(|(r, t)| r == t).count() as u64;
    let right_bits = pairs().map(|(r, t)| u64::from((r ^ t).count_zeros())).sum();
    Ok(TextAccuracy {
        characters: Accuracy { right, asked },
        bits: Accuracy { right: right_bits, asked: asked * u64::from(u8::BITS) },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_characters_and_bits() {
        let same = text_accuracy(b"cairn", b"cairn").unwrap();
        assert_eq!((same.characters.share(), same.bits.share()), (Some(1.0), Some(1.0)));
        // 'n' is 0x6e and 'o' 0x6f: one bit apart.
        let near = text_accuracy(b"cairo", b"cairn").unwrap();
        assert_eq!((near.characters.right, near.bits.right, near.bits.asked), (4, 39, 40));
    }

    #[test]
    fn length_is_part_of_being_right() {
        let short = text_accuracy(b"cai", b"cairn").unwrap();
        assert_eq!((short.characters.right, short.characters.asked, short.bits.right), (3, 5, 24));
        let long = text_accuracy(b"cairns", b"cairn").unwrap();
        assert_eq!((long.characters.right, long.characters.asked), (5, 6));
        assert_eq!(text_accuracy(b"", b""), Err(MetricError::Empty { what: "the true text" }));
    }
}
