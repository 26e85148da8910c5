//! How the views' appearance codes learn, beside the grid.

use crate::appearance::{Appearance, CODE, SHADE};
use crate::batch::Batch;
use crate::light::LightVerdict;
use crate::trainer::BaseTrainer;

/// A weak pull of appearances to neutral, a share of each ray's: it settles what the
/// photographs leave open.
const PULL: f32 = 1e-3;
/// A strong one until it is known whether photographs differ in light: in one light,
/// what an appearance could explain as well as the field is then left to the field.
const PULL_OPEN: f32 = 0.05;

/// What a batch owes the appearances.
pub(crate) struct CodeGradient {
    /// `views x CODE`.
    values: Vec<f32>,
    /// Rays of each view in the batch.
    rays: Vec<usize>,
}

impl CodeGradient {
    pub(crate) fn is_finite(&self) -> bool {
        self.values.iter().all(|v| v.is_finite())
    }
}

impl BaseTrainer {
    /// What the batch owes the appearances; empty where there are none.
    pub(crate) fn gradient_of_appearances(&self, batch: &Batch) -> CodeGradient {
        let views = self.appearances.len();
        let mut out = CodeGradient { values: vec![0.0; views * CODE], rays: vec![0; views] };
        for ray in batch.shaded() {
            out.rays[ray.view as usize] += 1;
            let values = &mut out.values[ray.view as usize * CODE..][..CODE];
            Appearance::add_code_gradient(ray.slope, &ray.features, values);
        }
        for tile in batch.lit() {
            let values = &mut out.values[tile.view as usize * CODE..][SHADE..CODE];
            values.iter_mut().zip(tile.lights).for_each(|(sum, g)| *sum += g);
        }
        out
    }

    /// Moves the appearances of the views that had rays in the batch.
    pub(crate) fn move_appearances(&mut self, mut gradient: CodeGradient, rate: f32) {
        self.appearance_adam.tick();
        let share = if self.light == LightVerdict::Open { PULL_OPEN } else { PULL };
        for (view, appearance) in self.appearances.iter_mut().enumerate() {
            if gradient.rays[view] == 0 {
                continue;
            }
            let pull = share * gradient.rays[view] as f32;
            let values = &mut gradient.values[view * CODE..][..CODE];
            for ((g, a), n) in values.iter_mut().zip(appearance.code()).zip(self.neutral.code()) {
                *g += pull * (a - n);
            }
            self.appearance_adam.update(view * CODE, values, appearance.code_mut(), rate);
        }
    }
}
