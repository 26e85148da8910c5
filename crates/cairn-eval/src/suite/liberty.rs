//! Suite `liberty`: a real landmark through the program `cairn`, both stages.

use std::ffi::OsStr;
use std::process::{Command, Output, Stdio};

use anyhow::Context as _;

use crate::args::Args;
use crate::rows::Rows;

/// Photographs are resampled by this factor.
const SCALE: &str = "0.5";

/// Trains and scores it, and adds its rows.
///
/// # Errors
/// For a command that fails, and a report that does not read.
pub fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let from = args.captures()?.join("liberty");
    std::fs::create_dir(&args.out)
        .with_context(|| format!("cannot make the folder {}; choose a new one (--out)", args.out.display()))?;
    let (data, contributors) = (args.out.join("data"), from.join("contributors.csv"));
    let sheet = args.out.join("contact-sheet.png");
    let program = args.cairn()?;
    let cairn = |arguments: &[&OsStr]| -> anyhow::Result<Vec<u8>> {
        let mut command = Command::new(&program);
        let output = command.args(arguments).arg("--data").arg(&data).stderr(Stdio::inherit()).output();
        let Output { status, stdout, .. } = output.with_context(|| format!("cannot start {}", program.display()))?;
        anyhow::ensure!(status.success(), "`cairn {}` ended with {status}", arguments.join(OsStr::new(" ")).display());
        Ok(stdout)
    };
    let text = OsStr::new;
    let import = ["scene", "import", "liberty", "--scale", SCALE, "--hold-out", "8", "--from"].map(text);
    cairn(&[&import[..], &[from.as_os_str(), text("--contributors"), contributors.as_os_str()]].concat())?;
    let [anchors, seed] = [args.anchors.unwrap_or(3).to_string(), args.seed.to_string()];
    let neighbours = if args.anchors.is_some() { args.neighbours } else { Some(20) }.map(|k| k.to_string());
    let mut train = ["train", "liberty", "--anchors", &anchors, "--seed", &seed].map(text).to_vec();
    if let Some(neighbours) = &neighbours {
        train.extend([text("--neighbours"), text(neighbours)]);
    }
    if let Some(signals) = args.signals() {
        train.extend([text("--signals"), signals.as_os_str()]);
    }
    if args.quick {
        train.extend(["--quality", "draft"].map(text));
    }
    cairn(&train)?;
    let evaluate = ["evaluate", "liberty", "--json", "--sheet"].map(text);
    let report = cairn(&[&evaluate[..], &[sheet.as_os_str()]].concat())?;
    let report = serde_json::from_slice(&report).context("the report of `cairn evaluate`")?;
    let of = args.neighbours.map_or(String::new(), |k| format!(" of {k} views"));
    let clusters = args.anchors.map_or(String::new(), |m| format!(", {m} anchors{of}"));
    rows.of_report(&args.case_name(&format!("liberty{clusters}")), &report);
    Ok(())
}
