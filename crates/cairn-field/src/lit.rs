//! The likeliest appearance of a photograph where a view's light is a mixture of basis lights. A pixel
//! is linear in the lights and linear in the rest of the code, but not in both, so that the normal
//! equations of the regression in `prior.rs` are solved some times over, each time about the
//! code found last (Gauss and Newton's method).

use crate::appearance::{Appearance, CODE, FEATURES, SHADE, features};
use crate::cholesky::{factor, solve};
use crate::lights::LIGHTS;
use crate::picture::{PerLight, Seen};
use crate::prior::Prior;
use rayon::prelude::*;

/// Steps at most.
const MOST_STEPS: usize = 12;
/// A step that gains a smaller share is the last.
const ENOUGH: f64 = 1e-7;
/// Pixels whose sums are worked out together: sums come in one order, whatever the threads.
const PIECE: usize = 4096;

/// A pixel under none of the basis lights, and what a unit of each adds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Unlit {
    features: [f32; FEATURES],
    lit: PerLight,
}

impl Unlit {
    /// The pixel that was `seen` under no basis light.
    pub(crate) fn of(seen: &Seen<'_>) -> Self {
        Self { features: features(&seen.gathered, &seen.harmonics), lit: seen.per_light() }
    }

    /// The pixel's features under these lights.
    fn under(&self, lights: &[f64]) -> [f64; FEATURES] {
        let mut f = self.features.map(f64::from);
        for (lit, by) in self.lit.iter().zip(lights) {
            for k in 0..3 {
                f[k] += by * f64::from(lit[k]);
                f[4 + k] += by * f64::from(lit[3 + k]);
            }
        }
        f
    }
}

/// The normal equations of a regression about some code.
pub(crate) struct Normal<'a> {
    code: &'a [f64],
    /// One by the number of pixels.
    share: f64,
    /// `CODE x CODE`, the lower triangle; the channels' own blocks are still in `gram`.
    matrix: Vec<f64>,
    right: Vec<f64>,
    /// Sum of features times features, which all channels share.
    gram: [[f64; FEATURES]; FEATURES],
}

impl<'a> Normal<'a> {
    /// About `code`, of `pixels` pixels and what `prior` says of codes.
    pub(crate) fn at(prior: &Prior, code: &'a [f64], pixels: usize) -> Self {
        let off: Vec<f64> = code.iter().zip(prior.mean.code()).map(|(v, m)| v - f64::from(*m)).collect();
        let right = prior.precision.chunks_exact(CODE).map(|row| -dot(row, &off)).collect();
        Self { matrix: prior.precision.clone(), right, ..Self::nothing(code, pixels) }
    }

    /// About `code`, of `pixels` pixels and nothing else.
    fn nothing(code: &'a [f64], pixels: usize) -> Self {
        Self {
            code,
            share: 1.0 / pixels.max(1) as f64,
            matrix: vec![0.0; CODE * CODE],
            right: vec![0.0; CODE],
            gram: [[0.0; FEATURES]; FEATURES],
        }
    }

    /// Adds what `other`, about the same code, has.
    fn take(&mut self, other: &Self) {
        let mine = self.matrix.iter_mut().chain(&mut self.right).chain(self.gram.as_flattened_mut());
        let theirs = other.matrix.iter().chain(&other.right).chain(other.gram.as_flattened());
        mine.zip(theirs).for_each(|(sum, v)| *sum += v);
    }

    /// Adds a pixel that shows the features `f`; `lit` is what a unit of each light adds to it.
    pub(crate) fn add(&mut self, f: &[f64; FEATURES], lit: Option<&PerLight>, pixel: &[f32; 3]) {
        for (a, row) in self.gram.iter_mut().enumerate() {
            for b in 0..=a {
                row[b] += self.share * f[a] * f[b];
            }
        }
        for (c, pixel) in pixel.iter().enumerate() {
            let of = &self.code[c * FEATURES..][..FEATURES];
            let residual = self.share * (f64::from(*pixel) - dot(of, f));
            let right = &mut self.right[c * FEATURES..][..FEATURES];
            right.iter_mut().zip(f).for_each(|(sum, f)| *sum += residual * f);
            let Some(lit) = lit else { continue };
            let slope: [f64; LIGHTS] = std::array::from_fn(|j| {
                (0..3).map(|k| of[k] * f64::from(lit[j][k]) + of[4 + k] * f64::from(lit[j][3 + k])).sum()
            });
            for j in 0..LIGHTS {
                self.right[SHADE + j] += residual * slope[j];
                let by = self.share * slope[j];
                let row = &mut self.matrix[(SHADE + j) * CODE..][..CODE];
                row[c * FEATURES..][..FEATURES].iter_mut().zip(f).for_each(|(sum, f)| *sum += by * f);
                row[SHADE..=SHADE + j].iter_mut().zip(&slope).for_each(|(sum, s)| *sum += by * s);
            }
        }
    }

