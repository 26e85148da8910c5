//! Suite `mark`: what stage 2 makes of captures' base fields. Each capture is marked three times (or `--trainings`), with
//! other seeds and other hidden pictures, and judged on views that no training saw: pictures kept, hidden pictures
//! recovered, classes predicted, false owners on pictures of anything else, and what outlasts the ways that pictures travel.

use crate::args::Args;
use crate::children::Children;
use crate::file;
use crate::marks::report;
use crate::marks::run::{AS_IT_IS, Run, cases};
use crate::rows::Rows;

/// Measures the captures that were asked for and keeps each one's rows when it is whole.
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let cases = cases(&args.cases);
    let captures = args.captures_with(&cases.iter().map(|case| case.name).collect::<Vec<_>>())?;
    let pictures = args.pictures()?;
    file::make_folder(&args.out)?;
    let children = Children::default();
    let mut runs = Vec::new();
    // All base fields before any mark: other captures' renders are among what a detector is to be silent on.
    for case in cases {
        let run = Run::new(args, case, &captures, &pictures, &AS_IT_IS)?;
        let of = run.clone();
        runs.push((run, children.unless_stopped(move |children| of.base(children)).await?));
    }
    for (run, base) in runs {
        let (name, case) = (run.name.clone(), run.case);
        let outcome = children.unless_stopped(move |children| run.outcome(base, children)).await?;
        report::add(rows, &name, case, &outcome);
        rows.save(args)?;
    }
    println!("contact sheets and reliability tables in {}", args.out.display());
    Ok(())
}
