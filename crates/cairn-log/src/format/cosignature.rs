//! Cosignatures (C2SP tlog-cosignature, Ed25519, `cosignature/v1`): a witness says that, at a time, a checkpoint was
//! the largest consistent one of its log that it had seen.
//!
//! ```text
//! cosignature/v1
//! time <unix seconds>
//! <the checkpoint's text>
//! ```
//!
//! is what is signed ("Ed25519 signed message"); the line on the note carries `key id (4) | time u64 big-endian | signature (64)`
//! ("Format"). Its time bounds everything in that tree from above: not later than. The message names no witness, so
//! one key must serve one witness and nothing else; that logs and witnesses have key types of their own keeps a
//! witness's key from passing for a log's.

use crate::format::{
    checkpoint::{Checkpoint, CheckpointError},
    key::{OwnerKey, SIGNATURE_LEN},
    note::{Note, NoteError, NoteSignature, Verifier},
};

/// Type byte of a timestamped Ed25519 cosignature (C2SP signed-note, "Signature types").
pub const COSIGNATURE_V1: u8 = 0x04;

/// Latest time that a cosignature may carry, Unix seconds: 2^63 - 1 (tlog-cosignature, "Format").
pub const MAX_TIME: u64 = (1 << 63) - 1;

const TIME_LEN: usize = 8;

/// Why a cosignature is not made, or refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CosignatureError {
    /// The witness's name.
    #[error(transparent)]
    Note(#[from] NoteError),
    /// What is to be cosigned is no checkpoint.
    #[error("only checkpoints are cosigned: {0}")]
    Checkpoint(#[from] CheckpointError),
    /// A time that a cosignature cannot carry.
    #[error("cosignature of {name} at time {got}, allowed are 1 to {MAX_TIME} seconds since 1970")]
    Time {
        /// The witness.
        name: String,
        /// The time, Unix seconds.
        got: u64,
    },
    /// The line is some other signer's.
    #[error("signature line of {got}, expected one of {expected}")]
    Signer {
        /// The witness, with its key id in hex.
        expected: String,
        /// Who the line names, with key id in hex.
        got: String,
    },
    /// Not a time and a signature.
    #[error("cosignature of {name}: {got} bytes behind the key id, expected 72 (time and Ed25519 signature)")]
    Length {
        /// The witness.
        name: String,
        /// How many bytes.
        got: usize,
    },
    /// The witness did not sign this text at this time.
    #[error("cosignature of {name} at time {time} does not verify")]
    BadSignature {
        /// The witness.
        name: String,
        /// The time that the line states, Unix seconds.
        time: u64,
    },
}

/// Verifies cosignatures of a witness.
pub type WitnessVerifier = Verifier<COSIGNATURE_V1>;

/// A cosignature that was verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cosignature {
    /// The time that it states, Unix seconds, 1 to [`MAX_TIME`].
    pub time: u64,
    /// Its line.
    pub line: NoteSignature,
}

/// Cosigns a checkpoint's text (with its final newline) at `time_unix`, Unix seconds, as the witness `name`.
///
/// # Errors
/// [`CosignatureError::Checkpoint`] for another text, [`CosignatureError::Time`], [`CosignatureError::Note`] for a name that no
/// key may have.
pub fn cosign(note_text: &str, time_unix: u64, name: &str, key: &OwnerKey) -> Result<NoteSignature, CosignatureError> {
    Checkpoint::parse_text(note_text)?;
    let verifier = WitnessVerifier::new(name, key.public())?;
    check_time(name, time_unix)?;
    let signature = key.sign(&message(note_text, time_unix));
    let signature = [time_unix.to_be_bytes().as_slice(), &signature].concat();
    Ok(NoteSignature { name: name.to_owned(), key_id: verifier.key_id(), signature })
}

impl WitnessVerifier {
    /// Verifies one line over a checkpoint's text; gives its time, Unix seconds.
    ///
    /// # Errors
    /// [`CosignatureError`], all but `Note` and `Checkpoint`.
    pub fn verify(&self, note_text: &str, line: &NoteSignature) -> Result<u64, CosignatureError> {
        if !self.claims(line) {
            let signer = |name: &str, id: [u8; 4]| format!("{name} ({})", hex::encode(id));
            return Err(CosignatureError::Signer {
                expected: signer(self.name(), self.key_id()),
                got: signer(&line.name, line.key_id),
            });
        }
        let (time, signature) = match line.signature.split_first_chunk::<TIME_LEN>() {
            Some((time, signature)) if signature.len() == SIGNATURE_LEN => (u64::from_be_bytes(*time), signature),
            _ => return Err(CosignatureError::Length { name: self.name().to_owned(), got: line.signature.len() }),
        };
        check_time(self.name(), time)?;
        let verified = self.key().verify(&message(note_text, time), signature);
        verified.map_err(|_| CosignatureError::BadSignature { name: self.name().to_owned(), time })?;
        Ok(time)
    }

