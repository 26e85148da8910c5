//! `cairn audit`: everything that whoever trusts nobody runs. No daemon is needed,
//! and none is asked: the files, or a log's public tiles, speak for themselves.
//!
//! Every verb answers with coded findings and an exit code; 2 is always "could not
//! be done" (a wrong argument, a file or a server out of reach), never a verdict.

mod against;
mod answer;
pub mod bundle;
mod evidence;
mod follow;
mod http;
mod renders;
mod store;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_log::policy::MAX_POLICY_BYTES;
use cairn_log::{NoteVerifier, Policy};
use cairn_verify::Outcome;

use cairn_durable::read_limited;

/// A verifier key is a line.
const MAX_VKEY_BYTES: u64 = 64 << 10;

/// What to audit.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Verify a bundle from its files; exit code 0 for valid and trusted, 1 for invalid
    Bundle(bundle::Args),
    /// Verify a complete answer (who contributed, and nobody left out); exit codes as for a bundle
    Answer(answer::Args),
    /// Hash a whole data folder again; exit code 0 clean, 10 checkpoint, 11 log or tile, 12 record, 13 map, 14 working
    /// state, 15 scene, model or render (the smallest, where several are at fault)
    Store(store::Args),
    /// Hold a log, over HTTP, to what it signed before; exit code 20 where it contradicts itself, else as for a store
    Follow(follow::Args),
    /// Check what `follow` kept of a contradiction; exit code 0 where it proves two histories, 1 where it does not
    Evidence(evidence::Args),
}

/// Answers `cairn audit`.
pub fn run(command: &Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Bundle(args) => bundle::run(args),
        Command::Answer(args) => answer::run(args),
        Command::Store(args) => store::run(args),
        Command::Follow(args) => follow::run(args),
        Command::Evidence(args) => evidence::run(args),
    }
}

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
    fn policy(&self) -> anyhow::Result<Option<Policy>> {
        let Some(path) = &self.policy else { return Ok(None) };
        let text = read_limited(path, MAX_POLICY_BYTES as u64)?;
        Policy::parse(&text).map(Some).with_context(|| path.display().to_string())
    }

    /// The key to pin: the one given, else the policy's for `origin`; for any origin where the policy knows one log only.
    fn pinned(&self, policy: Option<&Policy>, origin: Option<&str>) -> anyhow::Result<Option<NoteVerifier>> {
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
fn vkey(path: &Path) -> anyhow::Result<NoteVerifier> {
    let text = String::from_utf8(read_limited(path, MAX_VKEY_BYTES)?);
    let text = text.with_context(|| format!("{} is no text", path.display()))?;
    text.trim().parse().with_context(|| format!("{} is no vkey", path.display()))
}

/// The exit code of what has an outcome: 1 for invalid.
fn exit(outcome: Outcome) -> ExitCode {
    if outcome == Outcome::Invalid { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
