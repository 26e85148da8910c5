//! What a vertex's nine coefficients a colour channel stand for. In one light they are
//! spherical harmonics of degree 2, as in Plenoxels. Where photographs differ in light, what
//! differs most is not how a place looks from another side but how it is lit: its shadows and the
//! sides that face the sun. There degree 1 has four of them, and five are *basis lights*: what a
//! vertex sends under each, of which every view has its own mixture. Pictures of one thing under any light lie
//! near a space of few dimensions (Epstein, Hallinan and Yuille 1995, "5 +- 2 eigenimages suffice";
//! Basri and Jacobs 2003), so that this is NeRF-W's embedding, which changes each
//! place's colour by itself, and still linear in field and view.

use crate::appearance::{Appearance, FEATURES, SHADE};
use crate::grid::ROW;
use crate::real::Real;
use crate::sh::SH;
use crate::trainer::BaseTrainer;
use serde::{Deserialize, Serialize};

/// Basis lights.
pub const LIGHTS: usize = 5;
/// The first coefficient that is a basis light's where there are any.
pub(crate) const FIRST: usize = SH - LIGHTS;

/// What a vertex's coefficients stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Colours {
    /// Spherical harmonics of degree 2.
    #[default]
    Harmonics,
    /// Spherical harmonics of degree 1, and [`LIGHTS`] basis lights.
    Lit,
}

impl Colours {
    /// What the coefficients are multiplied by along a direction with these `harmonics`, in
    /// a view lit by so much of each basis light.
    #[inline(always)]
    pub fn weights<T: Real>(self, harmonics: &[T; SH], lights: &[f32; LIGHTS]) -> [T; SH] {
        match self {
            Self::Harmonics => *harmonics,
            Self::Lit => {
                let of = |k: usize| if k < FIRST { harmonics[k] } else { T::of(f64::from(lights[k - FIRST])) };
                std::array::from_fn(of)
            }
        }
    }
}

/// Numbers of a code that say how the inner box is lit: for each channel three and an offset.
const NEAR: usize = 12;
/// Standard deviation of the lights that views begin with.
const SPREAD: f64 = 0.3;
/// Learning rate of their coefficients, a share of the constant ones'; three times as much gave the same.
pub(crate) const LIGHTS_RATE: f32 = 0.2;
/// Rounds of power iteration; where two components are as large, either will do.
const ROUNDS: usize = 100;

impl BaseTrainer {
    /// Begins to tell basis lights apart, where settings ask for it and views differ in as many ways: views begin
    /// with mixtures by what tells their appearances apart most (principal components), and vertices with none
    /// of any light.
    pub(crate) fn begin_lights(&mut self) {
        if !(self.config.basis_lights && self.has_appearance()) {
            return;
        }
        let number = |a: &Appearance, k: usize| f64::from(a.code()[k / 4 * FEATURES + k % 4]);
        let near = self.appearances.iter().map(|a| std::array::from_fn(|k| number(a, k))).collect();
        let Some(mixtures) = components(near) else { return };
        self.colours = Colours::Lit;
        for row in self.grid.colour.chunks_exact_mut(ROW) {
            row[3 * FIRST..3 * SH].fill(0.0);
        }
        for (appearance, lights) in self.appearances.iter_mut().zip(mixtures) {
            let code = &mut appearance.code_mut()[SHADE..];
            code.iter_mut().zip(lights).for_each(|(v, light)| *v = (SPREAD * light) as f32);
        }
    }
}

/// How much each of some vectors has of their first principal components: of variance 1 each, and within three
/// deviations, so that one odd photograph does not get a light of its own. `None` where they do not differ in as many
/// ways: a light that is nowhere, of vertices that send nothing under it, has no gradient and never begins.
fn components(mut of: Vec<[f64; NEAR]>) -> Option<Vec<[f64; LIGHTS]>> {
    let n = of.len().max(1) as f64;
    let mean: [f64; NEAR] = std::array::from_fn(|k| of.iter().map(|v| v[k]).sum::<f64>() / n);
    of.iter_mut().flatten().zip(mean.iter().cycle()).for_each(|(v, m)| *v -= m);
    let mut found = vec![[0.0; LIGHTS]; of.len()];
    for light in 0..LIGHTS {
        let axis = first_component(&of);
        let scores: Vec<f64> = of.iter().map(|v| dot(v, &axis)).collect();
        let deviation = (scores.iter().map(|s| s * s).sum::<f64>() / n).sqrt();
        if deviation.is_nan() || deviation <= LEAST {
            return None;
        }
        for ((found, v), score) in found.iter_mut().zip(&mut of).zip(scores) {
            found[light] = (score / deviation).clamp(-3.0, 3.0);
            // The next component is that of what is left.
            v.iter_mut().zip(axis).for_each(|(v, a)| *v -= score * a);
        }
    }
    Some(found)
}

