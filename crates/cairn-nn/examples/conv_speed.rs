//! Times each pass of the convolutions that training does, beside PyTorch's.
//!
//! `cargo run --release -p cairn-nn --example conv_speed -- OWN.json [TORCH.json] [FILTER] [RUNS]`
//!
//! Samples are added to those in OWN.json, so that runs can alternate with
//! `benches/pytorch_conv.py` on a machine that others use too. Prints medians
//! and the fastest runs, which other load disturbs least.

use std::collections::BTreeMap;
use std::error::Error;

use cairn_nn::{ConvShape, Pass};
use serde::{Deserialize, Serialize};

const RUNS: usize = 15;

type Samples = BTreeMap<String, Vec<f64>>;

/// What the Python script needs to know of a shape.
#[derive(Serialize, Deserialize)]
struct Shape {
    batch: usize,
    inputs: usize,
    outputs: usize,
    size: [usize; 2],
    kernel: [usize; 2],
    stride: usize,
    padding: [usize; 2],
}

#[derive(Default, Serialize, Deserialize)]
struct Own {
    shapes: BTreeMap<String, Shape>,
    samples: Samples,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().ok_or("name a file for the samples: conv_speed OWN.json [TORCH.json] [FILTER] [RUNS]")?;
    let torch: Samples = match args.next() {
        Some(path) if std::fs::exists(&path)? => serde_json::from_slice(&std::fs::read(path)?)?,
        _ => Samples::new(),
    };
    let filter = args.next().unwrap_or_default();
    let runs = args.next().map_or(Ok(RUNS), |runs| runs.parse())?;
    let mut own = match std::fs::exists(&path)? {
        true => serde_json::from_slice(&std::fs::read(&path)?)?,
        false => Own::default(),
    };
    println!("{} threads; ms as median (fastest)", rayon::current_num_threads());
    println!("{:<34} {:<15} {:>17} {:>8} {:>17}  ratio", "convolution", "pass", "Cairn", "GFLOP/s", "PyTorch");
    for shape in ConvShape::of_training() {
        for pass in Pass::ALL {
            let key = format!("{}, {}", shape.name(), pass.name());
            if key.contains(&filter) {
                let samples = own.samples.entry(key.clone()).or_default();
                samples.extend(shape.time_ms(pass, runs)?);
                print(shape, pass, samples, torch.get(&key))?;
            }
        }
        let ConvShape { batch, inputs, outputs, size, kernel, stride, padding } = shape;
        own.shapes.insert(shape.name(), Shape { batch, inputs, outputs, size, kernel, stride, padding });
    }
    Ok(std::fs::write(&path, serde_json::to_vec(&own)?)?)
}

fn print(shape: ConvShape, pass: Pass, own: &[f64], torch: Option<&Vec<f64>>) -> Result<(), Box<dyn Error>> {
    let [median, fastest] = summary(own);
    let rate = shape.flops()? / fastest * 1e-6;
    print!("{:<34} {:<15} {median:>8.3} ({fastest:>6.3}) {rate:>8.0}", shape.name(), pass.name());
    if let Some(torch) = torch {
        let [m, f] = summary(torch);
        print!(" {m:>8.3} ({f:>6.3})  {:.2} ({:.2})", median / m, fastest / f);
    }
    println!();
    Ok(())
}

/// Median and smallest.
fn summary(samples: &[f64]) -> [f64; 2] {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    [sorted[sorted.len() / 2], sorted[0]]
}
