//! Suite `demo`: `cairn demo` on the made-up landmark.

use std::process::{Command, Stdio};

use anyhow::Context as _;
use cairn_service::query::report::{Report, Right};
use serde::Deserialize;

use crate::args::Args;
use crate::file;
use crate::results::Target;
use crate::rows::Rows;

/// Most seconds that the demo may take.
const MAX_SECONDS: f64 = 180.0;
/// What the demo calls its seconds from start to end.
const WHOLE: &str = "whole demo";

/// What is read of the demo's results.
#[derive(Deserialize)]
struct Results {
    evaluation: Report,
    records_trusted: Right,
    records_found: Right,
    seconds: Vec<(String, f64)>,
}

/// Runs the demo and adds its rows.
///
/// # Errors
/// For a demo that fails, and results that do not read.
pub fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    file::make_folder(&args.out)?;
    let mut demo = Command::new(args.cairn()?);
    demo.arg("demo").arg("--json").arg("--out").arg(args.out.join("demo"));
    demo.arg("--seed").arg(args.seed.to_string());
    let output = demo.stderr(Stdio::inherit()).output().context("cannot start cairn")?;
    anyhow::ensure!(output.status.success(), "`cairn demo` ended with {}; its error is above", output.status);
    let results: Results = serde_json::from_slice(&output.stdout).context("the demo's results")?;
    let case = args.case_name("made-up landmark");
    rows.of_report(&case, &results.evaluation);
    rows.share(&case, "owner records trusted", results.records_trusted, Some(1.0));
    rows.share(&case, "records found by pose", results.records_found, Some(1.0));
    for (step, seconds) in &results.seconds {
        let target = (step == WHOLE).then(|| Target::at_most(MAX_SECONDS));
        rows.add(&case, step, *seconds, "s", target);
    }
    Ok(())
}