    /// The way from the code to where the equations hold; `None` when a number is not finite.
    pub(crate) fn step(mut self) -> Option<Vec<f64>> {
        for c in 0..3 {
            for a in 0..FEATURES {
                let row = &mut self.matrix[(c * FEATURES + a) * CODE + c * FEATURES..][..=a];
                row.iter_mut().zip(&self.gram[a]).for_each(|(sum, g)| *sum += g);
            }
        }
        factor(&mut self.matrix, CODE)?;
        solve(&self.matrix, &mut self.right);
        Some(self.right)
    }
}

impl Prior {
    /// As [`Prior::fit`], of pixels whose lights are not known either: from the mean on, steps that are halved
    /// until they gain.
    pub(crate) fn fit_lit(&self, unlit: &[Unlit], pixels: &[[f32; 3]]) -> Option<Appearance> {
        debug_assert_eq!(unlit.len(), pixels.len());
        let mut code: Vec<f64> = self.mean.code().iter().map(|v| f64::from(*v)).collect();
        let mut cost = self.cost(&code, unlit, pixels);
        for _ in 0..MOST_STEPS {
            let Some(step) = self.newton(&code, unlit, pixels) else { break };
            let along = |share: f64| -> Vec<f64> { code.iter().zip(&step).map(|(v, by)| v + share * by).collect() };
            let shares = (0..10).map(|n| 0.5f64.powi(n));
            let tried = shares.map(along).map(|next| (self.cost(&next, unlit, pixels), next));
            let Some((gained, next)) = tried.into_iter().find(|(other, _)| *other < cost) else { break };
            let last = cost - gained < ENOUGH * cost;
            (cost, code) = (gained, next);
            if last {
                break;
            }
        }
        Appearance::from_code(code.into_iter().map(|v| v as f32).collect()).filter(|_| cost.is_finite())
    }

    /// What [`Prior::fit`] minimises, at `code`.
    fn cost(&self, code: &[f64], unlit: &[Unlit], pixels: &[[f32; 3]]) -> f64 {
        let error = |(unlit, pixel): (&Unlit, &[f32; 3])| -> f64 {
            let f = unlit.under(&code[SHADE..]);
            let channel = |c: usize| f64::from(pixel[c]) - dot(&code[c * FEATURES..][..FEATURES], &f);
            (0..3).map(|c| channel(c).powi(2)).sum()
        };
        let pieces = unlit.par_chunks(PIECE).zip(pixels.par_chunks(PIECE));
        let sums: Vec<f64> = pieces.map(|(unlit, pixels)| unlit.iter().zip(pixels).map(error).sum()).collect();
        let told = sums.into_iter().sum::<f64>() / unlit.len().max(1) as f64;
        let off: Vec<f64> = code.iter().zip(self.mean.code()).map(|(v, m)| v - f64::from(*m)).collect();
        told + self.precision.chunks_exact(CODE).zip(&off).map(|(row, a)| a * dot(row, &off)).sum::<f64>()
    }

    /// Gauss and Newton's step from `code`.
    fn newton(&self, code: &[f64], unlit: &[Unlit], pixels: &[[f32; 3]]) -> Option<Vec<f64>> {
        let mut normal = Normal::at(self, code, unlit.len());
        let pieces = unlit.par_chunks(PIECE).zip(pixels.par_chunks(PIECE));
        let sums: Vec<Normal<'_>> = pieces
            .map(|(some, pixels)| {
                let mut sum = Normal::nothing(code, unlit.len());
                for (unlit, pixel) in some.iter().zip(pixels) {
                    sum.add(&unlit.under(&code[SHADE..]), Some(&unlit.lit), pixel);
                }
                sum
            })
            .collect();
        sums.iter().for_each(|sum| normal.take(sum));
        normal.step()
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, k: usize) -> f32 {
        // A frequency of its own for each number makes them independent.
        (n as f32 * (0.31 + 0.113 * k as f32)).sin()
    }

