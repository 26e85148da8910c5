//! Whether a scene's photographs differ in light. Appearances of their own for every
//! view are worth many dB where visitors came on other days, and cost time and
//! sharpness where one camera saw one light: so the coarsest field is asked. Until then
//! every view has one: a field without them paints each visitor's light onto the side
//! that only this visitor saw, and then there is nothing left for them to explain.

use super::shown::Shown;
use crate::appearance::code::{Appearance, FEATURES, features};
use crate::appearance::prior::Prior;
use crate::chance::spread;
use crate::render::composite::{Kept, Thresholds, see};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Whether views have appearances of their own, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightVerdict {
    /// The settings say so, or there is one view only.
    Settled,
    /// Not known yet: every view has an appearance until it is.
    Open,
    /// The photographs differ so little that appearances are left out.
    OneLight {
        /// The error (RMS, colours in [0, 1]) that appearances of their own explain and
        /// one for all views does not, at pixels neither was fitted to.
        spread: f32,
    },
    /// They differ by this much (likewise).
    ManyLights {
        /// As above.
        spread: f32,
    },
}

/// Spread from which on appearances are worth having: six steps of an 8-bit colour.
/// docs/design/limits.md has what captures of either sort gave.
pub(super) const WORTH: f32 = 0.025;
/// PSNR in their own light from which on pictures are taken to show the scene, dB: a
/// cloud would look like the mean of each photograph, which differs in any light.
const TOLD_FROM_DB: f64 = 17.0;
/// Pixels of a view that are looked at, at most, and of all views together: about half
/// of them fit, the others judge.
const PIXELS: usize = 1024;
const MAX_PIXELS: usize = 1 << 20;

/// What a view's pixels gathered, and what its photograph has there.
struct Sampled {
    features: Vec<[f32; FEATURES]>,
    pixels: Vec<[f32; 3]>,
}

/// How much the photographs differ in light.
pub(super) struct Differing {
    /// See [`LightVerdict::OneLight`].
    pub(super) spread: f32,
    /// The code that explains each view's photograph best.
    pub(super) codes: Vec<Appearance>,
}

/// How much better an appearance fitted to half of a view's pixels explains the
/// other half than one that all views share. `None` where the field explains too little to tell (unless it is
/// `late` in training), or a number is not finite.
pub(super) fn differing(shown: &Shown<'_>, seed: u64, late: bool) -> Option<Differing> {
    let halves: Vec<[Sampled; 2]> = (0..shown.views.len()).into_par_iter().map(|n| sampled(shown, seed, n)).collect();
    let fits = halves.iter().map(|[fit, _]| fit);
    let all = Sampled {
        features: fits.clone().flat_map(|s| s.features.iter().copied()).collect(),
        pixels: fits.flat_map(|s| s.pixels.iter().copied()).collect(),
    };
    let common = all.fit(&Prior::around(shown.neutral.clone()))?;
    let near = Prior::around(common.clone());
    let codes = halves.par_iter().map(|[fit, _]| fit.fit(&near)).collect::<Option<Vec<_>>>()?;
    let (mut shared, mut own) = (0.0, 0.0);
    for ([_, judge], code) in halves.iter().zip(&codes) {
        shared += judge.error(&common);
        own += judge.error(code);
    }
    let judged = halves.iter().map(|[_, judge]| 3 * judge.pixels.len()).sum::<usize>() as f64;
    if judged == 0.0 {
        return None;
    }
    let told = own <= 10f64.powf(-0.1 * TOLD_FROM_DB) * judged || late;
    (told && own.is_finite() && shared.is_finite())
        .then(|| Differing { spread: ((shared - own).max(0.0) / judged).sqrt() as f32, codes })
}

/// Two samples of a view's pixels, spread evenly over it.
fn sampled(shown: &Shown<'_>, seed: u64, n: usize) -> [Sampled; 2] {
    let view = &shown.views[n];
    let wanted = (MAX_PIXELS / shown.views.len()).clamp(64, PIXELS);
    let mut halves = [Sampled::none(), Sampled::none()];
    let mut tape: Vec<Kept<f32>> = Vec::new();
    let pixels = spread(seed, n, view.lens.pixels(), wanted);
    for (at, second) in pixels.filter(|(at, _)| view.uses(*at)) {
        let (path, basis) = view.eye().ray(shown.frame, at);
        let gathered = see(shown.grid, &path, &basis, Thresholds::SHOWN, &mut tape);
        let half = &mut halves[usize::from(second)];
        half.features.push(features(&gathered, &basis));
        half.pixels.push(view.colour(at));
    }
    halves
}

impl Sampled {
    fn none() -> Self {
        Self { features: Vec::new(), pixels: Vec::new() }
    }

    /// The code that explains these pixels, by `prior` where they leave it open.
    fn fit(&self, prior: &Prior) -> Option<Appearance> {
        prior.fit(&self.features, &self.pixels)
    }

    /// Sum of squared errors under `code`.
    fn error(&self, code: &Appearance) -> f64 {
        let one = |(f, pixel): (&[f32; FEATURES], &[f32; 3])| -> f64 {
            code.shade(f).iter().zip(pixel).map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        self.features.iter().zip(&self.pixels).map(one).sum()
    }
}
