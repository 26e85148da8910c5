//! A key at rest, sealed: the 32-byte seed under XChaCha20-Poly1305, its key coming from a passphrase by Argon2id
//! (RFC 9106) or being the one in a [`SealingKey`]'s file.
//!
//! ```text
//! -----BEGIN CAIRN SEALED KEY-----
//! Public-Key: <64 hexadecimal digits>
//!
//! <base64, 64 characters a line>
//! -----END CAIRN SEALED KEY-----
//! ```
//!
//! The base64 holds `version 1 | kind of secret`, for a passphrase (1) `memory KiB | passes | lanes` (u32 big-endian
//! each) `| salt 16`, for a key file (2) nothing, then `nonce 24 | ciphertext 48`. The public key stands in clear, so that
//! it can be shown without the secret; it and everything before the ciphertext are bound as additional data. A file has
//! one spelling: what does not re-encode to itself is refused, and so every byte counts.
//!
//! XChaCha20-Poly1305 alone would let a file be made that opens under two secrets; here the opened seed must also be the
//! one of the public key.

use std::fmt;

use argon2::{Algorithm, Argon2, Block, Params, Version};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use chacha20poly1305::{
    Key, KeyInit as _, XChaCha20Poly1305, XNonce,
    aead::{Aead as _, Payload},
};
use zeroize::Zeroizing;

use crate::format::key::{KeyError, OwnerKey, PublicKey};

/// A sealed key's text is shorter than this, bytes.
pub const MAX_TEXT: u64 = 4096;

/// First line of a sealed key's text.
pub const BEGIN: &str = "-----BEGIN CAIRN SEALED KEY-----\n";
const END: &str = "-----END CAIRN SEALED KEY-----\n";
const HEADER: &str = "Public-Key: ";
/// Base64 characters on a line.
const COLUMNS: usize = 64;

const VERSION: u8 = 1;
const BY_PASSPHRASE: u8 = 1;
const BY_KEY_FILE: u8 = 2;

const SALT: usize = 16;
const NONCE: usize = 24;
/// The seed and the Poly1305 tag.
const CIPHERTEXT: usize = 32 + 16;
/// What the additional data begins with, so that nothing else sealed under the same key passes for this.
const LABEL: &[u8] = b"cairn sealed key v1\0";

/// What Argon2id may cost on reading: a file must not make its reader spend more.
const MAX_MEMORY_KIB: u32 = 1 << 20;
const MAX_PASSES: u32 = 16;
const MAX_LANES: u32 = 16;

/// What Argon2id costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Memory, KiB.
    pub memory_kib: u32,
    /// Passes over it.
    pub passes: u32,
    /// Lanes.
    pub lanes: u32,
}

impl Cost {
    /// RFC 9106, section 4, the second recommended option: 64 MiB, 3 passes, 4 lanes.
    const RECOMMENDED: Self = Self { memory_kib: 1 << 16, passes: 3, lanes: 4 };

    fn check(self) -> Result<Self, SealError> {
        let within = |what, got, least, most| {
            if (least..=most).contains(&got) { Ok(()) } else { Err(SealError::Cost { what, got, least, most }) }
        };
        within("passes", self.passes, 1, MAX_PASSES)?;
        within("lanes", self.lanes, 1, MAX_LANES)?;
        // RFC 9106, section 3.1: at least 8 KiB a lane.
        within("memory (KiB)", self.memory_kib, 8 * self.lanes, MAX_MEMORY_KIB)?;
        Ok(self)
    }
}

/// What opens a sealed key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kdf {
    Passphrase { cost: Cost, salt: [u8; SALT] },
    KeyFile,
}

/// What a key is sealed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SealedBy {
    /// By a passphrase, stretched at this cost.
    Passphrase(Cost),
    /// The 32 bytes of a [`SealingKey`]'s file.
    KeyFile,
}

impl SealedBy {
    /// What opens it, in words.
    pub(crate) const fn remedy(&self) -> &'static str {
        match self {
            Self::Passphrase(_) => "give its passphrase (--passphrase-file FILE, or typed at a terminal)",
            Self::KeyFile => {
                "give its key file (--key-file FILE; of an account --account-key-file, of a daemon `registry.key_file` in its \
                 settings)"
            }
        }
    }
}

