//! Suite `conv`: how long each pass of the convolutions takes that training does, beside PyTorch's.
//!
//! Cairn and PyTorch take turns, so that a machine that others use as well is busy for both; the ratio is of medians over
//! all rounds. PyTorch's side needs a Python that has it, named with --torch; without it Cairn's side is measured alone.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use anyhow::Context as _;
use cairn_nn::{ConvShape, Pass};
use serde::Serialize;

use crate::args::Args;
use crate::results::Target;
use crate::rows::Rows;

/// PyTorch's side: reads the shapes, adds its times.
const SCRIPT: &str = include_str!("../../../cairn-nn/benches/pytorch_conv.py");
/// Turns that each side takes.
const ROUNDS: usize = 5;
/// Runs of a pass in a turn.
const RUNS: usize = 15;
/// How much longer than PyTorch's a pass may take.
const MAX_RATIO: f64 = 1.3;

/// Milliseconds of single runs, by convolution and pass.
type Samples = BTreeMap<String, Vec<f64>>;

/// What the script needs to know of a shape.
#[derive(Serialize)]
struct Shape {
    batch: usize,
    inputs: usize,
    outputs: usize,
    size: [usize; 2],
    kernel: [usize; 2],
    stride: usize,
    padding: [usize; 2],
}

/// Measures all shapes and passes into `rows`.
///
/// # Errors
/// For a Python that does not start or has no PyTorch.
pub fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)?;
    let (mut own, mut torch, shapes) = (Samples::new(), Samples::new(), ConvShape::of_training());
    let rounds = if args.quick { 1 } else { ROUNDS };
    for round in 1..=rounds {
        eprintln!("round {round} of {rounds}");
        for (shape, pass) in passes(&shapes) {
            let times = shape.time_ms(pass, RUNS).map_err(anyhow::Error::msg)?;
            own.entry(key(shape, pass)).or_default().extend(times);
        }
        if let Some(python) = &args.torch {
            torch = run_torch(python, &args.out, &shapes)?;
        }
    }
    for (shape, pass) in passes(&shapes) {
        let (case, key) = (args.case_name(&shape.name()), key(shape, pass));
        let (ours, fastest) = summary(&own[&key]);
        rows.add(&case, pass.name(), ours, "ms", None);
        let rate = shape.flops().map_err(anyhow::Error::msg)? / fastest * 1e-6;
        rows.add(&case, &format!("{}, fastest run", pass.name()), rate, "GFLOP/s", None);
        if let Some(theirs) = torch.get(&key) {
            let theirs = summary(theirs).0;
            rows.add(&case, &format!("{}, PyTorch", pass.name()), theirs, "ms", None);
            let ratio = ours / theirs;
            rows.add(&case, &format!("{}, against PyTorch", pass.name()), ratio, "", Some(Target::at_most(MAX_RATIO)));
        }
    }
    Ok(())
}

fn passes(shapes: &[ConvShape]) -> impl Iterator<Item = (&ConvShape, Pass)> {
    shapes.iter().flat_map(|shape| Pass::ALL.map(|pass| (shape, pass)))
}

/// As in the files that the script reads and writes.
fn key(shape: &ConvShape, pass: Pass) -> String {
    format!("{}, {}", shape.name(), pass.name())
}

/// One turn of PyTorch's; gives its times of all turns in this folder.
fn run_torch(python: &Path, folder: &Path, shapes: &[ConvShape]) -> anyhow::Result<Samples> {
    let [script, own, torch] = ["pytorch_conv.py", "shapes.json", "torch.json"].map(|name| folder.join(name));
    let named: BTreeMap<String, Shape> = shapes.iter().map(|shape| (shape.name(), described(shape))).collect();
    std::fs::write(&script, SCRIPT)?;
    std::fs::write(&own, serde_json::to_vec(&BTreeMap::from([("shapes", named)]))?)?;
    let status = Command::new(python).arg(&script).arg(&own).arg(&torch).status();
    let status = status.with_context(|| format!("cannot start {} (--torch)", python.display()))?;
    anyhow::ensure!(status.success(), "{} (--torch) ended with {status}; does it have PyTorch?", python.display());
    let times = std::fs::read(&torch).with_context(|| format!("{}: the script wrote no times", torch.display()))?;
    serde_json::from_slice(&times).with_context(|| torch.display().to_string())
}

fn described(shape: &ConvShape) -> Shape {
    let ConvShape { batch, inputs, outputs, size, kernel, stride, padding } = *shape;
    Shape { batch, inputs, outputs, size, kernel, stride, padding }
}

/// Median and smallest.
fn summary(samples: &[f64]) -> (f64, f64) {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    (sorted[sorted.len() / 2], sorted[0])
}
