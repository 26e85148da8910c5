//! C2SP signed notes: a text, a blank line, and signature lines.
//!
//! Go's `golang.org/x/mod/sumdb/note` reads and writes the same bytes. Rules
//! taken over exactly: the text ends at the LAST blank line, so that a text may hold
//! blank lines itself; unknown signers are ignored; a known signer's bad
//! signature condemns the note; a note that nobody known signed is refused.

use std::{fmt, str::FromStr};

use base64::{Engine as _, engine::general_purpose::STANDARD};

use crate::format::{
    digest::{Digest, clip},
    key::{KeyError, OwnerKey, PublicKey, is_secret},
};

/// Type byte of a plain Ed25519 signature.
pub const ED25519: u8 = 0x01;

/// Largest note that is read, in bytes, as in Go's reader.
pub const MAX_NOTE_BYTES: usize = 1_000_000;

/// Most signature lines on one note, as in Go's reader.
pub const MAX_NOTE_SIGNATURES: usize = 100;

const DASH: &str = "\u{2014} ";

/// Why a note, a key name or a vkey is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoteError {
    /// Larger than [`MAX_NOTE_BYTES`].
    #[error("note of {got} bytes, at most {limit} are read", limit = MAX_NOTE_BYTES)]
    TooLarge {
        /// Its size.
        got: usize,
    },
    /// Not of a note's shape.
    #[error("malformed note: {what}")]
    Malformed {
        /// What is wrong, and where.
        what: String,
    },
    /// A name with blanks or `+`, or none.
    #[error("key name {got:?}: expected some text without blanks and without '+'")]
    Name {
        /// The name.
        got: String,
    },
    /// Not a `name+hash+key` line. What it is instead may be a secret, and is not said.
    #[error("verifier key: {what}; expected name+8 hexadecimal digits+base64(type | key)")]
    Vkey {
        /// What is wrong.
        what: String,
    },
    /// A secret, where a verifier key belongs.
    #[error(
        "this is a private key; give the verifier key instead: a log's from `cairn owners vkey`, a witness's from `cairn \
         witness vkey`"
    )]
    PrivateKey,
    /// A signer that the verifier knows, with a signature that does not hold.
    #[error("signature of {name} on the note does not verify")]
    BadSignature {
        /// The signer.
        name: String,
    },
    /// Nobody known signed.
    #[error("no signature of a known signer on the note (expected one by {expected}, it carries {got})")]
    NoneVerified {
        /// The signers that the verifier knows.
        expected: String,
        /// The signers that the note names.
        got: String,
    },
}

/// One signature line, whatever kind of signature it carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoteSignature {
    /// The signer's name.
    pub name: String,
    /// First 4 bytes of SHA-256(name | 0x0A | type | public key).
    pub key_id: [u8; 4],
    /// The signature behind the key id.
    pub signature: Vec<u8>,
}

/// A note as it came, nothing verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// The signed text, with its final newline.
    pub text: String,
    /// The signature lines, in order.
    pub signatures: Vec<NoteSignature>,
}

/// A named key that signature lines of type `KIND` are verified with: a vkey.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verifier<const KIND: u8> {
    name: String,
    key: PublicKey,
}

/// Verifies plain Ed25519 signatures on notes.
pub type NoteVerifier = Verifier<ED25519>;

impl<const KIND: u8> Verifier<KIND> {
    /// A verifier of signatures by `key` under `name`.
    ///
    /// # Errors
    /// [`NoteError::Name`].
    pub fn new(name: &str, key: PublicKey) -> Result<Self, NoteError> {
        check_name(name)?;
        Ok(Self { name: name.to_owned(), key })
    }

    /// The signer's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The signer's key.
    pub fn key(&self) -> &PublicKey {
        &self.key
    }

    /// The key id that its signature lines carry: first 4 bytes of SHA-256(name | 0x0A | `KIND` | public key).
    pub fn key_id(&self) -> [u8; 4] {
        key_id(&self.name, &self.typed_key())
    }

