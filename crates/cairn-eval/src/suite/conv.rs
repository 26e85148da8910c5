//! Suite `conv`: how long each pass of the convolutions takes that training does, beside PyTorch's.
//!
//! Cairn and PyTorch take turns, so that a machine that others use as well is busy for both; the ratio is of medians over
//! all rounds. PyTorch's side needs a Python that has it, named with --torch; without it Cairn's side is measured alone.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use anyhow::Context as _;
use cairn_nn::{ConvShape, Pass};

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

/// Measures all shapes and passes into `rows`.
///
/// # Errors
/// For a Python that does not start or has no PyTorch.
pub fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)?;
    let (mut own, mut torch, shapes) = (Samples::new(), Samples::new(), shapes_of_training());
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
        let (case, key) = (args.case_name(&name(shape)), key(shape, pass));
        let (ours, fastest) = summary(&own[&key]);
        rows.add(&case, pass_name(pass), ours, "ms", None);
        let rate = flops(shape) / fastest * 1e-6;
        rows.add(&case, &format!("{}, fastest run", pass_name(pass)), rate, "GFLOP/s", None);
        if let Some(theirs) = torch.get(&key) {
            let theirs = summary(theirs).0;
            rows.add(&case, &format!("{}, PyTorch", pass_name(pass)), theirs, "ms", None);
            let ratio = ours / theirs;
            rows.add(
                &case,
                &format!("{}, against PyTorch", pass_name(pass)),
                ratio,
                "",
                Some(Target::at_most(MAX_RATIO)),
            );
        }
    }
    Ok(())
}

fn passes(shapes: &[ConvShape]) -> impl Iterator<Item = (&ConvShape, Pass)> {
    let all = [Pass::Forward, Pass::InputGradient, Pass::WeightGradient];
    shapes.iter().flat_map(move |shape| all.map(|pass| (shape, pass)))
}

/// The convolutions that one step of stage 2 does with default settings
/// (classifier on nine pictures of 128 x 128, detector on five), some
/// larger ones, a 1 x 1 and two of the one-dimensional kind.
fn shapes_of_training() -> Vec<ConvShape> {
    let mut shapes = Vec::new();
    let mut add = |batch, list: &[[usize; 4]]| {
        for &[inputs, outputs, side, stride] in list {
            let (size, kernel, padding) = ([side; 2], [3; 2], [1; 2]);
            shapes.push(ConvShape { batch, inputs, outputs, size, kernel, stride, padding });
        }
    };
    add(9, &[[3, 16, 128, 2], [16, 32, 64, 2], [32, 64, 32, 2], [64, 64, 16, 2]]);
    add(5, &[[10, 8, 128, 1], [8, 16, 128, 2], [16, 16, 64, 1], [16, 32, 64, 2], [32, 32, 32, 1], [32, 48, 32, 2]]);
    add(5, &[[48, 48, 16, 1], [48, 32, 16, 1], [32, 16, 32, 1], [16, 8, 64, 1], [8, 8, 128, 1], [8, 3, 128, 1]]);
    add(2, &[[32, 32, 128, 1]]);
    add(4, &[[16, 16, 128, 1], [16, 32, 128, 2], [64, 64, 32, 1], [128, 128, 16, 1], [256, 256, 8, 1]]);
    let square =
        ConvShape { batch: 4, inputs: 64, outputs: 64, size: [32; 2], kernel: [1; 2], stride: 1, padding: [0; 2] };
    let line = |inputs, outputs, len, stride| ConvShape {
        batch: 4,
        inputs,
        outputs,
        size: [1, len],
        kernel: [1, 9],
        stride,
        padding: [0, 4],
    };
    shapes.extend([square, line(1, 32, 16384, 1), line(32, 32, 4096, 1)]);
    shapes
}

/// As in the bench's table and files: batch x inputs x rows x columns, outputs, kernel, stride.
fn name(shape: &ConvShape) -> String {
    let ([h, w], [kh, kw]) = (shape.size, shape.kernel);
    format!("{}x{}x{h}x{w} to {}, {kh}x{kw} by {}", shape.batch, shape.inputs, shape.outputs, shape.stride)
}

/// As in the bench's table and files.
fn pass_name(pass: Pass) -> &'static str {
    match pass {
        Pass::Forward => "forward",
        Pass::InputGradient => "input gradient",
        Pass::WeightGradient => "weight gradient",
    }
}

/// Multiplications and additions of one pass, padding counted as PyTorch's and ours do.
fn flops(shape: &ConvShape) -> f64 {
    let stride = shape.size.map(|n| if n == 1 { 1 } else { shape.stride });
    let output = [0, 1].map(|d| (shape.size[d] + 2 * shape.padding[d] - shape.kernel[d]) / stride[d] + 1);
    let numbers = [shape.batch, shape.outputs, output[0], output[1], shape.inputs, shape.kernel[0], shape.kernel[1]];
    2.0 * numbers.iter().product::<usize>() as f64
}

/// As in the files that the script reads and writes.
fn key(shape: &ConvShape, pass: Pass) -> String {
    format!("{}, {}", name(shape), pass_name(pass))
}

/// One turn of PyTorch's; gives its times of all turns in this folder.
fn run_torch(python: &Path, folder: &Path, shapes: &[ConvShape]) -> anyhow::Result<Samples> {
    let [script, own, torch] = ["pytorch_conv.py", "shapes.json", "torch.json"].map(|name| folder.join(name));
    let named: BTreeMap<String, &ConvShape> = shapes.iter().map(|shape| (name(shape), shape)).collect();
    std::fs::write(&script, SCRIPT)?;
    std::fs::write(&own, serde_json::to_vec(&BTreeMap::from([("shapes", named)]))?)?;
    let status = Command::new(python).arg(&script).arg(&own).arg(&torch).status();
    let status = status.with_context(|| format!("cannot start {} (--torch)", python.display()))?;
    anyhow::ensure!(status.success(), "{} (--torch) ended with {status}; does it have PyTorch?", python.display());
    let times = std::fs::read(&torch).with_context(|| format!("{}: the script wrote no times", torch.display()))?;
    serde_json::from_slice(&times).with_context(|| torch.display().to_string())
}

/// Median and smallest.
fn summary(samples: &[f64]) -> (f64, f64) {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    (sorted[sorted.len() / 2], sorted[0])
}
