//! Access tokens: one call's permission slip, signed by the caller, good once.
//!
//! ```text
//! version u8 = 1 | key id 32 | method | scene | origin | registry key id 32 | run 16
//!   | issued u64 | expires u64 | random 16 | signature 64
//! ```
//!
//! Texts are UTF-8 after their length in bytes (u16); numbers are big-endian; times
//! are seconds since 1970. The key id is the SHA-256 of the signer's public key. The
//! signature is Ed25519, strict, over `"cairn access token v1\n"` and everything before
//! the signature. It travels as base64url without padding: `authorization: Cairn <token>`.
//!
//! Whoever overhears a token can do nothing with it: it names its method, its
//! scene, its daemon and the daemon's present run, and it was used already. The run
//! (random bytes made at every start) is why the memory of used tokens need not
//! outlive the process.

use std::sync::{Mutex, PoisonError};

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use cairn_log::{Digest, OwnerKey, PublicKey};

use crate::auth::accounts::{Account, Accounts, Standing};
use crate::auth::error::{AccessError, AccountError, Denied, TokenError};
use crate::auth::replay::Replays;
use crate::auth::roles::{Need, Reach};
use crate::auth::wire::{MAX_METHOD, MAX_ORIGIN, MAX_SCENE, MAX_TEXT, Reader, SKEW_S, VERSION, put_text};

/// What the signed bytes begin with, so that a token can be mistaken for nothing else that the key signs.
const DOMAIN: &[u8] = b"cairn access token v1\n";
/// Longest lifetime that any daemon allows, seconds.
pub const MAX_LIFETIME_S: u64 = 300;
/// Tokens that a daemon remembers at the same time.
pub const MEMORY: usize = 65_536;
/// Of these, most of one account.
pub const MEMORY_OF_ONE: usize = 8_192;

const SIGNATURE: usize = cairn_log::format::key::SIGNATURE_LEN;

/// Which daemon a token is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Daemon {
    /// Its registry's origin line, at most 256 bytes.
    pub origin: String,
    /// Key id of its registry's public key.
    pub registry: Digest,
    /// Random bytes of its present run.
    pub run: [u8; 16],
}

impl Daemon {
    /// A daemon that starts now.
    ///
    /// # Errors
    /// [`TokenError::Random`].
    pub fn starting(origin: &str, registry: &PublicKey) -> Result<Self, TokenError> {
        Ok(Self { origin: origin.to_owned(), registry: registry.id(), run: random()? })
    }
}

/// What a verified token says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claims {
    /// Id of the key that signed.
    pub key: Digest,
    /// Full gRPC path.
    pub method: String,
    /// The scene that the call is about; empty where it is about none.
    pub scene: String,
    /// For which daemon.
    pub daemon: Daemon,
    /// Signed at.
    pub issued: u64,
    /// No longer good after.
    pub expires: u64,
    /// Makes it one of its kind.
    pub random: [u8; 16],
}

fn random() -> Result<[u8; 16], TokenError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|e| TokenError::Random(e.to_string()))?;
    Ok(bytes)
}

/// Signs a token for one call of `method` about `scene`, issued `now`, good for `lifetime_s`.
///
/// # Errors
/// [`TokenError::TooLong`], [`TokenError::Random`].
pub fn sign(
    key: &OwnerKey,
    daemon: &Daemon,
    method: &str,
    scene: &str,
    now: u64,
    lifetime_s: u64,
) -> Result<String, TokenError> {
    let claims = Claims {
        key: key.public().id(),
        method: method.to_owned(),
        scene: scene.to_owned(),
        daemon: daemon.clone(),
        issued: now,
        expires: now.saturating_add(lifetime_s),
        random: random()?,
    };
    let mut bytes = claims.to_bytes()?;
    let signature = key.sign(&[DOMAIN, &bytes].concat());
    bytes.extend_from_slice(&signature);
    Ok(URL_SAFE_NO_PAD.encode(bytes))
}