    /// Whether a line claims to be this signer's: same name and key id.
    pub fn claims(&self, line: &NoteSignature) -> bool {
        line.name == self.name && line.key_id == self.key_id()
    }

    /// `KIND | public key`: what key ids and vkeys are made of.
    fn typed_key(&self) -> Vec<u8> {
        [&[KIND], self.key.to_bytes().as_slice()].concat()
    }
}

impl<const KIND: u8> fmt::Display for Verifier<KIND> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}+{}+{}", self.name, hex::encode(self.key_id()), STANDARD.encode(self.typed_key()))
    }
}

impl<const KIND: u8> FromStr for Verifier<KIND> {
    type Err = NoteError;

    fn from_str(vkey: &str) -> Result<Self, NoteError> {
        if is_secret(vkey) {
            return Err(NoteError::PrivateKey);
        }
        let refuse = |what: String| NoteError::Vkey { what };
        let mut parts = vkey.splitn(3, '+');
        let (Some(name), Some(hash), Some(key)) = (parts.next(), parts.next(), parts.next()) else {
            return Err(refuse("not three parts".into()));
        };
        check_name(name).map_err(|_| refuse("a name without blanks comes first".into()))?;
        let mut stated = [0; 4];
        hex::decode_to_slice(hash, &mut stated).map_err(|_| refuse("the key id is not 8 hexadecimal digits".into()))?;
        let typed = STANDARD.decode(key).map_err(|_| refuse("the key is not base64".into()))?;
        if key_id(name, &typed) != stated {
            let computed = hex::encode(key_id(name, &typed));
            return Err(refuse(format!("its key id is {computed}, it states another")));
        }
        let key = match typed.split_first() {
            Some((kind, key)) if *kind == KIND => key,
            other => {
                let got = other.map(|o| o.0);
                let what =
                    format!("key type {got:?} does not fit here, {KIND} does (1 Ed25519, 4 Ed25519 cosignature)");
                return Err(refuse(what));
            }
        };
        let bytes: &[u8; 32] = key.try_into().map_err(|_| refuse(format!("an Ed25519 key of {} bytes", key.len())))?;
        let key = PublicKey::from_bytes(bytes).map_err(|e: KeyError| refuse(e.to_string()))?;
        Ok(Self { name: name.to_owned(), key })
    }
}

impl Note {
    /// A note without signatures yet.
    ///
    /// # Errors
    /// [`NoteError::Malformed`] for text that is empty, does not end in a newline or holds control characters.
    pub fn new(text: String) -> Result<Self, NoteError> {
        check_text(&text)?;
        Ok(Self { text, signatures: Vec::new() })
    }

    /// Adds a plain Ed25519 signature by `key` under `name`.
    ///
    /// # Errors
    /// [`NoteError::Name`].
    pub fn sign(&mut self, name: &str, key: &OwnerKey) -> Result<(), NoteError> {
        let verifier = NoteVerifier::new(name, key.public())?;
        let signature = key.sign(self.text.as_bytes()).to_vec();
        self.signatures.push(NoteSignature { name: name.to_owned(), key_id: verifier.key_id(), signature });
        Ok(())
    }

