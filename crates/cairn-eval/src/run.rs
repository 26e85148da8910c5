//! Runs a suite.

use crate::args::{Args, Suite};
use crate::results::Results;
use crate::rows::{self, Rows};
use crate::suite::{
    ablation, baseline, contribution, conv, demo, field, liberty, mark, registration, registry, scenes, woven,
};

/// Measures what was asked for, into the results and the page.
///
/// # Errors
/// For results that cannot be read or written, and the suite's own.
pub async fn run(args: &Args) -> anyhow::Result<()> {
    args.check()?;
    // Read now: an unreadable file is better found before the work than after it.
    let results = Results::load(&args.results)?;
    if args.suite == Suite::Page {
        anyhow::ensure!(
            args.results.is_dir(),
            "there is no folder {}; name it (--results DIR)",
            args.results.display()
        );
        rows::write_page(&results, &args.page)?;
        println!("in {}", args.page.display());
        return Ok(());
    }
    let mut rows = Rows::new(args);
    match args.suite {
        Suite::Demo => tokio::task::block_in_place(|| demo::measure(args, &mut rows))?,
        Suite::Liberty => tokio::task::block_in_place(|| liberty::measure(args, &mut rows))?,
        Suite::Field => field::measure(args, &mut rows).await?,
        Suite::Mark => mark::measure(args, &mut rows).await?,
        Suite::Ablation => ablation::measure(args, &mut rows).await?,
        Suite::Scenes => scenes::measure(args, &mut rows).await?,
        Suite::Contribution => contribution::measure(args, &mut rows).await?,
        Suite::Registration => registration::measure(args, &mut rows).await?,
        Suite::Woven => woven::measure(args, &mut rows).await?,
        Suite::Baseline => baseline::measure(args, &mut rows).await?,
        Suite::Conv => tokio::task::block_in_place(|| conv::measure(args, &mut rows))?,
        Suite::Registry => tokio::task::block_in_place(|| registry::measure(args, &mut rows))?,
        Suite::Page => {}
    }
    rows.save(args)?;
    println!("in {}; {} targets missed", args.results.display(), Results::load(&args.results)?.missed().count());
    Ok(())
}
