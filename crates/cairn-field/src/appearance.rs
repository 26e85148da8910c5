//! Per-view appearance: other days, other cameras, other skies. A code of
//! numbers a view changes colour and never geometry (NeRF-W's embedding on an
//! explicit field): an affine colour transform for the inner box, one for the
//! surroundings, and the sky behind everything as spherical harmonics.
//!
//! A pixel is linear in the code and linear in the field's colours. The first
//! makes fitting a code to a new photograph a small least-squares problem with
//! one exact answer; the second keeps stage 2 linear.

use crate::composite::Gathered;
use crate::real::Real;
use crate::sh::SH;
use serde::{Deserialize, Serialize};

/// Features a pixel's channel is a linear combination of: near colour (3), near
/// weight, far colour (3), far weight, and the sky's basis (9) times what light
/// is left.
pub const FEATURES: usize = 8 + SH;

/// One appearance code: for each output channel the weights of the [`FEATURES`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored")]
pub struct Appearance {
    /// `3 x FEATURES`.
    code: Vec<f32>,
}

/// An appearance as a file has it, before its numbers are counted.
#[derive(Deserialize)]
struct Stored {
    code: Vec<f32>,
}

impl TryFrom<Stored> for Appearance {
    type Error = String;

    fn try_from(stored: Stored) -> Result<Self, String> {
        let got = stored.code.len();
        Self::from_code(stored.code)
            .ok_or_else(|| format!("an appearance has {} finite numbers, got {got}", 3 * FEATURES))
    }
}

impl Appearance {
    /// How strongly a fit holds to its prior, for every pixel it has: enough to settle
    /// what the pixels leave open.
    pub const RIDGE: f64 = 1e-3;

    /// Colours as stored, in front of a `background` of one colour.
    pub fn neutral(background: [f32; 3]) -> Self {
        let mut code = vec![0.0; 3 * FEATURES];
        for c in 0..3 {
            code[c * FEATURES + c] = 1.0;
            code[c * FEATURES + 4 + c] = 1.0;
            code[c * FEATURES + 8] = background[c] / crate::sh::SH_DC as f32;
        }
        Self { code }
    }

    /// Wraps `3 x FEATURES` weights; `None` when the count is wrong or one is not finite.
    pub fn from_code(code: Vec<f32>) -> Option<Self> {
        (code.len() == 3 * FEATURES && code.iter().all(|v| v.is_finite())).then_some(Self { code })
    }

    /// The weights, `3 x FEATURES`.
    pub fn code(&self) -> &[f32] {
        &self.code
    }

    pub(crate) fn code_mut(&mut self) -> &mut [f32] {
        &mut self.code
    }

    /// The way from this appearance (`share` 0) to `other` (`share` 1).
    #[must_use]
    pub fn mixed(&self, other: &Self, share: f32) -> Self {
        let code = self.code.iter().zip(&other.code).map(|(a, b)| a + (b - a) * share).collect();
        Self { code }
    }

    /// The weights of one output channel.
    #[inline(always)]
    fn channel<T: Real>(&self, c: usize) -> [T; FEATURES] {
        std::array::from_fn(|k| T::of(f64::from(self.code[c * FEATURES + k])))
    }

    /// The pixel's colour, not clamped.
    pub fn shade<T: Real>(&self, features: &[T; FEATURES]) -> [T; 3] {
        std::array::from_fn(|c| {
            let code = self.channel::<T>(c);
            (0..FEATURES).fold(T::zero(), |sum, k| sum + code[k] * features[k])
        })
    }

    /// From d(loss)/d(pixel) to d(loss)/d(what the ray gathered); `basis` is the
    /// ray's.
    pub fn pull<T: Real>(&self, g: [T; 3], basis: &[T; SH]) -> Gathered<T> {
        let mut out = Gathered::default();
        for c in 0..3 {
            let code = self.channel::<T>(c);
            for k in 0..3 {
                out.near[k] += g[c] * code[k];
                out.far[k] += g[c] * code[4 + k];
            }
            out.near_weight += g[c] * code[3];
            out.far_weight += g[c] * code[7];
            for k in 0..SH {
                out.end += g[c] * code[8 + k] * basis[k];
            }
        }
        out
    }

