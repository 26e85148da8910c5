//! `.tlog-proof` files (C2SP tlog-proof): that an entry is in a log, checkable offline.
//!
//! ```text
//! c2sp.org/tlog-proof@v1
//! [extra <base64>]
//! index <i>
//! <base64 hash>, one a line
//!
//! <checkpoint with its signatures>
//! ```
//!
//! Together with the DSSE envelope, from which anybody makes the leaf, it is the whole evidence for one record.

use base64::{Engine as _, engine::general_purpose::STANDARD};

use crate::format::digest::{Digest, clip, decimal, lines};

/// First line of the format's version 1.
pub const HEADER: &str = "c2sp.org/tlog-proof@v1";

/// Most hashes in a proof: a tree of 2^63 leaves needs 63.
pub const MAX_HASHES: usize = 64;

/// Evidence that entry `index` is in the tree of a checkpoint; nothing verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlogProof {
    /// Opaque data that nothing vouches for; Cairn writes none.
    pub extra: Option<Vec<u8>>,
    /// The entry's index.
    pub index: u64,
    /// From the leaf's sibling up to the root's child.
    pub hashes: Vec<Digest>,
    /// The checkpoint, a signed note, as it came.
    pub checkpoint: String,
}

/// Why a text is no `.tlog-proof`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("tlog-proof, line {line}: expected {expected}, got {got:?}")]
pub struct TlogProofError {
    /// Which line, from 1.
    pub line: usize,
    /// What is expected there.
    pub expected: &'static str,
    /// The start of the line.
    pub got: String,
}

impl TlogProof {
    /// Reads the text of a `.tlog-proof`. Verifies nothing.
    ///
    /// # Errors
    /// [`TlogProofError`] names the line.
    pub fn parse(text: &str) -> Result<Self, TlogProofError> {
        let refuse = |line: usize, expected: &'static str, got: &str| TlogProofError { line, expected, got: clip(got) };
        let (head, checkpoint) = text.split_once("\n\n").ok_or_else(|| {
            let last = text.lines().last().unwrap_or_default();
            refuse(text.lines().count().max(1), "a blank line before the checkpoint", last)
        })?;
        let mut lines = (1..).zip(head.split('\n')).peekable();
        let (_, header) = lines.next().unwrap_or_default();
        if header != HEADER {
            return Err(refuse(1, HEADER, header));
        }
        let extra = match lines.peek().and_then(|(n, line)| Some((*n, line.strip_prefix("extra ")?))) {
            None => None,
            Some((n, data)) => {
                lines.next();
                Some(STANDARD.decode(data).map_err(|_| refuse(n, "base64 behind `extra`", data))?)
            }
        };
        let (n, line) = lines.next().unwrap_or((if extra.is_some() { 3 } else { 2 }, ""));
        let index = (line.strip_prefix("index "))
            .and_then(decimal)
            .ok_or_else(|| refuse(n, "`index` and a decimal number", line))?;
        let mut hashes = Vec::new();
        for (n, line) in lines {
            if hashes.len() == MAX_HASHES {
                return Err(refuse(n, "at most 64 hashes", line));
            }
            hashes.push(Digest::from_base64(line).map_err(|_| refuse(n, "a hash of 32 bytes in base64", line))?);
        }
        Ok(Self { extra, index, hashes, checkpoint: checkpoint.to_owned() })
    }

    /// The text of the `.tlog-proof`.
    pub fn to_text(&self) -> String {
        let mut text = format!("{HEADER}\n");
        if let Some(extra) = &self.extra {
            text.push_str(&format!("extra {}\n", STANDARD.encode(extra)));
        }
        text.push_str(&format!("index {}\n{}\n{}", self.index, lines(&self.hashes), self.checkpoint));
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proof() -> TlogProof {
        let checkpoint = "log\n5\n47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=\n\n\u{2014} log AAAAAAAA\n".to_owned();
        TlogProof { extra: None, index: 3, hashes: vec![Digest::of("a"), Digest::of("b")], checkpoint }
    }

    #[test]
    fn a_proof_goes_through_its_text() {
        let plain = proof();
        let bare = TlogProof { hashes: vec![], ..proof() };
        let extra = TlogProof { extra: Some(b"more".to_vec()), ..proof() };
        for proof in [plain, bare, extra] {
            assert_eq!(TlogProof::parse(&proof.to_text()), Ok(proof));
        }
        assert!(proof().to_text().starts_with("c2sp.org/tlog-proof@v1\nindex 3\n"));
    }

    #[test]
    fn malformed_proofs_name_the_line() {
        let good = proof().to_text();
        let hash = Digest::of("a").to_base64();
        for (text, line) in [
            (good.replace("@v1", "@v2"), 1),
            (good.replace("index 3", "index 03"), 2),
            (good.replace("index 3", "index -3"), 2),
            (good.replace("index 3", "extra !\nindex 3"), 2),
            (good.replace("index 3", "extra AAAA"), 3),
            (good.replace(&hash, &hash[1..]), 3),
            (good.replacen(&hash, &vec![hash.as_str(); 64].join("\n"), 1), 67),
            ("c2sp.org/tlog-proof@v1\nindex 3\n".into(), 2),
            (String::new(), 1),
            ("c2sp.org/tlog-proof@v1\n\nx".into(), 2),
        ] {
            assert_eq!(TlogProof::parse(&text).map_err(|e| e.line), Err(line), "{text}");
        }
    }
}
