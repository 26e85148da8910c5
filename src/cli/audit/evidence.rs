//! `cairn audit evidence`: what a follower kept of a contradiction, checked by a person
//! who was not there.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_verify::{Fetch, FollowError, Outcome, audit_evidence};

use super::trust::Trust;
use cairn_durable::read_limited;

/// Largest note that is read, bytes.
const MAX_NOTE: u64 = 1 << 20;

/// `cairn audit evidence`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The folder that was kept: `first`, `second`, and tiles
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    #[command(flatten)]
    pub trust: Trust,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit evidence`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let policy = args.trust.policy()?;
    let pinned = args.trust.pinned(policy.as_ref(), None)?;
    let pinned = pinned.context("evidence against whom? give the log's public key (--vkey)")?;
    let note = |name: &str| -> anyhow::Result<String> {
        Ok(String::from_utf8_lossy(&read_limited(&args.dir.join(name), MAX_NOTE)?).into_owned())
    };
    let report = audit_evidence(&note("first")?, &note("second")?, &Kept(args.dir.clone()), &pinned);
    super::trust::show(&report, args.json.then(|| report.to_json()));
    Ok(if report.outcome == Outcome::Trusted { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The tiles of an evidence folder.
struct Kept(PathBuf);

impl Fetch for Kept {
    fn fetch(&self, path: &str, limit: usize) -> Result<Option<Vec<u8>>, FollowError> {
        let file = self.0.join(path);
        if !file.exists() {
            return Ok(None);
        }
        let failed = |e: cairn_durable::DurableError| FollowError::Fetch {
            path: file.display().to_string(),
            cause: e.to_string(),
        };
        read_limited(&file, limit as u64).map(Some).map_err(failed)
    }
}
