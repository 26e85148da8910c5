//! `cairn audit`: everything that whoever trusts nobody runs. No daemon is needed,
//! and none is asked: the files, or a log's public tiles, speak for themselves.
//!
//! Every verb answers with coded findings and an exit code; 2 is always "could not
//! be done" (a wrong argument, a file or a server out of reach), never a verdict.

mod against;
pub mod bundle;

use std::path::Path;
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_registry::NoteVerifier;

use super::read;

/// What to audit.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Verify a bundle from its files; exit code 0 for valid and trusted, 1 for invalid
    Bundle(bundle::Args),
}

/// Answers `cairn audit`.
pub fn run(command: &Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Bundle(args) => bundle::run(args),
    }
}

/// Reads a verifier key from its file.
fn pinned(path: &Path) -> anyhow::Result<NoteVerifier> {
    let vkey = String::from_utf8(read(path)?).with_context(|| format!("{} is no text", path.display()))?;
    vkey.trim().parse().with_context(|| format!("{} is no vkey", path.display()))
}
