//! Whether a scene's photographs differ in light. Appearances of their own for every
//! view are worth many dB where visitors came on other days, and cost time and
//! sharpness where one camera saw one light: so the coarsest field is asked.

use crate::appearance::{Appearance, FEATURES, features};
use crate::composite::{Kept, Thresholds, see};
use crate::optimise::Adam;
use crate::sampling::mixed;
use crate::trainer::{BaseTrainer, CODE, Prepared};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Whether views have appearances of their own, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightVerdict {
    /// The settings say so, or there is one view only.
    Settled,
    /// Not looked into yet.
    Open,
    /// Appearances would gain so little (dB, on pixels they were not fitted to) that
    /// they are left out.
    OneLight {
        /// What they would gain.
        gain_db: f32,
    },
    /// They gain this much (dB, likewise).
    ManyLights {
        /// What they gain.
        gain_db: f32,
    },
}

/// Gain from which on appearances are worth having, dB. One camera under one light
/// gave -0.02 to -0.03 (fern, trex, lego), visitors' photographs 1.2 to 1.4 (liberty).
const WORTH_DB: f32 = 0.2;
/// PSNR of pictures in one light from which on they are taken to show the scene, dB: a
/// cloud would look like the mean of each photograph, which differs in any light.
const TOLD_FROM_DB: f64 = 15.0;
/// Pixels of a view that are looked at: about half of them fit, the others judge.
const PIXELS: usize = 1024;

/// What a view's pixels gathered, and what its photograph has there.
struct Sampled {
    features: Vec<[f32; FEATURES]>,
    pixels: Vec<[f32; 3]>,
}

impl BaseTrainer {
    /// Looks whether an appearance fitted to half of a view's pixels explains the
    /// other half better than one that all views share, and gives every view its own
    /// if so. Decides nothing yet where the field explains too little to tell, or a
    /// number is not finite.
    pub(crate) fn look_at_light(&mut self) {
        let halves: Vec<[Sampled; 2]> =
            self.views.par_iter().enumerate().map(|(n, view)| self.sampled(n as u64, view)).collect();
        let fits = halves.iter().map(|[fit, _]| fit);
        let all = Sampled {
            features: fits.clone().flat_map(|s| s.features.iter().copied()).collect(),
            pixels: fits.flat_map(|s| s.pixels.iter().copied()).collect(),
        };
        let common = all.fit(&self.neutral);
        let codes: Vec<Appearance> = halves.par_iter().map(|[fit, _]| fit.fit(&common)).collect();
        let (mut shared, mut own) = (0.0, 0.0);
        for ([_, judge], code) in halves.iter().zip(&codes) {
            shared += judge.error(&common);
            own += judge.error(code);
        }
        // Perfect pictures need no appearance, and have none to divide by.
        let gain_db = (10.0 * ((shared + 1e-12) / (own + 1e-12)).log10()) as f32;
        let judged: usize = halves.iter().map(|[_, judge]| 3 * judge.pixels.len()).sum();
        if shared > 10f64.powf(-0.1 * TOLD_FROM_DB) * judged as f64 {
            return;
        }
        if !(gain_db.is_finite() && codes.iter().all(|c| c.code().iter().all(|v| v.is_finite()))) {
            return;
        }
        if gain_db < WORTH_DB {
            self.light = LightVerdict::OneLight { gain_db };
        } else {
            self.light = LightVerdict::ManyLights { gain_db };
            self.appearance_adam = Adam::zero(codes.len() * CODE);
            self.appearances = codes;
        }
    }

    /// Two samples of a view's pixels, spread evenly over it.
    fn sampled(&self, n: u64, view: &Prepared) -> [Sampled; 2] {
        let all = view.lens.pixels();
        let every = (all / PIXELS).max(1);
        let mut halves = [Sampled::none(), Sampled::none()];
        let mut tape: Vec<Kept<f32>> = Vec::new();
        for k in 0..all / every {
            // Anywhere in its stretch, and to either half: an even lattice would fall
            // into a few of the photograph's columns.
            let chance = mixed(self.seed ^ mixed(n << 32 | k as u64));
            let at = k * every + (chance >> 1) as usize % every;
            let (path, basis) = view.lens.ray(&view.camera, &self.frame, at);
            let gathered = see(&self.grid, &path, &basis, Thresholds::SHOWN, &mut tape);
            let half = &mut halves[(chance & 1) as usize];
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

    /// The code that explains these pixels, near `prior` where they leave it open.
    fn fit(&self, prior: &Appearance) -> Appearance {
        Appearance::fit(&self.features, &self.pixels, prior, 1e-3 * self.pixels.len().max(1) as f64)
    }

    /// Sum of squared errors under `code`.
    fn error(&self, code: &Appearance) -> f64 {
        let one = |(f, pixel): (&[f32; FEATURES], &[f32; 3])| -> f64 {
            code.shade(f).iter().zip(pixel).map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        self.features.iter().zip(&self.pixels).map(one).sum()
    }
}
