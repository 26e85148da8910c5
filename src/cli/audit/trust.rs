//! Whom an audit believes, and what its outcome is to the shell.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_durable::read_limited;
use cairn_log::format::policy::MAX_POLICY_BYTES;
use cairn_log::{NoteVerifier, Policy};
use cairn_verify::Outcome;

/// A verifier key is a line.
const MAX_VKEY_BYTES: u64 = 64 << 10;

/// Whom to believe.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Trust {
    /// The log's public key (see `cairn owners vkey`), obtained elsewhere; without it, or a policy that lists the log,
    /// nothing is trusted
    #[arg(long, value_name = "FILE")]
    pub vkey: Option<PathBuf>,
    /// A trust policy (C2SP tlog-policy): the logs, the witnesses, and how many of them must have cosigned
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
}

impl Trust {
    /// The policy, if one is given.
    ///
    /// # Errors
    /// For a file that is no policy.
    pub fn policy(&self) -> anyhow::Result<Option<Policy>> {
        let Some(path) = &self.policy else { return Ok(None) };
        let text = read_limited(path, MAX_POLICY_BYTES as u64)?;
        Policy::parse(&text).map(Some).with_context(|| path.display().to_string())
    }

    /// The key to pin: the one given, else the policy's for `origin`; for any origin where the policy knows one log only.
    ///
    /// # Errors
    /// For a file that is no vkey.
    pub fn pinned(&self, policy: Option<&Policy>, origin: Option<&str>) -> anyhow::Result<Option<NoteVerifier>> {
        if let Some(path) = &self.vkey {
            return vkey(path).map(Some);
        }
        let logs = policy.map_or(&[][..], Policy::logs);
        let known = logs.iter().find(|log| Some(log.verifier.name()) == origin);
        let only = logs.first().filter(|_| logs.len() == 1);
        Ok(known.or(only).map(|log| log.verifier.clone()))
    }
}

/// Reads a verifier key from its file.
///
/// # Errors
/// For a file that is no vkey.
pub fn vkey(path: &Path) -> anyhow::Result<NoteVerifier> {
    let text = String::from_utf8(read_limited(path, MAX_VKEY_BYTES)?);
    let text = text.with_context(|| format!("{} is no text", path.display()))?;
    text.trim().parse().with_context(|| format!("{} is no vkey", path.display()))
}

/// Prints a report: its JSON where that is asked for.
pub fn show(report: &impl std::fmt::Display, json: Option<String>) {
    match json {
        Some(json) => println!("{json}"),
        None => print!("{report}"),
    }
}

/// The exit code of what has an outcome: 1 for invalid.
pub fn exit(outcome: Outcome) -> ExitCode {
    if outcome == Outcome::Invalid { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
