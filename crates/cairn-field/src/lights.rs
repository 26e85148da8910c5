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
/// Rounds of power iteration; where two components are as large, either will do.
const ROUNDS: usize = 100;

impl BaseTrainer {
    /// Begins to tell basis lights apart: views begin with mixtures by what tells their appearances apart most
    /// (principal components), and vertices with none of any light.
    pub(crate) fn begin_lights(&mut self) {
        self.colours = Colours::Lit;
        for row in self.grid.colour.chunks_exact_mut(ROW) {
            row[3 * FIRST..3 * SH].fill(0.0);
        }
        let number = |a: &Appearance, k: usize| f64::from(a.code()[k / 4 * FEATURES + k % 4]);
        let near = self.appearances.iter().map(|a| std::array::from_fn(|k| number(a, k))).collect();
        for (appearance, lights) in self.appearances.iter_mut().zip(components(near)) {
            let code = &mut appearance.code_mut()[SHADE..];
            code.iter_mut().zip(lights).for_each(|(v, light)| *v = (SPREAD * light) as f32);
        }
    }
}

/// How much each of some vectors has of their first principal components: of variance 1 each, and within three
/// deviations, so that one odd photograph does not get a light of its own. All zero where vectors do not differ.
fn components(mut of: Vec<[f64; NEAR]>) -> Vec<[f64; LIGHTS]> {
    let n = of.len().max(1) as f64;
    let mean: [f64; NEAR] = std::array::from_fn(|k| of.iter().map(|v| v[k]).sum::<f64>() / n);
    of.iter_mut().flatten().zip(mean.iter().cycle()).for_each(|(v, m)| *v -= m);
    let mut found = vec![[0.0; LIGHTS]; of.len()];
    for light in 0..LIGHTS {
        let axis = first_component(&of);
        let scores: Vec<f64> = of.iter().map(|v| dot(v, &axis)).collect();
        let deviation = (scores.iter().map(|s| s * s).sum::<f64>() / n).sqrt();
        for ((found, v), score) in found.iter_mut().zip(&mut of).zip(scores) {
            found[light] = if deviation > LEAST { (score / deviation).clamp(-3.0, 3.0) } else { 0.0 };
            // The next component is that of what is left.
            v.iter_mut().zip(axis).for_each(|(v, a)| *v -= score * a);
        }
    }
    found
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

    #[test]
    fn components_are_what_vectors_differ_by_most() {
        // Two independent ways to differ, one three times as strong, along skew axes.
        let (a, b): ([f64; NEAR], [f64; NEAR]) =
            (std::array::from_fn(|k| (k as f64).sin()), std::array::from_fn(|k| (1.0 + 2.3 * k as f64).cos()));
        let way = |n: usize| ((n as f64 * 0.9).sin(), (n as f64 * 1.7).sin());
        let of: Vec<[f64; NEAR]> =
            (0..80).map(|n| std::array::from_fn(|k| 5.0 + 0.3 * way(n).0 * a[k] + 0.05 * way(n).1 * b[k])).collect();
        let found = components(of);
        let correlation = |light: usize, of: &dyn Fn(usize) -> f64| {
            let pairs = || (0..80).map(|n| (found[n][light], of(n)));
            let sum = |f: &dyn Fn((f64, f64)) -> f64| pairs().map(f).sum::<f64>();
            sum(&|(x, y)| x * y) / (sum(&|(x, _)| x * x) * sum(&|(_, y)| y * y)).sqrt()
        };
        assert!(correlation(0, &|n| way(n).0).abs() > 0.99, "{}", correlation(0, &|n| way(n).0));
        assert!(correlation(1, &|n| way(n).1).abs() > 0.95, "{}", correlation(1, &|n| way(n).1));
        for light in 0..2 {
            let square = found.iter().map(|f| f[light] * f[light]).sum::<f64>() / 80.0;
            assert!((square - 1.0).abs() < 1e-6, "light {light}: {square}");
        }
        // There are but two.
        assert!(found.iter().all(|f| f[2..] == [0.0; 3]), "{:?}", found[0]);
    }

    #[test]
    fn what_does_not_differ_has_no_light() {
        assert_eq!(components(vec![[0.4; NEAR]; 7]), vec![[0.0; LIGHTS]; 7]);
        assert!(components(Vec::new()).is_empty());
        // One odd photograph among many stays within three deviations.
        let mut odd = vec![[0.4; NEAR]; 60];
        odd[17] = [9.0; NEAR];
        assert!(components(odd).iter().flatten().all(|v| v.abs() <= 3.0));
    }
}
