//! Holds the measures to the values that scikit-image, SciPy and NumPy give
//! (tests/metrics_reference/make.py wrote them), on inputs both sides can draw.

use cairn_scene::Picture;
use cairn_scene::metrics::{log_spectral_distance_db, mse, psnr_db, snr_db, ssim};
use serde_json::Value;

const REFERENCE: &str = include_str!("metrics_reference/metrics.json");

fn rows(name: &str) -> Vec<Value> {
    let all: Value = serde_json::from_str(REFERENCE).unwrap();
    all[name].as_array().unwrap().clone()
}

fn number(row: &Value, name: &str) -> f64 {
    row[name].as_f64().unwrap_or_else(|| panic!("no {name} in {row}"))
}

/// `count` numbers in [0, 1): make.py's `draw`.
fn draw(seed: u32, count: usize) -> Vec<f32> {
    let mut state = seed;
    (0..count)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        })
        .collect()
}

/// make.py's `smooth`.
fn smooth(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let at = |x: usize, y: usize, c: usize| values[((y % height) * width + x % width) * 3 + c];
    let mut out = Vec::with_capacity(values.len());
    for (y, x, c) in (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
        let mut total = 0.0;
        for (dy, dx) in (0..3).flat_map(|dy| (0..3).map(move |dx| (dy, dx))) {
            total += at(x + width + 1 - dx, y + height + 1 - dy, c);
        }
        out.push(total / 9.0);
    }
    out
}

fn noisy(clean: &[f32], seed: u32, noise: f32) -> Vec<f32> {
    clean.iter().zip(draw(seed, clean.len())).map(|(v, n)| v + noise * (n - 0.5)).collect()
}

fn close(what: &str, got: f64, row: &Value, name: &str) {
    let expected = number(row, name);
    assert!((got - expected).abs() < 1e-5, "{what}: {name} is {got}, the reference says {expected}");
}

#[test]
fn pictures_agree_with_scikit_image() {
    for row in rows("pictures") {
        let (width, height) = (number(&row, "width") as usize, number(&row, "height") as usize);
        let seed = number(&row, "seed") as u32;
        let clean = smooth(&draw(seed, width * height * 3), width, height);
        let other = noisy(&clean, seed + 100, number(&row, "noise") as f32);
        let (a, b) = (Picture::new(width, height, clean).unwrap(), Picture::new(width, height, other).unwrap());
        let what = format!("{width} x {height}, seed {seed}");
        close(&what, mse(&a, &b).unwrap(), &row, "mse");
        close(&what, psnr_db(&a, &b).unwrap(), &row, "psnr_db");
        close(&what, ssim(&a, &b).unwrap(), &row, "ssim");
    }
}

#[test]
fn sounds_agree_with_scipy() {
    for row in rows("sounds") {
        let (count, seed) = (number(&row, "samples") as usize, number(&row, "seed") as u32);
        let truth: Vec<f32> = draw(seed, count).iter().map(|v| v - 0.5).collect();
        let recovered = noisy(&truth, seed + 100, number(&row, "noise") as f32);
        let what = format!("{count} samples, seed {seed}");
        close(&what, snr_db(&recovered, &truth).unwrap(), &row, "snr_db");
        close(&what, log_spectral_distance_db(&recovered, &truth).unwrap(), &row, "log_spectral_distance_db");
    }
}
