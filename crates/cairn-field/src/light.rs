//! Whether a scene's photographs differ in light. Appearances of their own for every
//! view are worth many dB where visitors came on other days, and cost time and
//! sharpness where one camera saw one light: so the coarsest field is asked. Until then
//! every view has one: a field without them paints each visitor's light onto the side
//! that only this visitor saw, and then there is nothing left for them to explain.

use crate::appearance::{Appearance, CODE, FEATURES, features};
use crate::composite::{Kept, Thresholds, see};
use crate::mean::Mean;
use crate::optimise::Adam;
use crate::prepared::Prepared;
use crate::prior::Prior;
use crate::sampling::spread;
use crate::trainer::BaseTrainer;
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
/// docs/experiments.md has what captures of either sort gave.
const WORTH: f32 = 0.025;
/// PSNR in their own light from which on pictures are taken to show the scene, dB: a
/// cloud would look like the mean of each photograph, which differs in any light.
const TOLD_FROM_DB: f64 = 17.0;
/// Pixels of a view that are looked at, at most, and of all views together: about half
/// of them fit, the others judge.
const PIXELS: usize = 1024;
const MOST_PIXELS: usize = 1 << 20;

/// What a view's pixels gathered, and what its photograph has there.
struct Sampled {
    features: Vec<[f32; FEATURES]>,
    pixels: Vec<[f32; 3]>,
}

impl BaseTrainer {
    /// Looks whether an appearance fitted to half of a view's pixels explains the
    /// other half better than one that all views share, and leaves them out if not.
    /// Decides nothing yet where the field explains too little to tell (in the first half
    /// of training), or a number is not finite.
    pub(crate) fn look_at_light(&mut self) {
        let halves: Vec<[Sampled; 2]> =
            self.views.par_iter().enumerate().map(|(n, view)| self.sampled(n, view)).collect();
        let fits = halves.iter().map(|[fit, _]| fit);
        let all = Sampled {
            features: fits.clone().flat_map(|s| s.features.iter().copied()).collect(),
            pixels: fits.flat_map(|s| s.pixels.iter().copied()).collect(),
        };
        let Some(common) = all.fit(&Prior::around(self.neutral.clone())) else { return };
        let near = Prior::around(common.clone());
        let Some(codes) = halves.par_iter().map(|[fit, _]| fit.fit(&near)).collect::<Option<Vec<_>>>() else { return };
        let (mut shared, mut own) = (0.0, 0.0);
        for ([_, judge], code) in halves.iter().zip(&codes) {
            shared += judge.error(&common);
            own += judge.error(code);
        }
        let judged = halves.iter().map(|[_, judge]| 3 * judge.pixels.len()).sum::<usize>() as f64;
        if judged == 0.0 {
            return;
        }
        let told = own <= 10f64.powf(-0.1 * TOLD_FROM_DB) * judged || 2 * self.step >= self.config.steps;
        if !(told && own.is_finite() && shared.is_finite()) {
            return;
        }
        let spread = ((shared - own).max(0.0) / judged).sqrt() as f32;
        if spread < WORTH {
            self.light = LightVerdict::OneLight { spread };
            self.appearances.clear();
            self.appearance_adam = Adam::zero(0);
        } else {
            self.light = LightVerdict::ManyLights { spread };
            // The moments are those of codes that were held back.
            self.appearance_adam = Adam::zero(codes.len() * CODE);
            self.appearances = codes;
            // Neither codes nor coefficients mean what they did.
            self.mean = Mean::default();
            self.begin_lights();
        }
    }

    /// Two samples of a view's pixels, spread evenly over it.
    fn sampled(&self, n: usize, view: &Prepared) -> [Sampled; 2] {
        let wanted = (MOST_PIXELS / self.views.len()).clamp(64, PIXELS);
        let mut halves = [Sampled::none(), Sampled::none()];
        let mut tape: Vec<Kept<f32>> = Vec::new();
        let pixels = spread(self.seed, n, view.lens.pixels(), wanted);
        for (at, second) in pixels.filter(|(at, _)| view.shows_scene(*at)) {
            let (path, basis) = view.lens.ray(&view.camera, &self.frame, at);
            let gathered = see(&self.grid, &path, &basis, Thresholds::SHOWN, &mut tape);
            let half = &mut halves[usize::from(second)];
            half.features.push(features(&gathered, &basis));
            half.pixels.push(std::array::from_fn(|c| f32::from(view.pixels[at * 3 + c]) / 255.0));
        }
        halves
    }
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