/// A deviation that is rounding.
const LEAST: f64 = 1e-6;

/// The unit vector along which vectors about zero differ most, by power iteration; zero where they do not differ.
fn first_component(of: &[[f64; NEAR]]) -> [f64; NEAR] {
    // No symmetry of colours makes all its products vanish.
    let mut axis: [f64; NEAR] = std::array::from_fn(|k| 1.0 + 0.37 * (1.7 * k as f64).sin());
    for _ in 0..ROUNDS {
        let mut next = [0.0; NEAR];
        for v in of {
            let along = dot(v, &axis);
            next.iter_mut().zip(v).for_each(|(sum, v)| *sum += along * v);
        }
        let length = dot(&next, &next).sqrt();
        if length == 0.0 {
            return next;
        }
        axis = next.map(|v| v / length);
    }
    axis
}

fn dot(a: &[f64; NEAR], b: &[f64; NEAR]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors that differ in some independent ways, each half as strong as the one before.
    fn differing(ways: usize) -> Vec<[f64; NEAR]> {
        let axis = |way: usize, k: usize| ((1 + way) as f64 * 1.3 * (k as f64 + 0.5)).sin();
        let size = |way: usize, n: usize| 0.3 * 0.5f64.powi(way as i32) * (n as f64 * (0.9 + 0.37 * way as f64)).sin();
        let number = |n: usize, k: usize| 5.0 + (0..ways).map(|way| size(way, n) * axis(way, k)).sum::<f64>();
        (0..80).map(|n| std::array::from_fn(|k| number(n, k))).collect()
    }

    #[test]
    fn components_are_unlike_one_another_and_tell_vectors_apart() {
        let of = differing(7);
        let found = components(of.clone()).expect("seven ways to differ");
        let product = |a: usize, b: usize| found.iter().map(|f| f[a] * f[b]).sum::<f64>() / 80.0;
        for light in 0..LIGHTS {
            assert!((product(light, light) - 1.0).abs() < 0.02, "light {light}: {}", product(light, light));
            assert!((0..light).all(|other| product(light, other).abs() < 0.05), "light {light} is like another");
        }
        // The strongest is the one that says most of the vectors: more than any number of them by itself.
        let told = |score: &dyn Fn(usize) -> f64| {
            let all = (0..NEAR).map(|k| {
                let mean = of.iter().map(|v| v[k]).sum::<f64>() / 80.0;
                let along = (0..80).map(|n| (of[n][k] - mean) * score(n)).sum::<f64>();
                along * along / (0..80).map(|n| score(n) * score(n)).sum::<f64>()
            });
            all.sum::<f64>()
        };
        let best = told(&|n| found[n][0]);
        for k in 0..NEAR {
            let mean = of.iter().map(|v| v[k]).sum::<f64>() / 80.0;
            assert!(told(&|n| of[n][k] - mean) <= best * (1.0 + 1e-3), "number {k} tells more");
        }
    }

    #[test]
    fn lights_begin_only_where_views_differ_in_as_many_ways() {
        assert!(components(differing(LIGHTS)).is_some());
        for ways in 0..LIGHTS {
            assert!(components(differing(ways)).is_none(), "{ways} ways");
        }
        assert!(components(differing(7)[..LIGHTS].to_vec()).is_none(), "five views differ in four ways");
        assert!(components(Vec::new()).is_none());
    }

    #[test]
    fn one_odd_photograph_gets_no_light_of_its_own() {
        let mut of = differing(7);
        of[17] = [90.0; NEAR];
        let found = components(of).expect("eight ways to differ");
        assert_eq!(found[17][0].abs(), 3.0);
        assert!(found.iter().flatten().all(|v| v.abs() <= 3.0));
    }
}
