//! `cairn audit answer`: who contributed, with proofs that each record named is in the
//! log and that none is left out.

use std::path::PathBuf;
use std::process::ExitCode;

use crate::engine::folder::read_limited;

/// Largest answer that is opened, bytes; cairn-audit has a limit of its own.
const MAX_ANSWER_BYTES: u64 = 256 << 20;

/// `cairn audit answer`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The answer, JSON
    #[arg(value_name = "F")]
    pub answer: PathBuf,
    /// The log's public key (see `cairn owners vkey`), obtained elsewhere; without it nothing is trusted
    #[arg(long, value_name = "FILE")]
    pub vkey: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit answer`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let answer = read_limited(&args.answer, MAX_ANSWER_BYTES)?;
    let pinned = args.vkey.as_deref().map(super::vkey).transpose()?;
    let report = cairn_audit::audit_answer(&answer, pinned.as_ref());
    if args.json {
        println!("{}", report.to_json());
    } else {
        print!("{report}");
    }
    Ok(super::exit(report.outcome))
}
