//! How the views' appearance codes learn, beside the grid.

use super::batch::Batch;
use super::optimise::Adam;
use crate::appearance::code::{Appearance, CODE};

/// A weak pull of appearances to neutral, a share of each ray's: it settles what the
/// photographs leave open.
pub(super) const PULL: f32 = 1e-3;
/// A strong one until it is known whether photographs differ in light: in one light,
/// what an appearance could explain as well as the field is then left to the field.
pub(super) const PULL_OPEN: f32 = 0.05;

/// What a batch owes the appearances.
pub(super) struct CodeGradient {
    /// `views x CODE`.
    values: Vec<f32>,
    /// Rays of each view in the batch.
    rays: Vec<usize>,
}

impl CodeGradient {
    /// What `batch` owes the appearances of so many views; nothing where they have none.
    pub(super) fn of(batch: &Batch, views: usize) -> Self {
        let mut out = Self { values: vec![0.0; views * CODE], rays: vec![0; views] };
        for ray in batch.shaded() {
            out.rays[ray.view as usize] += 1;
            let values = &mut out.values[ray.view as usize * CODE..][..CODE];
            Appearance::add_code_gradient(ray.slope, &ray.features, values);
        }
        out
    }

    pub(super) fn is_finite(&self) -> bool {
        self.values.iter().all(|v| v.is_finite())
    }
}

/// Moves the appearances of the views that had rays in the batch, by `rate`; each ray pulls `pull` of the
/// way to `neutral`.
pub(super) fn apply(
    mut gradient: CodeGradient,
    appearances: &mut [Appearance],
    adam: &mut Adam,
    neutral: &Appearance,
    pull: f32,
    rate: f32,
) {
    adam.tick();
    for (view, appearance) in appearances.iter_mut().enumerate() {
        if gradient.rays[view] == 0 {
            continue;
        }
        let pull = pull * gradient.rays[view] as f32;
        let values = &mut gradient.values[view * CODE..][..CODE];
        for ((g, a), n) in values.iter_mut().zip(appearance.code()).zip(neutral.code()) {
            *g += pull * (a - n);
        }
        adam.update(view * CODE, values, appearance.code_mut(), rate);
    }
}