    /// Adds to `gradient` (`3 x FEATURES`, like the code) what d(loss)/d(pixel)
    /// `g` owes the code at a pixel with these features.
    pub fn add_code_gradient<T: Real>(g: [T; 3], features: &[T; FEATURES], gradient: &mut [T]) {
        for (row, g) in gradient.chunks_exact_mut(FEATURES).zip(g) {
            for k in 0..FEATURES {
                row[k] += g * features[k];
            }
        }
    }

    /// The linear part for colours of the inner box, `3 x 3` row-major
    /// (output channel, stored channel): what a change of colour there becomes.
    pub fn near_matrix(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|c| std::array::from_fn(|k| self.code[c * FEATURES + k]))
    }

    /// As [`Appearance::near_matrix`], for the surroundings.
    pub fn far_matrix(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|c| std::array::from_fn(|k| self.code[c * FEATURES + 4 + k]))
    }

    /// The code that best explains pixels, by ridge regression towards `prior`:
    /// minimises `sum |code . f - pixel|^2 + ridge * |code - prior|^2` exactly.
    /// `features` and `pixels` are of equal length; `ridge` > 0.
    pub fn fit(features: &[[f32; FEATURES]], pixels: &[[f32; 3]], prior: &Self, ridge: f64) -> Self {
        let mut gram = [[0.0f64; FEATURES]; FEATURES];
        let mut right = [[0.0f64; FEATURES]; 3];
        for (f, pixel) in features.iter().zip(pixels) {
            for a in 0..FEATURES {
                for b in 0..=a {
                    gram[a][b] += f64::from(f[a]) * f64::from(f[b]);
                }
                for c in 0..3 {
                    right[c][a] += f64::from(f[a]) * f64::from(pixel[c]);
                }
            }
        }
        for a in 0..FEATURES {
            gram[a][a] += ridge;
            for c in 0..3 {
                right[c][a] += ridge * f64::from(prior.code[c * FEATURES + a]);
            }
        }
        cholesky(&mut gram);
        let code = right.iter().flat_map(|r| solve(&gram, r)).map(|v| v as f32).collect();
        Self { code }
    }
}

/// The features of a pixel from what its ray gathered.
pub fn features<T: Real>(gathered: &Gathered<T>, basis: &[T; SH]) -> [T; FEATURES] {
    let mut f = [T::zero(); FEATURES];
    f[..3].copy_from_slice(&gathered.near);
    f[3] = gathered.near_weight;
    f[4..7].copy_from_slice(&gathered.far);
    f[7] = gathered.far_weight;
    for k in 0..SH {
        f[8 + k] = gathered.end * basis[k];
    }
    f
}

/// In place, lower triangle; the matrix is positive definite by its ridge.
fn cholesky(m: &mut [[f64; FEATURES]; FEATURES]) {
    for j in 0..FEATURES {
        for k in 0..j {
            let v = m[j][k];
            for i in j..FEATURES {
                m[i][j] -= m[i][k] * v;
            }
        }
        let d = m[j][j].max(1e-300).sqrt();
        for row in m.iter_mut().skip(j) {
            row[j] /= d;
        }
    }
}

fn solve(l: &[[f64; FEATURES]; FEATURES], b: &[f64; FEATURES]) -> [f64; FEATURES] {
    let mut x = *b;
    for i in 0..FEATURES {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    for i in (0..FEATURES).rev() {
        for k in i + 1..FEATURES {
            x[i] -= l[k][i] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_finds_the_code_that_made_the_pixels() {
        let truth = Appearance::from_code((0..3 * FEATURES).map(|i| (i as f32 * 0.7).sin()).collect()).unwrap();
        let features: Vec<[f32; FEATURES]> = (0..400)
            // A frequency of its own for each feature makes them independent.
            .map(|i| std::array::from_fn(|k| (i as f32 * (0.31 + 0.17 * k as f32)).sin()))
            .collect();
        let pixels: Vec<[f32; 3]> = features.iter().map(|f| truth.shade(f)).collect();
        let found = Appearance::fit(&features, &pixels, &Appearance::neutral([0.0; 3]), 1e-6);
        for (a, b) in found.code().iter().zip(truth.code()) {
            assert!((a - b).abs() < 1e-3, "{a} for {b}");
        }
    }

    #[test]
    fn without_pixels_the_fit_is_the_prior() {
        let prior = Appearance::neutral([0.2, 0.4, 0.6]);
        let found = Appearance::fit(&[], &[], &prior, 1.0);
        for (a, b) in found.code().iter().zip(prior.code()) {
            assert!((a - b).abs() < 1e-6);
        }
    }
}
