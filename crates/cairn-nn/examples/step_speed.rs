//! Times the networks' part of a training step as stage 2 takes it by default:
//! the classifier on nine pictures of 128 x 128 with their gradient, the
//! detector on five, Adam.
//!
//! `cargo run --release -p cairn-nn --example step_speed -- [RUNS]`; medians, and
//! the fastest run, which other load on the machine disturbs least.

use std::time::Instant;

use cairn_nn::{
    Adam, AdamConfig, Classifier, ClassifierConfig, Params, Rate, Result, UNet, UNetConfig, cross_entropy,
    mean_absolute, softmax,
};
use candle_core::{Device, Tensor, Var};

fn main() -> Result<()> {
    let runs = std::env::args().nth(1).and_then(|runs| runs.parse().ok()).unwrap_or(30);
    println!("{} threads; times in ms as median (fastest) of {runs}", rayon::current_num_threads());
    // On one of the pool's threads: going there for every operation costs more than small ones take.
    rayon::scope(|_| steps(runs))
}

fn steps(runs: usize) -> Result<()> {
    let mut params = Params::new(1);
    let classifier = Classifier::new(&ClassifierConfig::default(), 4, params.scope("classifier"))?;
    let detector = UNet::new(&UNetConfig::default(), 4, params.scope("detector"))?;
    let mut adam = Adam::new(AdamConfig::default(), Rate::constant(1e-3))?;
    let images = Var::from_tensor(&wave(&[9, 3, 128, 128])?)?;
    let target = wave(&[5, 3, 128, 128])?;
    let classes = [1, 2, 3, 0, 0, 0, 0, 0, 0];
    let classify = || -> Result<Tensor> { cross_entropy(&classifier.forward(&images)?, &classes) };
    let some = |t: &Tensor| -> Result<Tensor> { Ok(t.narrow(0, 0, 5)?.contiguous()?) };
    let seen = some(&images.detach())?;
    let recover = |p: &Tensor| -> Result<Tensor> { mean_absolute(&detector.forward(&seen, p)?, &target) };
    let guess = some(&softmax(&wave(&[9, 4])?)?)?;
    println!("classifier forward {}", time(runs, || classify().map(drop))?);
    println!("classifier forward and backward {}", time(runs, || Ok(classify()?.backward().map(drop)?))?);
    println!("detector forward {}", time(runs, || recover(&guess).map(drop))?);
    println!("detector forward and backward {}", time(runs, || Ok(recover(&guess)?.backward().map(drop)?))?);
    let step = time(runs, || {
        let logits = classifier.forward(&images)?;
        let class = cross_entropy(&logits, &classes)?;
        let loss = (class + recover(&some(&softmax(&logits)?.detach())?)?)?;
        adam.step(&params, &loss.backward()?)
    })?;
    println!("whole step with Adam on {} parameters {step}", params.numbers());
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