    /// Reads a note. Verifies nothing.
    ///
    /// # Errors
    /// [`NoteError::TooLarge`], [`NoteError::Malformed`].
    pub fn parse(note: &str) -> Result<Self, NoteError> {
        if note.len() > MAX_NOTE_BYTES {
            return Err(NoteError::TooLarge { got: note.len() });
        }
        let Some(split) = note.rfind("\n\n") else {
            return Err(malformed("no blank line between text and signatures"));
        };
        let (text, lines) = (&note[..=split], &note[split + 2..]);
        check_text(text)?;
        let Some(lines) = lines.strip_suffix('\n') else {
            return Err(malformed("the last signature line does not end in a newline, or there is none"));
        };
        // Counted before one is decoded.
        let count = lines.split('\n').count();
        if count > MAX_NOTE_SIGNATURES {
            return Err(malformed(&format!("{count} signatures, at most {MAX_NOTE_SIGNATURES}")));
        }
        let signatures = lines.split('\n').map(str::parse).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { text: text.to_owned(), signatures })
    }

    /// Verifies under the keys given; tells which of them signed.
    ///
    /// # Errors
    /// [`NoteError::BadSignature`] for a known signer's bad one, [`NoteError::NoneVerified`].
    pub fn verify<'a>(&self, known: &'a [NoteVerifier]) -> Result<Vec<&'a NoteVerifier>, NoteError> {
        let mut signers: Vec<&NoteVerifier> = Vec::new();
        for line in &self.signatures {
            let Some(verifier) = known.iter().find(|v| v.claims(line)) else {
                continue;
            };
            if verifier.key.verify(self.text.as_bytes(), &line.signature).is_err() {
                return Err(NoteError::BadSignature { name: line.name.clone() });
            }
            if !signers.contains(&verifier) {
                signers.push(verifier);
            }
        }
        if signers.is_empty() {
            let list = |names: Vec<&str>| if names.is_empty() { "none".into() } else { names.join(", ") };
            return Err(NoteError::NoneVerified {
                expected: list(known.iter().map(NoteVerifier::name).collect()),
                got: list(self.signatures.iter().map(|s| s.name.as_str()).collect()),
            });
        }
        Ok(signers)
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.text)?;
        self.signatures.iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}

/// The line without its newline.
impl fmt::Display for NoteSignature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let blob = [self.key_id.as_slice(), &self.signature].concat();
        write!(f, "{DASH}{} {}", self.name, STANDARD.encode(blob))
    }
}

impl FromStr for NoteSignature {
    type Err = NoteError;

    fn from_str(line: &str) -> Result<Self, NoteError> {
        let refuse = |what: &str| malformed(&format!("signature line: {what}"));
        let rest = line.strip_prefix(DASH).ok_or_else(|| refuse("does not begin with an em dash and a blank"))?;
        let (name, blob) = rest.split_once(' ').ok_or_else(|| refuse("no blank behind the name"))?;
        check_name(name).map_err(|_| refuse("no name in it"))?;
        let blob = STANDARD.decode(blob).map_err(|_| refuse("not base64"))?;
        let Some((key_id, signature)) = blob.split_first_chunk::<4>() else {
            return Err(refuse("shorter than a key id"));
        };
        if signature.is_empty() {
            return Err(refuse("a key id without a signature"));
        }
        Ok(Self { name: name.to_owned(), key_id: *key_id, signature: signature.to_vec() })
    }
}

/// First 4 bytes of SHA-256(name | 0x0A | type | public key).
pub fn key_id(name: &str, typed_key: &[u8]) -> [u8; 4] {
    let digest = Digest::of_parts(&[name.as_bytes(), b"\n", typed_key]);
    let [a, b, c, d, ..] = *digest.as_bytes();
    [a, b, c, d]
}

/// A signer's name: some text without blanks and without `+`.
///
/// # Errors
/// [`NoteError::Name`].
pub fn check_name(name: &str) -> Result<(), NoteError> {
    if name.is_empty() || name.chars().any(|c| c.is_whitespace() || c.is_control() || c == '+') {
        return Err(NoteError::Name { got: clip(name) });
    }
    Ok(())
}

fn check_text(text: &str) -> Result<(), NoteError> {
    if !text.ends_with('\n') {
        return Err(malformed("the text does not end in a newline"));
    }
    if text.chars().any(|c| c < ' ' && c != '\n') {
        return Err(malformed("the text holds a control character"));
    }
    Ok(())
}

fn malformed(what: &str) -> NoteError {
    NoteError::Malformed { what: what.to_owned() }
}