    /// This witness's cosignature on a note, if it carries one; of several, the earliest.
    ///
    /// # Errors
    /// Where a line of this name and key id does not verify: a known signer's bad signature condemns the note.
    pub fn find(&self, note: &Note) -> Result<Option<Cosignature>, CosignatureError> {
        let mut earliest: Option<Cosignature> = None;
        for line in note.signatures.iter().filter(|line| self.claims(line)) {
            let time = self.verify(&note.text, line)?;
            if earliest.as_ref().is_none_or(|found| time < found.time) {
                earliest = Some(Cosignature { time, line: line.clone() });
            }
        }
        Ok(earliest)
    }
}

/// The bytes that a cosignature signs (C2SP tlog-cosignature).
fn message(note_text: &str, time: u64) -> Vec<u8> {
    format!("cosignature/v1\ntime {time}\n{note_text}").into_bytes()
}

/// Zero would be no statement about a time (tlog-witness, "add-checkpoint": the timestamp MUST NOT be zero).
fn check_time(name: &str, time: u64) -> Result<(), CosignatureError> {
    if (1..=MAX_TIME).contains(&time) { Ok(()) } else { Err(CosignatureError::Time { name: name.into(), got: time }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::note::NoteVerifier;

    /// The text of the example in tlog-cosignature.
    const TEXT: &str = "example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n";
    const TIME: u64 = 1_679_315_147;
    const NAME: &str = "witness.example/w1";

    fn key() -> OwnerKey {
        OwnerKey::from_seed(&[7; 32])
    }

    fn verifier() -> WitnessVerifier {
        WitnessVerifier::new(NAME, key().public()).unwrap()
    }

    /// Made with Python's `cryptography` 48.0 and `hashlib`: key of the seed 32 x 0x07; key id
    /// `sha256(name + b"\n\x04" + public)[:4]`; signature over `b"cosignature/v1\ntime 1679315147\n" + text`; line
    /// `base64(id + struct.pack(">Q", time) + signature)`.
    #[test]
    fn known_answer() {
        let line = "\u{2014} witness.example/w1 qkoJ0QAAAABkGFDLWr4Jea05CAgwNVtwky0Jgz6WfX0QJgM//FkB/W9BoT9TX0DkTxG+2cT4p/ViKNhUM/SnUwFcYQzugGFQ15LwDw==";
        let vkey = "witness.example/w1+aa4a09d1+BOpKbGPinFIKvvVQexMuxfmVR3auvr57kkIe6mkURtIs";
        assert_eq!(cosign(TEXT, TIME, NAME, &key()).unwrap().to_string(), line);
        assert_eq!(verifier().to_string(), vkey);
        let read: WitnessVerifier = vkey.parse().unwrap();
        assert_eq!(read.verify(TEXT, &line.parse().unwrap()), Ok(TIME));
    }

    /// A checkpoint of a public log of Certificate Transparency as four public witnesses cosigned it, with the keys that
    /// they publish. Python's `cryptography` verifies all four as well.
    #[test]
    fn witnesses_of_others_verify() {
        let note = Note::parse(
            "arche2025h1.staging.ct.transparency.dev\n1432088532\nU7WM79jrzyhGZ5/GUBTpM7NzwdyfFx61t3RovgcC4Ro=\n\n\
             \u{2014} arche2025h1.staging.ct.transparency.dev ui8GwCF1+kWqZrxGdhj4aX3gcw7XUlXQQabg/27lefwhUkzbC3NygNI75MdhL1bfTW9g8Ei59RA23oHP7Ry1k3ZFWwQ=\n\
             \u{2014} transparency.dev/DEV:witness-little-garden 2AQqhwAAAABqEiEgzgFIqqhbUoDwjMWE6UP8nd8/KYTzwZ2rhIgcqoXHAwVkjZr4AscylP3v7sEodkRAErumC2q44vdgJY096st5BQ==\n\
             \u{2014} witness1.smartit.nu/witness1 pIyCDwAAAABqEiEghIp82KWebrw7/oHQwlTAm3g2RKS4+eebl8eO0WH+/iEcxZ75W3u5hNI7TOQtmJbqmNWVuE0tgh0XwzdZsDsUAQ==\n\
             \u{2014} remora.n621.de 2net5wAAAABqEiEgPlfF3V06o0Y+fHM+J5J9s27wgxxcOVSpZ/2g/KSiXCg9DEZI+aVCIobWX9sXTynk5XeU/zZ0WBxtqB0DrAWfBw==\n\
             \u{2014} witness.stagemole.eu Z/euoAAAAABqEiEgw0i+7g2ENfDAWHmtRzCfKTHSDwYDJA2NmKeGi9Y8FtEyOUvVr+AJmIY/2TUFucgKi7lI7cUiOvKFYe/TmN9DAg==\n",
        )
        .unwrap();
        for vkey in [
            "transparency.dev/DEV:witness-little-garden+d8042a87+BCtusOxINQNUTN5Oj8HObRkh2yHf/MwYaGX4CPdiVEPM",
            "witness1.smartit.nu/witness1+a48c820f+BPSFWg9G6KPiO7QPryYO5Xq4oYJJ+kAvLKLSimDhoxMO",
            "remora.n621.de+da77ade7+BOvN63jn/bLvkieywe8R6UYAtVtNbZpXh34x7onlmtw2",
            "witness.stagemole.eu+67f7aea0+BEqSG3yu9YrmcM3BHvQYTxwFj3uSWakQepafafpUqklv",
        ] {
            let witness: WitnessVerifier = vkey.parse().unwrap();
            assert_eq!(witness.to_string(), vkey);
            assert_eq!(witness.find(&note).unwrap().map(|c| c.time), Some(1_779_573_024), "{vkey}");
            let mut forged = note.clone();
            forged.text = forged.text.replace("1432088532", "1432088533");
            assert!(matches!(witness.find(&forged), Err(CosignatureError::BadSignature { .. })), "{vkey}");
        }
    }

    #[test]
    fn a_line_with_any_bit_flipped_is_refused() {
        let line = cosign(TEXT, TIME, NAME, &key()).unwrap();
        for bit in 0..8 * line.signature.len() {
            let mut other = line.clone();
            other.signature[bit / 8] ^= 1 << (bit % 8);
            assert!(verifier().verify(TEXT, &other).is_err(), "bit {bit}");
        }
        for length in 0..line.signature.len() {
            let short = NoteSignature { signature: line.signature[..length].to_vec(), ..line.clone() };
            assert_eq!(
                verifier().verify(TEXT, &short),
                Err(CosignatureError::Length { name: NAME.into(), got: length })
            );
        }
        let mut long = line.clone();
        long.signature.push(0);
        assert!(matches!(verifier().verify(TEXT, &long), Err(CosignatureError::Length { got: 73, .. })));
        assert!(verifier().verify(&format!("{TEXT}more\n"), &line).is_err(), "extension lines are covered");
    }

    #[test]
    fn times_beyond_the_format_are_neither_made_nor_taken() {
        for time in [0, MAX_TIME + 1, u64::MAX] {
            assert!(matches!(cosign(TEXT, time, NAME, &key()), Err(CosignatureError::Time { .. })));
            // Signed all the same, by somebody who does not care.
            let signature = key().sign(&message(TEXT, time));
            let signature = [time.to_be_bytes().as_slice(), &signature].concat();
            let line = NoteSignature { name: NAME.into(), key_id: verifier().key_id(), signature };
            assert!(matches!(verifier().verify(TEXT, &line), Err(CosignatureError::Time { .. })));
        }
        for time in [1, MAX_TIME] {
            assert_eq!(verifier().verify(TEXT, &cosign(TEXT, time, NAME, &key()).unwrap()), Ok(time));
        }
    }

    #[test]
    fn only_checkpoints_are_cosigned() {
        for text in
            ["", "text\n", "log\n1\n", "log\n01\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n", TEXT.trim_end()]
        {
            assert!(matches!(cosign(text, TIME, NAME, &key()), Err(CosignatureError::Checkpoint(_))), "{text:?}");
        }
        assert!(matches!(cosign(TEXT, TIME, "a b", &key()), Err(CosignatureError::Note(_))));
    }

    #[test]
    fn key_types_do_not_stand_in_for_each_other() {
        let log = NoteVerifier::new(NAME, key().public()).unwrap();
        assert!(matches!(log.to_string().parse::<WitnessVerifier>(), Err(NoteError::Vkey { .. })));
        assert!(matches!(verifier().to_string().parse::<NoteVerifier>(), Err(NoteError::Vkey { .. })));
        // A log's signature by the very same key and name is another line.
        let mut note = Note::new(TEXT.into()).unwrap();
        note.sign(NAME, &key()).unwrap();
        assert_eq!(verifier().find(&note), Ok(None));
        assert!(matches!(verifier().verify(TEXT, &note.signatures[0]), Err(CosignatureError::Signer { .. })));
        note.signatures.push(cosign(TEXT, TIME + 5, NAME, &key()).unwrap());
        note.signatures.push(cosign(TEXT, TIME, NAME, &key()).unwrap());
        assert_eq!(verifier().find(&note).unwrap().unwrap().time, TIME, "the earliest");
        note.verify(&[log]).unwrap();
    }

    #[test]
    fn malformed_vkeys_are_refused() {
        let good = verifier().to_string();
        for vkey in ["", "a", "a+b+c", &good[1..], &good[..good.len() - 4], &good.replace("aa4a09d1", "aa4a09d2")] {
            assert!(vkey.parse::<WitnessVerifier>().is_err(), "{vkey}");
        }
    }
}
