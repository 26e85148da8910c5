//! The checked half of `[registry]`: the log's name, its anchor, where its public files are served, and who cosigns it.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use cairn_log::WitnessVerifier;
use cairn_log::witness::WitnessClient;

use super::error::{ConfigError, out_of_range};
use super::settings;

/// Most witnesses.
const MAX_WITNESSES: usize = 32;

/// Where the log's public files are served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublicHttp {
    /// Where to listen; any address, since the files are public and only read.
    pub bind: SocketAddr,
    /// Empty, or a slash and segments.
    pub prefix: String,
}

/// A witness that cosigns the log's checkpoints.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WitnessSetting {
    /// Its name and key.
    pub verifier: WitnessVerifier,
    /// Its submission prefix, http or https.
    pub url: String,
}

impl WitnessSetting {
    fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_ascii_whitespace();
        let (Some(vkey), Some(url), None) = (words.next(), words.next(), words.next()) else {
            return Err("is not \"VKEY URL\", a witness's verifier key and its address".into());
        };
        let verifier: WitnessVerifier = vkey.parse().map_err(|e| format!("begins with no verifier key: {e}"))?;
        WitnessClient::new(verifier.clone(), url).map_err(|e| format!("ends with no address: {e}"))?;
        Ok(Self { verifier, url: url.to_owned() })
    }
}

pub(super) fn check_origin(origin: &str) -> Result<(), ConfigError> {
    let odd = |c: char| c.is_whitespace() || c.is_control() || c == '+';
    if origin.is_empty() || origin.len() > 256 || origin.chars().any(odd) {
        return Err(out_of_range("registry.origin", origin, "1 to 256 bytes without spaces or plus signs"));
    }
    Ok(())
}

pub(super) fn anchor_file(path: &str) -> Result<Option<PathBuf>, ConfigError> {
    if path.is_empty() {
        return Ok(None);
    }
    // From another working directory a relative one would be missing.
    if !Path::new(path).is_absolute() || Path::new(path).file_name().is_none() {
        let wanted = "the absolute path of a file outside the data folder, or nothing";
        return Err(out_of_range("registry.anchor_file", path, wanted));
    }
    Ok(Some(path.into()))
}

pub(super) fn public_http(raw: &settings::Registry) -> Result<Option<PublicHttp>, ConfigError> {
    let prefix = &raw.http_prefix;
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    let segment = |s: &str| !s.is_empty() && s != "." && s != ".." && s.chars().all(allowed);
    let fits = prefix.strip_prefix('/').is_some_and(|rest| rest.split('/').all(segment));
    if !prefix.is_empty() && (!fits || prefix.len() > 256) {
        let wanted = "nothing, or a slash and segments of letters, digits, dots, dashes and underscores, as /log";
        return Err(out_of_range("registry.http_prefix", prefix, wanted));
    }
    if raw.http_bind.is_empty() {
        return Ok(None);
    }
    let wanted = "an IP address and a port, as 127.0.0.1:7342, or nothing";
    let bind = raw.http_bind.parse().map_err(|_| out_of_range("registry.http_bind", &raw.http_bind, wanted))?;
    Ok(Some(PublicHttp { bind, prefix: prefix.clone() }))
}

pub(super) fn witnesses(raw: &[String]) -> Result<Vec<WitnessSetting>, ConfigError> {
    const KEY: &str = "registry.witnesses";
    if raw.len() > MAX_WITNESSES {
        return Err(out_of_range(KEY, format!("{} witnesses", raw.len()), format!("0 to {MAX_WITNESSES}")));
    }
    let mut found: Vec<WitnessSetting> = Vec::with_capacity(raw.len());
    for (number, text) in (1..).zip(raw) {
        let refused = |what| ConfigError::Entry { key: KEY.into(), number, what };
        let witness = WitnessSetting::parse(text).map_err(refused)?;
        if found.iter().any(|other| other.verifier.key() == witness.verifier.key()) {
            return Err(refused("has the key of another entry; name each witness once".into()));
        }
        found.push(witness);
    }
    Ok(found)
}
