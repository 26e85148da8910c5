//! Times candle's convolution against ours, and one training step of both
//! networks. `tests/reference/torch_speed.py` prints PyTorch's side.
//!
//! `cargo run --release -p cairn-nn --example conv_speed`; medians, and the
//! fastest run, which other load on the machine disturbs least.

use std::time::Instant;

use cairn_nn::{
    Adam, AdamConfig, Classifier, ClassifierConfig, Params, Rate, Result, UNet, UNetConfig, Window, conv2d,
    cross_entropy, mean_squared, softmax,
};
use candle_core::{Device, Tensor, Var};

/// Input channels, output channels, batch, side, stride.
const CASES: [(usize, usize, usize, usize, usize); 4] =
    [(32, 32, 2, 128, 1), (16, 16, 4, 128, 1), (16, 32, 4, 128, 2), (64, 64, 4, 32, 1)];

fn main() -> Result<()> {
    println!("{} threads; times in ms as median (fastest)", rayon::current_num_threads());
    for (ci, co, n, side, stride) in CASES {
        let x = Var::from_tensor(&wave(&[n, ci, side, side])?)?;
        let w = Var::from_tensor(&(wave(&[co, ci, 3, 3])? * 0.1)?)?;
        println!("{ci} -> {co} channels, {n} x {side} x {side}, stride {stride}");
        compare("cairn ", &x, &w, 30, |x, w| Ok(conv2d(x, w, None, Window::square(stride, 1))?))?;
        compare("candle", &x, &w, 5, |x, w| Ok(x.conv2d(w, 1, stride, 1, 1)?))?;
    }
    step_times()
}

fn compare(name: &str, x: &Var, w: &Var, runs: usize, f: impl Fn(&Tensor, &Tensor) -> Result<Tensor>) -> Result<()> {
    let (fixed_x, fixed_w) = (x.detach(), w.detach());
    let forward = time(runs, || f(&fixed_x, &fixed_w).map(drop))?;
    let both = time(runs, || Ok(f(x, w)?.backward().map(drop)?))?;
    println!("  {name} forward {forward}, forward and backward {both}");
    Ok(())
}

/// Classifier and detector, forward, backward and optimiser, with the gradient
/// of the pictures, batch 4 at 128 x 128.
fn step_times() -> Result<()> {
    let mut params = Params::new(1);
    let classifier = Classifier::new(&ClassifierConfig::default(), 4, params.scope("classifier"))?;
    let detector = UNet::new(&UNetConfig::default(), 4, params.scope("detector"))?;
    let mut adam = Adam::new(AdamConfig::default(), Rate::constant(1e-3))?;
    let images = Var::from_tensor(&wave(&[4, 3, 128, 128])?)?;
    let target = wave(&[4, 3, 128, 128])?;
    let guess = wave(&[4, 4])?;
    let classify = || -> Result<Tensor> { cross_entropy(&classifier.forward(&images)?, &[0, 1, 2, 3]) };
    let recover = |p: &Tensor| -> Result<Tensor> { mean_squared(&detector.forward(&images, p)?, &target) };
    println!("batch 4 at 128 x 128, {} parameters", params.numbers());
    println!("  classifier forward {}", time(20, || classify().map(drop))?);
    println!("  classifier forward and backward {}", time(20, || Ok(classify()?.backward().map(drop)?))?);
    println!("  detector forward {}", time(20, || recover(&guess).map(drop))?);
    println!("  detector forward and backward {}", time(20, || Ok(recover(&guess)?.backward().map(drop)?))?);
    let step = time(20, || {
        let logits = classifier.forward(&images)?;
        let class = cross_entropy(&logits, &[0, 1, 2, 3])?;
        let loss = (class + recover(&softmax(&logits)?.detach())?)?;
        adam.step(&params, &loss.backward()?)
    })?;
    println!("  whole step with Adam {step}");
    Ok(())
}

fn time(runs: usize, mut f: impl FnMut() -> Result<()>) -> Result<String> {
    for _ in 0..3 {
        f()?;
    }
    let mut times = Vec::with_capacity(runs);
    for _ in 0..runs {
        let start = Instant::now();
        f()?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    Ok(format!("{:.2} ({:.2})", times[runs / 2], times[0]))
}

fn wave(shape: &[usize]) -> Result<Tensor> {
    let count: usize = shape.iter().product();
    let data: Vec<f32> = (0..count).map(|i| 0.5 + 0.4 * (i as f32 * 0.7391).sin()).collect();
    Ok(Tensor::from_vec(data, shape, &Device::Cpu)?)
}