    fn pixels_of(truth: &Appearance, count: usize) -> (Vec<Unlit>, Vec<[f32; 3]>) {
        let lit = |n: usize| std::array::from_fn(|j| std::array::from_fn(|k| 0.5 * wave(n, FEATURES + 6 * j + k)));
        let unlit: Vec<Unlit> =
            (0..count).map(|n| Unlit { features: std::array::from_fn(|k| wave(n, k)), lit: lit(n) }).collect();
        let lights = truth.lights().map(f64::from);
        let pixels = unlit.iter().map(|u| truth.shade(&u.under(&lights)).map(|v| v as f32)).collect();
        (unlit, pixels)
    }

    fn code(of: impl Fn(usize) -> f32) -> Appearance {
        Appearance::from_code((0..CODE).map(of).collect()).unwrap()
    }

    #[test]
    fn a_fit_finds_the_lights_and_the_code_that_made_the_pixels() {
        let neutral = Appearance::neutral([0.3; 3]);
        let truth = code(|k| neutral.code()[k] + 0.3 * (k as f32 * 0.7).sin());
        // More than one piece.
        let (unlit, pixels) = pixels_of(&truth, 5000);
        let found = Prior::around(neutral.clone()).fit_lit(&unlit, &pixels).unwrap();
        let off = |k: usize| (found.code()[k] - truth.code()[k]).abs();
        // The prior's share is some thousandths of what pixels say.
        assert!((0..CODE).all(|k| off(k) < 0.01), "{:?}", (0..CODE).map(off).fold(0.0, f32::max));
        assert!((0..LIGHTS).any(|k| truth.lights()[k].abs() > 0.2), "there is light to be found");
        // And it is where what is minimised has no slope.
        let prior = Prior::around(neutral);
        let at = |k: usize, by: f64| {
            let mut code: Vec<f64> = found.code().iter().map(|v| f64::from(*v)).collect();
            code[k] += by;
            prior.cost(&code, &unlit, &pixels)
        };
        for k in 0..CODE {
            let slope = (at(k, 1e-4) - at(k, -1e-4)) / 2e-4;
            assert!(slope.abs() < 1e-5, "{k}: {slope}");
        }
    }

    #[test]
    fn lights_that_show_nothing_change_nothing() {
        let truth = code(|k| 0.3 * (k as f32 * 0.7).sin());
        let (mut unlit, _) = pixels_of(&truth, 400);
        unlit.iter_mut().for_each(|u| u.lit = PerLight::default());
        let pixels: Vec<[f32; 3]> = unlit.iter().map(|u| truth.shade(&u.features)).collect();
        let features: Vec<[f32; FEATURES]> = unlit.iter().map(|u| u.features).collect();
        let prior = Prior::around(Appearance::neutral([0.3; 3]));
        let (lit, plain) = (prior.fit_lit(&unlit, &pixels), prior.fit(&features, &pixels));
        let (lit, plain) = (lit.unwrap(), plain.unwrap());
        assert!(lit.code().iter().zip(plain.code()).all(|(a, b)| (a - b).abs() < 1e-5));
        assert_eq!(lit.lights(), [0.0; LIGHTS]);
    }

    #[test]
    fn numbers_that_no_light_has_are_refused() {
        let prior = Prior::around(Appearance::neutral([0.3; 3]));
        let (unlit, pixels) = pixels_of(&code(|_| 0.1), 50);
        for bad in [f32::NAN, f32::INFINITY] {
            let mut wrong = pixels.clone();
            wrong[7][1] = bad;
            assert_eq!(prior.fit_lit(&unlit, &wrong), None);
            let mut wrong = unlit.clone();
            wrong[7].lit[2][4] = bad;
            assert_eq!(prior.fit_lit(&wrong, &pixels), None);
        }
    }
}
