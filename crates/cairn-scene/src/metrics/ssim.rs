//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004), with the
//! paper's 11 x 11 Gaussian window.
//!
//! Same choices as scikit-image's `structural_similarity(gaussian_weights=True,
//! sigma=1.5, use_sample_covariance=False, data_range=1)`: only windows that lie
//! wholly inside the picture count, and colour is the mean over the channels.
//! A picture smaller than the window is an error and not a smaller window: the
//! figure would look comparable and would not be.

use crate::images::picture::Picture;
use rayon::prelude::*;

use crate::metrics::error::MetricError;
use crate::metrics::picture::comparable;

/// Side of the Gaussian window, px; no picture may be smaller.
pub const SSIM_WINDOW: usize = 11;

/// Standard deviation of the window, px.
const SIGMA: f64 = 1.5;
/// `(K1 L)^2` with K1 = 0.01 and data range L = 1.
const C1: f64 = 0.01 * 0.01;
/// `(K2 L)^2` with K2 = 0.03 and data range L = 1.
const C2: f64 = 0.03 * 0.03;

/// Weighted moments of one window: E[a], E[b], E[aa], E[bb], E[ab].
type Moments = [f64; 5];

/// SSIM of two pictures (data range 1), 1 for identical ones; at least -1.
/// Constant pictures are fine: the constants C1 and C2 keep it defined.
///
/// # Errors
/// [`MetricError`] for different sizes, a side under [`SSIM_WINDOW`], or a
/// number that is not finite.
pub fn ssim(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    let rows = window_values(a, b)?;
    let windows: usize = rows.iter().map(Vec::len).sum();
    Ok(rows.iter().map(|row| row.iter().sum::<f64>()).sum::<f64>() / windows as f64)
}

/// SSIM of every window, mean over channels: `height - 10` rows of `width - 10`.
fn window_values(a: &Picture, b: &Picture) -> Result<Vec<Vec<f64>>, MetricError> {
    comparable(a, b)?;
    let (width, height) = (a.width(), a.height());
    if width < SSIM_WINDOW || height < SSIM_WINDOW {
        return Err(MetricError::TooSmall { window: SSIM_WINDOW, width, height });
    }
    let taps = gaussian();
    let across: Vec<Vec<Moments>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let row = y * width * 3..(y + 1) * width * 3;
            filter_row(&a.rgb()[row.clone()], &b.rgb()[row], &taps)
        })
        .collect();
    Ok((0..=height - SSIM_WINDOW).into_par_iter().map(|y| finish_row(&across[y..y + SSIM_WINDOW], &taps)).collect())
}

/// The horizontal half of the separable filter: moments for each valid column
/// and channel of one row.
fn filter_row(a: &[f32], b: &[f32], taps: &[f64; SSIM_WINDOW]) -> Vec<Moments> {
    let valid = a.len() - 3 * (SSIM_WINDOW - 1);
    (0..valid)
        .map(|at| {
            let mut sum = [0.0; 5];
            for (k, tap) in taps.iter().enumerate() {
                let (p, q) = (f64::from(a[at + 3 * k]), f64::from(b[at + 3 * k]));
                for (s, v) in sum.iter_mut().zip([p, q, p * p, q * q, p * q]) {
                    *s += tap * v;
                }
            }
            sum
        })
        .collect()
}

/// The vertical half, and SSIM itself, for one row of windows.
fn finish_row(rows: &[Vec<Moments>], taps: &[f64; SSIM_WINDOW]) -> Vec<f64> {
    let mut moments = vec![[0.0; 5]; rows[0].len()];
    for (row, tap) in rows.iter().zip(taps) {
        for (sum, values) in moments.iter_mut().zip(row) {
            for (s, v) in sum.iter_mut().zip(values) {
                *s += tap * v;
            }
        }
    }
    moments.chunks_exact(3).map(|pixel| pixel.iter().map(similarity).sum::<f64>() / 3.0).collect()
}

/// The paper's equation 13 with alpha = beta = gamma = 1.
fn similarity(&[a, b, aa, bb, ab]: &Moments) -> f64 {
    let (variance_a, variance_b, covariance) = (aa - a * a, bb - b * b, ab - a * b);
    ((2.0 * a * b + C1) * (2.0 * covariance + C2)) / ((a * a + b * b + C1) * (variance_a + variance_b + C2))
}

/// The window's one-dimensional weights; they sum to one.
fn gaussian() -> [f64; SSIM_WINDOW] {
    let half = (SSIM_WINDOW / 2) as f64;
    let mut taps: [f64; SSIM_WINDOW] = std::array::from_fn(|i| (-((i as f64 - half) / SIGMA).powi(2) / 2.0).exp());
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|t| *t /= sum);
    taps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Picture {
        let rgb = (0..width * height * 3).map(|i| ((i * 37) % 101) as f32 / 101.0).collect();
        Picture::new(width, height, rgb).unwrap()
    }

    #[test]
    fn identical_pictures_score_one() {
        let a = ramp(17, 11);
        assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn constant_pictures_follow_the_luminance_term() {
        let (a, b) = (Picture::constant(12, 12, [0.25; 3]), Picture::constant(12, 12, [0.5; 3]));
        let expected = (2.0 * 0.125 + C1) / (0.0625 + 0.25 + C1);
        assert!((ssim(&a, &b).unwrap() - expected).abs() < 1e-9);
        let black = Picture::constant(12, 12, [0.0; 3]);
        assert!((ssim(&black, &black).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_picture_under_the_window_is_refused() {
        let a = ramp(10, 40);
        assert_eq!(ssim(&a, &a), Err(MetricError::TooSmall { window: 11, width: 10, height: 40 }));
    }
}
