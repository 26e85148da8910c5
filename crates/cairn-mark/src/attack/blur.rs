//! Gaussian blur with the border repeated, and its transpose.

use rayon::prelude::*;

/// A Gaussian kernel, cut off at three standard deviations.
pub(crate) struct Blur {
    /// From the middle outwards; both sides together sum to one.
    taps: Vec<f32>,
}

impl Blur {
    /// `sigma_px`, px; 0 leaves pictures as they are.
    pub(crate) fn new(sigma_px: f32) -> Self {
        let reach = (3.0 * sigma_px).ceil().max(0.0) as usize;
        let weight = |k: usize| if sigma_px > 0.0 { (-0.5 * (k as f32 / sigma_px).powi(2)).exp() } else { 1.0 };
        let taps: Vec<f32> = (0..=reach).map(weight).collect();
        let total = taps[0] + 2.0 * taps[1..].iter().sum::<f32>();
        Self { taps: taps.iter().map(|t| t / total).collect() }
    }

    /// Of `height x width x 3` numbers, size = [width, height].
    pub(crate) fn apply(&self, rgb: &[f32], [w, h]: [usize; 2]) -> Vec<f32> {
        let mut across = vec![0.0; rgb.len()];
        across.par_chunks_exact_mut(w * 3).zip(rgb.par_chunks_exact(w * 3)).for_each(|(out, row)| {
            self.taps(|offset, weight| {
                for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
                    let from = &row[near(x, offset, w) * 3..][..3];
                    pixel.iter_mut().zip(from).for_each(|(o, v)| *o += weight * v);
                }
            });
        });
        let mut out = vec![0.0; rgb.len()];
        out.par_chunks_exact_mut(w * 3).enumerate().for_each(|(y, row)| {
            self.taps(|offset, weight| {
                let from = &across[near(y, offset, h) * w * 3..][..w * 3];
                row.iter_mut().zip(from).for_each(|(o, v)| *o += weight * v);
            });
        });
        out
    }

    /// The transpose of [`Blur::apply`].
    pub(crate) fn transpose(&self, slope: &[f32], [w, h]: [usize; 2]) -> Vec<f32> {
        let mut across = vec![0.0; slope.len()];
        for (y, row) in slope.chunks_exact(w * 3).enumerate() {
            self.taps(|offset, weight| {
                let to = &mut across[near(y, offset, h) * w * 3..][..w * 3];
                to.iter_mut().zip(row).for_each(|(t, s)| *t += weight * s);
            });
        }
        let mut out = vec![0.0; slope.len()];
        for (out, row) in out.chunks_exact_mut(w * 3).zip(across.chunks_exact(w * 3)) {
            self.taps(|offset, weight| {
                for (x, pixel) in row.chunks_exact(3).enumerate() {
                    let to = &mut out[near(x, offset, w) * 3..][..3];
                    to.iter_mut().zip(pixel).for_each(|(t, s)| *t += weight * s);
                }
            });
        }
        out
    }

    fn taps(&self, mut f: impl FnMut(isize, f32)) {
        let reach = self.taps.len() as isize - 1;
        (-reach..=reach).for_each(|k| f(k, self.taps[k.unsigned_abs()]));
    }
}

/// `at + offset`, held inside `0..len`.
fn near(at: usize, offset: isize, len: usize) -> usize {
    at.saturating_add_signed(offset).min(len - 1)
}