impl Claims {
    fn to_bytes(&self) -> Result<Vec<u8>, TokenError> {
        let too_long = |field| TokenError::TooLong { field };
        let mut out = vec![VERSION];
        out.extend_from_slice(self.key.as_bytes());
        put_text(&mut out, "the method", &self.method, MAX_METHOD).map_err(too_long)?;
        put_text(&mut out, "the scene's name", &self.scene, MAX_SCENE).map_err(too_long)?;
        put_text(&mut out, "the registry's origin", &self.daemon.origin, MAX_ORIGIN).map_err(too_long)?;
        out.extend_from_slice(self.daemon.registry.as_bytes());
        out.extend_from_slice(&self.daemon.run);
        out.extend_from_slice(&self.issued.to_be_bytes());
        out.extend_from_slice(&self.expires.to_be_bytes());
        out.extend_from_slice(&self.random);
        Ok(out)
    }

    fn parse(bytes: &[u8]) -> Result<Self, TokenError> {
        let mut reader = Reader { rest: bytes };
        let malformed = |field| TokenError::Malformed { field };
        let [version] = reader.array("its version").map_err(malformed)?;
        if version != VERSION {
            return Err(TokenError::Version { got: version });
        }
        let mut rest = || -> Result<Self, &'static str> {
            Ok(Self {
                key: Digest::from_bytes(reader.array("the key's id")?),
                method: reader.text("the method", MAX_METHOD)?.to_owned(),
                scene: reader.text("the scene", MAX_SCENE)?.to_owned(),
                daemon: Daemon {
                    origin: reader.text("the origin", MAX_ORIGIN)?.to_owned(),
                    registry: Digest::from_bytes(reader.array("the registry's key id")?),
                    run: reader.array("the daemon's run")?,
                },
                issued: reader.u64("the time of issue")?,
                expires: reader.u64("the time of expiry")?,
                random: reader.array("the random bytes")?,
            })
        };
        let claims = rest().map_err(malformed)?;
        if !reader.rest.is_empty() {
            return Err(malformed("bytes too many"));
        }
        Ok(claims)
    }

    /// Holds the token to what its call is about: a scene, or nothing (empty).
    ///
    /// # Errors
    /// [`TokenError::WrongScene`].
    pub fn about(&self, scene: &str) -> Result<(), TokenError> {
        if self.scene == scene {
            return Ok(());
        }
        // The call's name may be any text of any length; a scene's has 64 bytes at most.
        let call = scene.chars().take(MAX_SCENE).collect();
        Err(TokenError::WrongScene { token: self.scene.clone(), call })
    }
}

/// A call that a token is to be good for.
#[derive(Clone, Copy, Debug)]
pub struct Call<'a> {
    /// Full gRPC path.
    pub method: &'a str,
    /// What it needs.
    pub need: Need,
    /// Now, by the daemon's clock.
    pub now: u64,
    /// Whether an account may make it whose key the log ended ([`Account::ended_by`]); whoever admits it holds it
    /// to what such an account may still do.
    pub ended_too: bool,
}

/// Verifies tokens, each once.
#[derive(Debug)]
pub struct Verifier {
    /// Whom tokens are to be for.
    pub daemon: Daemon,
    /// Longest life of a token, seconds.
    pub longest_s: u64,
    replays: Mutex<Replays>,
}

impl Verifier {
    /// Tokens for `daemon` that live at most `longest_s` ([`MAX_LIFETIME_S`] at most), remembering
    /// [`MEMORY`] of them.
    pub fn new(daemon: Daemon, longest_s: u64) -> Self {
        Self::with_memory(daemon, longest_s, MEMORY, MEMORY_OF_ONE)
    }

    /// As [`Verifier::new`], remembering `memory` tokens and at most `of_one` of one account.
    pub fn with_memory(daemon: Daemon, longest_s: u64, memory: usize, of_one: usize) -> Self {
        let replays = Mutex::new(Replays::new(memory, of_one));
        Self { daemon, longest_s: longest_s.min(MAX_LIFETIME_S), replays }
    }

