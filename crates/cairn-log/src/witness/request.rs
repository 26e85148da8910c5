//! The body of `add-checkpoint` (C2SP tlog-witness, "add-checkpoint"), for both sides.
//!
//! ```text
//! old <size>
//! <base64 hash>, up to 63
//!
//! <checkpoint>
//! ```

use crate::format::digest::{Digest, decimal, lines};

/// Largest body, bytes: a checkpoint with some tens of signatures, also of large kinds.
pub const MAX_BODY_BYTES: usize = 256 << 10;

/// Most hashes in a consistency proof.
pub const MAX_PROOF_HASHES: usize = 63;

/// What a log asks a witness for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AddCheckpoint {
    /// Size of the checkpoint that the witness cosigned last, as far as the log knows.
    pub old: u64,
    /// Proof that the tree of the checkpoint begins with the tree of size `old`.
    pub proof: Vec<Digest>,
    /// The checkpoint, a signed note; nothing verified.
    pub note: String,
}

/// Why a body is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// Larger than [`MAX_BODY_BYTES`].
    #[error("body of {got} bytes, at most {MAX_BODY_BYTES} are read")]
    TooLarge {
        /// Its size.
        got: usize,
    },
    /// Not of the format.
    #[error("body, line {line}: expected {expected}")]
    Line {
        /// Which line, from 1.
        line: usize,
        /// What is expected there.
        expected: &'static str,
    },
}

impl AddCheckpoint {
    /// Reads a body; the checkpoint in it stays as it came.
    ///
    /// # Errors
    /// [`RequestError`] names the line.
    pub fn parse(body: &[u8]) -> Result<Self, RequestError> {
        if body.len() > MAX_BODY_BYTES {
            return Err(RequestError::TooLarge { got: body.len() });
        }
        let refuse = |line, expected| RequestError::Line { line, expected };
        let text = std::str::from_utf8(body).map_err(|_| refuse(1, "UTF-8"))?;
        let end = "a line that ends in a newline";
        let (first, mut rest) = text.split_once('\n').ok_or_else(|| refuse(1, end))?;
        let old = (first.strip_prefix("old "))
            .and_then(decimal)
            .ok_or_else(|| refuse(1, "`old`, a blank and a size in decimal without leading zeros"))?;
        let mut proof = Vec::new();
        for number in 2.. {
            let (line, behind) = rest.split_once('\n').ok_or_else(|| refuse(number, end))?;
            rest = behind;
            if line.is_empty() {
                break;
            }
            if proof.len() == MAX_PROOF_HASHES {
                return Err(refuse(number, "an empty line behind 63 hashes"));
            }
            let hash = Digest::from_base64(line);
            proof.push(hash.map_err(|_| refuse(number, "a hash of 32 bytes in base64, or an empty line"))?);
        }
        Ok(Self { old, proof, note: rest.to_owned() })
    }

    /// The body.
    pub fn to_body(&self) -> String {
        format!("old {}\n{}\n{}", self.old, lines(&self.proof), self.note)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the specification.
    const EXAMPLE: &str = "old 20852014\n\
        PlRNCrwHpqhGrupue0L7gxbjbMiKA9temvuZZDDpkaw=\n\
        jrJZDmY8Y7SyJE0MWLpLozkIVMSMZcD5kvuKxPC3swk=\n\
        5+pKlUdi2LeF/BcMHBn+Ku6yhPGNCswZZD1X/6QgPd8=\n\
        /6WVhPs2CwSsb5rYBH5cjHV/wSmA79abXAwhXw3Kj/0=\n\
        \n\
        example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n\n\u{2014} signatures\n";

    #[test]
    fn the_example_goes_through() {
        let request = AddCheckpoint::parse(EXAMPLE.as_bytes()).unwrap();
        assert_eq!((request.old, request.proof.len()), (20_852_014, 4));
        assert!(request.note.starts_with("example.com/behind-the-sofa\n20852163\n"));
        assert_eq!(request.to_body(), EXAMPLE);
    }

    #[test]
    fn malformed_bodies_name_the_line() {
        let hashes = |count| format!("old 1\n{}\nnote", format!("{}\n", Digest::of("x").to_base64()).repeat(count));
        assert_eq!(AddCheckpoint::parse(hashes(63).as_bytes()).unwrap().proof.len(), 63);
        for (body, line) in [
            (String::new(), 1),
            ("old 1".into(), 1),
            ("old 01\n\nnote".into(), 1),
            ("old +1\n\nnote".into(), 1),
            ("old -1\n\nnote".into(), 1),
            ("old  1\n\nnote".into(), 1),
            ("old 18446744073709551616\n\nnote".into(), 1),
            ("new 1\n\nnote".into(), 1),
            ("old 1\nhash\n\nnote".into(), 2),
            ("old 1\nAAAA\n\nnote".into(), 2),
            ("old 1\r\n\r\nnote".into(), 1),
            ("old 1\n".into(), 2),
            (hashes(64), 65),
        ] {
            match AddCheckpoint::parse(body.as_bytes()) {
                Err(RequestError::Line { line: got, .. }) => assert_eq!(got, line, "{body:?}"),
                other => panic!("{body:?} gave {other:?}"),
            }
        }
        assert!(AddCheckpoint::parse(b"old 1\n\n\xff").is_err());
        let large = vec![b'\n'; MAX_BODY_BYTES + 1];
        assert_eq!(AddCheckpoint::parse(&large), Err(RequestError::TooLarge { got: large.len() }));
    }
}