impl fmt::Display for SealedBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Passphrase(Cost { memory_kib, passes, lanes }) => {
                write!(f, "a passphrase (argon2id, {memory_kib} KiB, {passes} passes, {lanes} lanes)")
            }
            Self::KeyFile => f.write_str("a key file"),
        }
    }
}

/// Why a text is no sealed key, or does not open.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SealError {
    /// Not the format, or not its one spelling.
    #[error("not a sealed key ({0}); restore the file from a backup")]
    Malformed(&'static str),
    /// A format version that this release does not know.
    #[error("sealed key of version {got}, this release reads version {expected}", expected = VERSION)]
    Version {
        /// The version that the file states.
        got: u8,
    },
    /// A kind of secret that this release does not know.
    #[error("sealed by a kind of secret numbered {got}, this release knows 1 (passphrase) and 2 (key file)")]
    Kind {
        /// What the file states.
        got: u8,
    },
    /// Argon2id would cost more, or less, than is allowed.
    #[error("asks Argon2id for {what} = {got}, {least} to {most} are allowed; restore the file from a backup")]
    Cost {
        /// Memory, passes or lanes.
        what: &'static str,
        /// What the file asks for.
        got: u32,
        /// The least.
        least: u32,
        /// The most.
        most: u32,
    },
    /// The secret is not the one, or the file was altered; which, nobody can tell.
    #[error("does not open: {0} is another than it was sealed with, or the file was altered")]
    Wrong(&'static str),
    /// A passphrase was brought for a key sealed by a key file, or the other way round.
    #[error("is sealed by {by}, and {brought} was given; {}", .by.remedy())]
    OtherSecret {
        /// What it is sealed with.
        by: SealedBy,
        /// What was brought.
        brought: &'static str,
    },
    /// The operating system gave no random bytes.
    #[error("cannot seal a key: the operating system gave no random bytes ({0})")]
    Random(String),
    /// Argon2id did not run.
    #[error("cannot run Argon2id ({0}); free some memory and try again")]
    Argon2(String),
}

/// A passphrase; a new one has 8 (NIST SP 800-63B, 5.1.1) to 1024 characters on one line. Wiped when dropped, never printed.
#[derive(Clone)]
pub struct Passphrase(Zeroizing<String>);

impl Passphrase {
    /// One to open with, as typed: whatever it is, whether it is the right one shows when it opens.
    pub const fn typed(text: Zeroizing<String>) -> Self {
        Self(text)
    }

    /// One to seal with from now on.
    ///
    /// # Errors
    /// [`KeyError::Passphrase`] where it is too short, too long or not one line.
    pub fn new(text: Zeroizing<String>) -> Result<Self, KeyError> {
        let characters = text.chars().count();
        if !(8..=1024).contains(&characters) {
            return Err(KeyError::Passphrase("it has fewer than 8 or more than 1024 characters"));
        }
        if text.chars().any(char::is_control) {
            return Err(KeyError::Passphrase("it has control characters or more than one line"));
        }
        Ok(Self(text))
    }
}

impl PartialEq for Passphrase {
    /// For what was typed twice; takes its time from the text.
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Passphrase(secret)")
    }
}

/// The 32 random bytes that keys are sealed with where no person types a passphrase: a service's, kept apart from the keys.
/// Wiped when dropped, never printed.
#[derive(Clone)]
pub struct SealingKey(Zeroizing<[u8; 32]>);

/// What a file of it begins with: kind and format version.
const SEALING_KEY: &str = "cairn-key-file-v1 ";

impl SealingKey {
    /// A new one from the operating system's random numbers.
    ///
    /// # Errors
    /// [`KeyError::Random`] where the system has none to give.
    pub fn generate() -> Result<Self, KeyError> {
        let mut bytes = Zeroizing::new([0; 32]);
        getrandom::fill(bytes.as_mut()).map_err(|e| KeyError::Random(e.to_string()))?;
        Ok(Self(bytes))
    }

    /// The text of its file: `cairn-key-file-v1 ` and 64 hexadecimal digits.
    pub fn to_text(&self) -> Zeroizing<String> {
        let digits = Zeroizing::new(hex::encode(self.0.as_ref()));
        Zeroizing::new([SEALING_KEY, digits.as_str(), "\n"].concat())
    }

    /// Reads that text.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let digits = text.strip_prefix(SEALING_KEY).and_then(|t| t.strip_suffix('\n'));
        let digits = digits.ok_or("it does not begin with `cairn-key-file-v1`")?;
        let mut bytes = Zeroizing::new([0; 32]);
        hex::decode_to_slice(digits, bytes.as_mut()).map_err(|_| "64 hexadecimal digits are expected")?;
        Ok(Self(bytes))
    }
}