    /// Verifies a token for a call, uses it up, and tells whose it is. What it is about remains
    /// to be compared: [`Claims::about`].
    ///
    /// In this order: form, version, account, signature, daemon, method, time, whether the key still signs for the
    /// account, the account's standing and role, first use. So a stranger learns nothing but that they are one.
    ///
    /// # Errors
    /// [`AccessError::Token`], [`AccessError::Account`], [`AccessError::Denied`].
    pub fn verify(&self, token: &str, call: Call<'_>, accounts: &Accounts) -> Result<(Account, Claims), AccessError> {
        let (claims, account, id) = open(token, accounts)?;
        self.fits(&claims, call)?;
        if let Some(index) = account.ended_by.filter(|_| !call.ended_too) {
            return Err(AccountError::Ended { key: claims.key, index }.into());
        }
        if account.signer().id() != claims.key {
            return Err(AccountError::Rotated { heir: *account.signer(), name: account.name }.into());
        }
        match account.standing {
            Standing::Active => {}
            Standing::Waiting => return Err(AccountError::Waiting { name: account.name }.into()),
            Standing::Disabled => return Err(AccountError::Disabled { name: account.name }.into()),
        }
        if account.role.reach(call.need) == Reach::None {
            let (method, needed) = (call.method.to_owned(), call.need.roles());
            return Err(Denied::Role { name: account.name, role: account.role, method, needed }.into());
        }
        let forget = claims.expires.saturating_add(SKEW_S);
        let mut replays = self.replays.lock().unwrap_or_else(PoisonError::into_inner);
        replays.remember(id, claims.key, forget, call.now)?;
        Ok((account, claims))
    }

    /// Holds a token to its daemon, its method and its time.
    fn fits(&self, claims: &Claims, call: Call<'_>) -> Result<(), TokenError> {
        if claims.daemon != self.daemon {
            let other_run =
                claims.daemon.origin == self.daemon.origin && claims.daemon.registry == self.daemon.registry;
            let name = |d: &Daemon| format!("{} with registry key {}", d.origin, d.registry);
            let token = if other_run { "an earlier run of this daemon".into() } else { name(&claims.daemon) };
            return Err(TokenError::WrongDaemon { token, here: name(&self.daemon) });
        }
        if claims.method != call.method {
            return Err(TokenError::WrongMethod { token: claims.method.clone(), call: call.method.to_owned() });
        }
        let Claims { issued, expires, .. } = *claims;
        if expires < issued || expires - issued > self.longest_s {
            return Err(TokenError::Lifetime { issued, expires, longest_s: self.longest_s });
        }
        if issued > call.now.saturating_add(SKEW_S) {
            return Err(TokenError::NotYet { issued, now: call.now });
        }
        if call.now > expires.saturating_add(SKEW_S) {
            return Err(TokenError::Expired { expires, now: call.now });
        }
        Ok(())
    }
}

/// Reads a token and checks its signature: what it says, whose it is, and what to remember it by.
fn open(token: &str, accounts: &Accounts) -> Result<(Claims, Account, Digest), AccessError> {
    let malformed = |field| TokenError::Malformed { field };
    if token.len() > MAX_TEXT {
        return Err(malformed("it is too long").into());
    }
    let bytes = URL_SAFE_NO_PAD.decode(token).map_err(|_| malformed("no base64url"))?;
    let body_len = bytes.len().checked_sub(SIGNATURE).ok_or(malformed("the signature"))?;
    let (body, signature) = bytes.split_at(body_len);
    let claims = Claims::parse(body)?;
    let account = accounts.of_signer(&claims.key).ok_or(AccountError::Unknown { key: claims.key })?;
    let message = [DOMAIN, body].concat();
    let key = if account.id() == claims.key { &account.key } else { account.signer() };
    key.verify(&message, signature).map_err(|_| TokenError::BadSignature { key: claims.key })?;
    Ok((claims, account, Digest::of(body)))
}

#[cfg(test)]
#[path = "token_tests.rs"]
mod tests;
