//! Per-view appearance: other days, other cameras, other skies. A code of
//! numbers a view changes colour and never geometry (NeRF-W's embedding on an
//! explicit field): an affine colour transform for the inner box, one for the
//! surroundings, the sky behind everything as spherical harmonics.
//!
//! A pixel is linear in the field's colours, which keeps stage 2 linear, and linear in the
//! code, so that fitting a code to a new photograph is one small least-squares problem (`prior.rs`).

use crate::grid::real::Real;
use crate::grid::sh::{SH, SH_DC};
use crate::render::composite::Gathered;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// Features a pixel's channel is a linear combination of: near colour (3), near
/// weight, far colour (3), far weight, and the sky's basis (9) times what light
/// is left.
pub const FEATURES: usize = 8 + SH;

/// Numbers of an appearance code: the features' weights.
pub const CODE: usize = 3 * FEATURES;

/// One appearance code: for each output channel the weights of the [`FEATURES`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Appearance {
    /// `3 x FEATURES`.
    #[serde(deserialize_with = "sound_code")]
    code: Vec<f32>,
}

/// A code from a file, its numbers counted.
fn sound_code<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f32>, D::Error> {
    let code = Vec::deserialize(from)?;
    let got = code.len();
    let sound = Appearance::from_code(code).map(|appearance| appearance.code);
    sound.ok_or_else(|| D::Error::custom(format!("an appearance has {CODE} finite numbers, got {got}")))
}

/// An appearance's weights by feature, one of padding behind its channels': four are worked out at once.
pub(crate) struct Shades([[f32; 4]; FEATURES]);

impl Shades {
    /// [`Appearance::shade`], to the same bits.
    #[inline(always)]
    pub(crate) fn of(&self, features: &[f32; FEATURES]) -> [f32; 3] {
        let mut sum = [0.0; 4];
        for (weights, feature) in self.0.iter().zip(features) {
            for c in 0..4 {
                sum[c] += weights[c] * feature;
            }
        }
        [sum[0], sum[1], sum[2]]
    }
}

impl Appearance {
    /// Colours as stored, in front of a `background` of one colour.
    pub fn neutral(background: [f32; 3]) -> Self {
        let mut code = vec![0.0; CODE];
        for c in 0..3 {
            code[c * FEATURES + c] = 1.0;
            code[c * FEATURES + 4 + c] = 1.0;
            code[c * FEATURES + 8] = background[c] / SH_DC as f32;
        }
        Self { code }
    }

    /// Wraps `3 x FEATURES` weights; `None` when the count is wrong or one is not finite.
    pub fn from_code(code: Vec<f32>) -> Option<Self> {
        (code.len() == CODE && code.iter().all(|v| v.is_finite())).then_some(Self { code })
    }

    /// The weights, `3 x FEATURES`.
    pub fn code(&self) -> &[f32] {
        &self.code
    }

    pub(crate) fn code_mut(&mut self) -> &mut [f32] {
        &mut self.code
    }

    /// The way from this appearance (`share` 0) to `other` (`share` 1); both ends exactly.
    #[must_use]
    pub fn mixed(&self, other: &Self, share: f32) -> Self {
        // a + (b - a) may be rounded off b.
        if share == 1.0 {
            return other.clone();
        }
        let code = self.code.iter().zip(&other.code).map(|(a, b)| a + (b - a) * share).collect();
        Self { code }
    }

    /// The mean of all; `None` of none, or where it is beyond f32.
    pub(crate) fn mean(all: &[&Self]) -> Option<Self> {
        let n = all.len() as f64;
        let mut mean = vec![0.0; all.first()?.code.len()];
        for a in all {
            mean.iter_mut().zip(&a.code).for_each(|(m, v)| *m += f64::from(*v) / n);
        }
        Self::from_code(mean.into_iter().map(|v| v as f32).collect())
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

    /// [`Appearance::shade`] for the many pixels of a picture.
    pub(crate) fn shades(&self) -> Shades {
        Shades(std::array::from_fn(|k| [0, 1, 2, 3].map(|c| if c < 3 { self.code[c * FEATURES + k] } else { 0.0 })))
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
    pub(crate) fn near_matrix(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|c| std::array::from_fn(|k| self.code[c * FEATURES + k]))
    }

    /// As [`Appearance::near_matrix`], for the surroundings.
    pub(crate) fn far_matrix(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|c| std::array::from_fn(|k| self.code[c * FEATURES + 4 + k]))
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

#[cfg(test)]
mod tests {
    use super::{Appearance, CODE, FEATURES};

    #[test]
    fn a_pictures_pixels_are_shaded_to_the_same_bits_as_one() {
        // Of both signs and many sizes, so that another order of sums would show.
        let number = |i: usize| ((i * 7919 % 1013) as f32 - 506.0) * 10f32.powi(i as i32 % 7 - 4);
        let look = Appearance::from_code((0..CODE).map(number).collect()).expect("finite numbers");
        let shades = look.shades();
        for pixel in 0..100 {
            let features: [f32; FEATURES] = std::array::from_fn(|k| number(pixel * 31 + k));
            assert_eq!(shades.of(&features).map(f32::to_bits), look.shade(&features).map(f32::to_bits));
        }
    }
}
