//! `cairn bench`: a suite's measurements, one row each, into a ledger that only grows.

use std::path::PathBuf;

use super::connect::Where;

/// `cairn bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to measure
    #[arg(value_enum)]
    suite: Suite,
    /// The folder of captures (suite `liberty`)
    #[arg(long, value_name = "DIR")]
    captures: Option<PathBuf>,
    /// The ledger, CSV; rows are added
    #[arg(long, value_name = "CSV", default_value = "bench-ledger.csv")]
    ledger: PathBuf,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Suite {
    /// The made-up landmark
    Demo,
    /// The statue photographed by a hundred visitors
    Liberty,
}

/// Answers `cairn bench`.
pub async fn run(_place: &Where, args: Args) -> anyhow::Result<()> {
    anyhow::bail!("suite {:?} into {}: {:?}", args.suite, args.ledger.display(), args.captures)
}
