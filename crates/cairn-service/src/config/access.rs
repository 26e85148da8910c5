//! Who may call, and over what kind of line: the settings of `[access]` and
//! `[server.tls]`, checked together, since each rests on the other.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use super::error::{ConfigError, out_of_range};
use super::settings::{self, AccessMode, Quota, Reading};
use super::token::Token;
use crate::auth::{Limits, Policy};

/// How callers are let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Every caller that reaches the daemon.
    Open,
    /// Who brings the daemon's one token.
    Token,
    /// Who has an account, and signs every call.
    Accounts,
}

/// Who may do what.
#[derive(Clone, Debug)]
pub struct Access {
    /// How callers are let in.
    pub mode: Mode,
    /// Whether reading needs a token too.
    pub read_closed: bool,
    /// Who gets an account.
    pub registration: Policy,
    /// Longest life of a signed token, seconds.
    pub token_lifetime_s: u64,
    /// What an account may use without quotas of its own.
    pub quota: Limits,
}

/// Files of TLS, not yet read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The daemon's certificate, PEM.
    pub certificate: PathBuf,
    /// Its private key, PEM.
    pub key: PathBuf,
    /// Who vouches for clients, PEM; `None` asks clients for no certificate.
    pub client_ca: Option<PathBuf>,
}

/// The checked table `[access]`, and the bearer token where the mode wants one.
pub(super) fn checked(raw: &settings::Access, quota: &Quota) -> Result<(Access, Option<Token>), ConfigError> {
    let file = raw.token_file.as_str();
    let mode = match raw.mode {
        AccessMode::Auto if file.is_empty() => Mode::Open,
        AccessMode::Auto | AccessMode::Token => Mode::Token,
        AccessMode::Open => Mode::Open,
        AccessMode::Accounts => Mode::Accounts,
    };
    let token = match (mode, file) {
        (Mode::Token, "") => {
            return Err(out_of_range("access.token_file", "\"\"", "a token's file while access.mode is \"token\""));
        }
        (Mode::Token, path) => Some(Token::load(Path::new(path))?),
        (Mode::Open | Mode::Accounts, "") => None,
        (Mode::Open | Mode::Accounts, path) => {
            let allowed = "empty, or access.mode \"token\": no other mode asks for a bearer token";
            return Err(out_of_range("access.token_file", path, allowed));
        }
    };
    let read_closed = raw.read == Reading::Closed;
    if read_closed && mode == Mode::Open {
        return Err(out_of_range("access.read", "closed", "open while access.mode is \"open\": no caller has a token"));
    }
    let Quota { bytes, views, training_seconds, queued_jobs, records, records_per_day } = *quota;
    let quota = Limits { bytes, views, training_seconds, queued_jobs, records, records_per_day };
    let (registration, token_lifetime_s) = (raw.registration, raw.token_lifetime_s);
    Ok((Access { mode, read_closed, registration, token_lifetime_s, quota }, token))
}

/// The files of TLS: certificate and key, or neither.
pub(super) fn tls(raw: &settings::Tls) -> Result<Option<TlsFiles>, ConfigError> {
    let given = |text: &str| (!text.is_empty()).then(|| PathBuf::from(text));
    let client_ca = given(&raw.client_ca);
    match (given(&raw.certificate), given(&raw.key)) {
        (Some(certificate), Some(key)) => Ok(Some(TlsFiles { certificate, key, client_ca })),
        (None, None) if client_ca.is_none() => Ok(None),
        (Some(_), None) => Err(out_of_range("server.tls.key", "\"\"", "the certificate's private key, a PEM file")),
        (None, _) => Err(out_of_range("server.tls.certificate", "\"\"", "the daemon's certificate, a PEM file")),
    }
}

/// What stands open to the network asks who calls, and does not let the line be read.
pub(super) fn check_bind(bind: SocketAddr, mode: Mode, secured: bool) -> Result<(), ConfigError> {
    if bind.ip().is_loopback() {
        return Ok(());
    }
    if mode == Mode::Open {
        let allowed = "a loopback address while access.mode is open; set access.mode to \"accounts\", or a token file";
        return Err(out_of_range("server.bind", bind, allowed));
    }
    if !secured {
        let allowed = "a loopback address without TLS; set server.tls.certificate and server.tls.key, or, behind a \
                       proxy that ends TLS, server.plaintext = true";
        return Err(out_of_range("server.bind", bind, allowed));
    }
    Ok(())
}
