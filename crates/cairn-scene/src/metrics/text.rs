//! How much of a hidden text came back, in characters and in bits: a text that
//! is one bit off in every character has no right character and 7/8 right bits,
//! and only the two figures together tell noise from nonsense.

use crate::metrics::error::MetricError;

/// What [`text_accuracy`] found, in shares from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextAccuracy {
    /// Right bytes of the text (a character of ASCII is one byte).
    pub characters: f64,
    /// Right bits, eight a byte.
    pub bits: f64,
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
    let asked = recovered.len().max(truth.len()) as f64;
    let pairs = || recovered.iter().zip(truth);
    let characters = pairs().filter(|(r, t)| r == t).count() as f64;
    let bits: u32 = pairs().map(|(r, t)| (r ^ t).count_zeros()).sum();
    Ok(TextAccuracy { characters: characters / asked, bits: f64::from(bits) / (asked * f64::from(u8::BITS)) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_characters_and_bits() {
        let same = text_accuracy(b"cairn", b"cairn").unwrap();
        assert_eq!((same.characters, same.bits), (1.0, 1.0));
        // 'n' is 0x6e and 'o' 0x6f: one bit apart.
        let near = text_accuracy(b"cairo", b"cairn").unwrap();
        assert_eq!((near.characters, near.bits), (4.0 / 5.0, 39.0 / 40.0));
    }

    #[test]
    fn length_is_part_of_being_right() {
        let short = text_accuracy(b"cai", b"cairn").unwrap();
        assert_eq!((short.characters, short.bits), (3.0 / 5.0, 24.0 / 40.0));
        let long = text_accuracy(b"cairns", b"cairn").unwrap();
        assert_eq!(long.characters, 5.0 / 6.0);
        assert_eq!(text_accuracy(b"", b""), Err(MetricError::Empty { what: "the true text" }));
    }
}