impl fmt::Debug for SealingKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SealingKey(secret)")
    }
}

/// A sealed key, closed. Holds no secret that is not encrypted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SealedKey {
    public: PublicKey,
    kdf: Kdf,
    nonce: [u8; NONCE],
    ciphertext: [u8; CIPHERTEXT],
}

/// What a sealed key is opened with.
#[derive(Clone, Copy)]
pub enum Secret<'a> {
    /// A passphrase.
    Passphrase(&'a Passphrase),
    /// The secret of a key file.
    KeyFile(&'a SealingKey),
}

impl Secret<'_> {
    const fn name(&self) -> &'static str {
        match self {
            Self::Passphrase(_) => "the passphrase",
            Self::KeyFile(_) => "the key file",
        }
    }
}

impl SealedKey {
    /// Seals a key, under fresh salt and nonce.
    ///
    /// # Errors
    /// [`SealError::Random`], [`SealError::Argon2`].
    pub fn seal(key: &OwnerKey, secret: Secret<'_>) -> Result<Self, SealError> {
        Self::seal_at(key, secret, Cost::RECOMMENDED)
    }

    fn seal_at(key: &OwnerKey, secret: Secret<'_>, cost: Cost) -> Result<Self, SealError> {
        let (mut salt, mut nonce) = ([0; SALT], [0; NONCE]);
        for bytes in [&mut salt[..], &mut nonce[..]] {
            getrandom::fill(bytes).map_err(|e| SealError::Random(e.to_string()))?;
        }
        let kdf = match secret {
            Secret::Passphrase(_) => Kdf::Passphrase { cost, salt },
            Secret::KeyFile(_) => Kdf::KeyFile,
        };
        let mut sealed = Self { public: key.public(), kdf, nonce, ciphertext: [0; CIPHERTEXT] };
        let cipher = sealed.cipher(secret)?;
        let seed = key.seed();
        let payload = Payload { msg: seed.as_ref(), aad: &sealed.additional_data() };
        // 32 bytes are far from the cipher's limit, and it fails at nothing else.
        let ciphertext = cipher.encrypt(&XNonce::from(nonce), payload).expect("32 bytes are not too many to encrypt");
        sealed.ciphertext.copy_from_slice(&ciphertext);
        Ok(sealed)
    }

    /// The key as it was sealed.
    ///
    /// # Errors
    /// [`SealError::Wrong`], [`SealError::OtherSecret`], [`SealError::Argon2`].
    pub fn open(&self, secret: Secret<'_>) -> Result<OwnerKey, SealError> {
        let wrong = || SealError::Wrong(secret.name());
        let payload = Payload { msg: &self.ciphertext, aad: &self.additional_data() };
        let seed = self.cipher(secret)?.decrypt(&XNonce::from(self.nonce), payload).map_err(|_| wrong())?;
        let seed = Zeroizing::new(seed);
        let seed: &[u8; 32] = seed.as_slice().try_into().map_err(|_| wrong())?;
        let key = OwnerKey::from_seed(seed);
        if key.public() != self.public {
            return Err(wrong());
        }
        Ok(key)
    }

    /// The public key that the file states; that the secret half belongs to it is certain only once opened.
    pub const fn public(&self) -> PublicKey {
        self.public
    }

    /// What it is sealed with.
    pub const fn by(&self) -> SealedBy {
        match self.kdf {
            Kdf::Passphrase { cost, .. } => SealedBy::Passphrase(cost),
            Kdf::KeyFile => SealedBy::KeyFile,
        }
    }

    /// The file's text.
    pub fn to_text(&self) -> String {
        let mut bytes = self.head();
        bytes.extend_from_slice(&self.ciphertext);
        let base64 = STANDARD.encode(bytes);
        let mut text = format!("{BEGIN}{HEADER}{}\n\n", self.public);
        for (at, character) in base64.chars().enumerate() {
            if at > 0 && at % COLUMNS == 0 {
                text.push('\n');
            }
            text.push(character);
        }
        text.push('\n');
        text.push_str(END);
        text
    }

