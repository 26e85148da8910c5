//! Times candle's convolution against ours.
use std::time::Instant;

use cairn_nn::{Window, conv2d};
use candle_core::{Device, Result, Tensor, Var};

fn median_ms(runs: usize, mut f: impl FnMut() -> Result<()>) -> Result<f64> {
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
    Ok(times[0])
}

fn main() -> Result<()> {
    for (ci, co, n, size, stride) in [(32, 32, 2, 128, 1), (16, 16, 4, 128, 1), (16, 32, 4, 128, 2), (64, 64, 4, 32, 1)]
    {
        let x = Var::randn(0f32, 1., (n, ci, size, size), &Device::Cpu)?;
        let w = Var::randn(0f32, 0.1, (co, ci, 3, 3), &Device::Cpu)?;
        let ours = |x: &Tensor, w: &Tensor| conv2d(x, w, None, Window::square(stride, 1));
        let theirs = |x: &Tensor, w: &Tensor| x.conv2d(w, 1, stride, 1, 1);
        let (f0, b0) = pair(&x, &w, ours, 40)?;
        let (f1, b1) = pair(&x, &w, theirs, 5)?;
        println!(
            "{ci:3} -> {co:3}  {n} x {size} x {size} stride {stride}: ours {f0:.2} / {b0:.2} ms, candle {f1:.2} / {b1:.2} ms (forward / forward+backward)"
        );
    }
    Ok(())
}

fn pair(x: &Var, w: &Var, f: impl Fn(&Tensor, &Tensor) -> Result<Tensor>, runs: usize) -> Result<(f64, f64)> {
    let (dx, dw) = (x.detach(), w.detach());
    let forward = median_ms(runs, || f(&dx, &dw).map(drop))?;
    let both = median_ms(runs, || f(x, w)?.backward().map(drop))?;
    Ok((forward, both))
}
