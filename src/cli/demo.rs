//! `cairn demo`.
use std::path::PathBuf;

use super::connect::Where;

/// `cairn demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Answers `cairn demo`.
pub async fn run(_place: &Where, _args: Args) -> anyhow::Result<()> {
    Ok(())
}