    /// Reads a file's text. Nothing is opened, and nothing of the size that the text asks for is allocated.
    ///
    /// # Errors
    /// [`SealError`] other than [`SealError::Wrong`], [`SealError::OtherSecret`] and [`SealError::Argon2`].
    pub fn parse(text: &str) -> Result<Self, SealError> {
        let bad = SealError::Malformed;
        if text.len() as u64 > MAX_TEXT {
            return Err(bad("too long"));
        }
        let inner = text.strip_prefix(BEGIN).and_then(|t| t.strip_suffix(END)).ok_or(bad("its first or last line"))?;
        let (header, body) = inner.split_once("\n\n").ok_or(bad("no empty line behind the public key"))?;
        let public = header.strip_prefix(HEADER).and_then(|key| key.parse().ok()).ok_or(bad("its public key"))?;
        let bytes = STANDARD.decode(body.replace('\n', "")).map_err(|_| bad("not base64"))?;
        let mut rest = Reader(&bytes);
        let version = rest.u8()?;
        if version != VERSION {
            return Err(SealError::Version { got: version });
        }
        let kdf = match rest.u8()? {
            BY_PASSPHRASE => {
                let cost = Cost { memory_kib: rest.u32()?, passes: rest.u32()?, lanes: rest.u32()? };
                Kdf::Passphrase { cost: cost.check()?, salt: rest.take()? }
            }
            BY_KEY_FILE => Kdf::KeyFile,
            got => return Err(SealError::Kind { got }),
        };
        let sealed = Self { public, kdf, nonce: rest.take()?, ciphertext: rest.take()? };
        if !rest.0.is_empty() || sealed.to_text() != text {
            return Err(bad("not spelt as it is written"));
        }
        Ok(sealed)
    }

    /// Everything before the ciphertext.
    fn head(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        match self.kdf {
            Kdf::Passphrase { cost, salt } => {
                bytes.push(BY_PASSPHRASE);
                for number in [cost.memory_kib, cost.passes, cost.lanes] {
                    bytes.extend_from_slice(&number.to_be_bytes());
                }
                bytes.extend_from_slice(&salt);
            }
            Kdf::KeyFile => bytes.push(BY_KEY_FILE),
        }
        bytes.extend_from_slice(&self.nonce);
        bytes
    }

    fn additional_data(&self) -> Vec<u8> {
        [LABEL, &self.public.to_bytes(), &self.head()].concat()
    }

    fn cipher(&self, secret: Secret<'_>) -> Result<XChaCha20Poly1305, SealError> {
        let key = match (self.kdf, secret) {
            (Kdf::Passphrase { cost, salt }, Secret::Passphrase(passphrase)) => stretch(passphrase, cost, &salt)?,
            (Kdf::KeyFile, Secret::KeyFile(key)) => key.0.clone(),
            (_, secret) => return Err(SealError::OtherSecret { by: self.by(), brought: secret.name() }),
        };
        let key: &Key = (&*key).into();
        Ok(XChaCha20Poly1305::new(key))
    }
}

/// Argon2id version 1.3 (RFC 9106) of a passphrase.
fn stretch(passphrase: &Passphrase, cost: Cost, salt: &[u8; SALT]) -> Result<Zeroizing<[u8; 32]>, SealError> {
    let failed = |e: argon2::Error| SealError::Argon2(e.to_string());
    let Cost { memory_kib, passes, lanes } = cost.check()?;
    let params = Params::new(memory_kib, passes, lanes, Some(32)).map_err(failed)?;
    // Memory of our own, wiped afterwards: what stands in it gives the key away.
    let mut memory: Zeroizing<Vec<Block>> = Zeroizing::default();
    memory.try_reserve_exact(params.block_count()).map_err(|e| SealError::Argon2(e.to_string()))?;
    memory.resize(params.block_count(), Block::new());
    let mut key = Zeroizing::new([0; 32]);
    Argon2::new(Algorithm::Argon2id, Version::V0x13, params)
        .hash_password_into_with_memory(passphrase.0.as_bytes(), salt, key.as_mut(), memory.as_mut_slice())
        .map_err(failed)?;
    Ok(key)
}

/// Takes from the front of some bytes.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], SealError> {
        let (head, rest) = self.0.split_first_chunk().ok_or(SealError::Malformed("too short"))?;
        self.0 = rest;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, SealError> {
        self.take().map(|[byte]| byte)
    }

    fn u32(&mut self) -> Result<u32, SealError> {
        self.take().map(u32::from_be_bytes)
    }
}

#[cfg(test)]
#[path = "sealed_tests.rs"]
mod tests;
