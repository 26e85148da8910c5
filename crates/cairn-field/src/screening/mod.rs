//! Screening: which training photographs do the others not explain? A wrong picture, a
//! wrong pose, noise, a photograph turned around or of another place is one that no field
//! learnt from the *others* predicts.
//!
//! What is judged is therefore always a photograph that the judging field has never
//! seen. A field that was trained on it knows it by heart, at least in part: it paints
//! the photograph onto haze before that one camera. Views are dealt into folds, and for
//! each a coarse *scout* is trained on all the others (cross-validation; Stone 1974). Those that
//! come out badly are suspects: a second, finer scout is trained without any of them
//! and looks at them again, so that a poisoned photograph no longer speaks against its
//! honest neighbours.
//!
//! The figure is not how well a photograph is rendered: what visitors bring differs by
//! 10 dB in that, with the sky, the passers-by and how much of the scene fills it. It is how much
//! better the scout explains it from its *own* pose than from other views' poses, in dB
//! ([`ViewScore::fit_db`]), its light fitted to half of the pixels and judged on the other
//! half each time. An honest photograph fits its own pose by decibels; one that
//! has nothing to do with its pose fits it as well as any other: by 0 dB, give or take
//! chance, whatever it shows. See `fit.rs` for the figure, `verdict.rs` for who is an outlier.
//!
//! Scouts end before training begins: the field proper never sees an outlier, and is
//! byte for byte the field of a capture without it.

mod checkpoint;
mod fit;
mod verdict;

use crate::chance::mixed;
use crate::config::{AppearanceMode, FieldConfig};
use crate::error::FieldError;
use crate::rays::frame::SceneFrame;
use crate::train::trainer::{BaseTrainer, StepStats};
use crate::train::views::{NamedView, Prepared, prepare};
use fit::{Judge, ViewFit};
use std::collections::BTreeSet;
use std::sync::Arc;

pub use verdict::{Doubt, Screened, ViewScore};

/// Fewer views than this are not screened: too few are left to speak of one.
pub const MIN_VIEWS: usize = 8;

/// Scouts, each trained without its share of the views. A view's neighbours are mostly among the three quarters
/// that its scout sees, and four coarse trainings cost less than a tenth of stage 1.
const FOLDS: usize = 4;

/// How long a scout is trained.
struct Effort {
    /// Its steps as a share of stage 1's,
    share: f64,
    /// and their bounds.
    min_steps: u64,
    max_steps: u64,
}

/// A scout's: about what stage 1's coarsest level gets.
const SCOUT: Effort = Effort { share: 0.07, min_steps: 60, max_steps: 500 };
/// The same of the second look.
const SECOND: Effort = Effort { share: 0.2, min_steps: 120, max_steps: 1500 };
/// A scout's vertices: stage 1's divided by this,
const FEWER_VOXELS: usize = 512;
/// and their bounds.
const MIN_VOXELS: usize = 4096;
const MAX_VOXELS: usize = 32_768;

/// Screens the views of a capture; see the module's text. A `step()` is a step of a
/// scout; like training it reads no clock and no file.
pub struct Screening {
    /// Of the training to come.
    field: FieldConfig,
    /// Of the scouts, and of the one that looks a second time.
    configs: [FieldConfig; 2],
    frame: SceneFrame,
    background: Option<[f32; 3]>,
    seed: u64,
    views: Vec<Arc<Prepared>>,
    /// Views that a person has called good: they are not judged.
    trusted: BTreeSet<usize>,
    /// Views by fold.
    folds: Vec<Vec<usize>>,
    /// The fold whose scout is being trained; their number stands for the second look.
    phase: usize,
    /// Whom the second look is about.
    suspects: Vec<usize>,
    fits: Vec<Option<ViewFit>>,
    /// Steps of the scouts before this one.
    before: u64,
    /// `None` at the end.
    scout: Option<BaseTrainer>,
}

impl Screening {
    /// Prepares screening of `views`, of which those named in `trusted` are taken to be
    /// good. `field` are the settings of the training to come; frame, background and seed its own.
    ///
    /// # Errors
    /// [`FieldError`] for settings out of range, fewer than [`MIN_VIEWS`] views, or a
    /// picture whose size is not its camera's.
    pub fn new(
        views: Vec<NamedView>,
        trusted: &BTreeSet<String>,
        frame: SceneFrame,
        background: Option<[f32; 3]>,
        field: &FieldConfig,
        seed: u64,
    ) -> Result<Self, FieldError> {
        field.validate()?;
        if views.len() < MIN_VIEWS {
            return Err(FieldError::Views(format!(
                "{} are too few to be screened; {MIN_VIEWS} are needed",
                views.len()
            )));
        }
        let views = prepare(views)?;
        let trusted = (0..views.len()).filter(|v| trusted.contains(&views[*v].name)).collect();
        let folds = dealt(views.len(), FOLDS, seed);
        let fits = vec![None; views.len()];
        let configs = [scout_config(field, false), scout_config(field, true)];
        let mut screening = Self {
            field: field.clone(),
            configs,
            frame,
            background,
            seed,
            views,
            trusted,
            folds,
            phase: 0,
            suspects: Vec::new(),
            fits,
            before: 0,
            scout: None,
        };
        screening.scout = Some(screening.new_scout());
        Ok(screening)
    }

    /// Steps done, of all scouts so far.
    pub fn steps_done(&self) -> u64 {
        self.before + self.scout.as_ref().map_or(0, BaseTrainer::steps_done)
    }

    /// Steps in all, as far as that is known: a second look comes only where there are suspects.
    pub fn steps_total(&self) -> u64 {
        let first = self.configs[0].steps * self.folds.len() as u64;
        if self.suspects.is_empty() { first } else { first + self.configs[1].steps }
    }

    /// Takes one step of a scout, and judges its views with the last one. After the end, does nothing but report.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`] when a number went wrong; the state is then as before.
    pub fn step(&mut self) -> Result<StepStats, FieldError> {
        let Some(scout) = &mut self.scout else {
            let (step, total) = (self.steps_done(), self.steps_total());
            return Ok(StepStats { step, total, loss: 0.0, psnr_db: 0.0 });
        };
        let stats = scout.step()?;
        let finished = scout.steps_done() == scout.steps_total();
        let step = self.steps_done();
        if finished {
            self.judge();
        }
        Ok(StepStats { step, total: self.steps_total(), ..stats })
    }

    /// Lets the scout at hand judge the views that it has not seen, and goes on to the next.
    fn judge(&mut self) {
        let Some(scout) = self.scout.take() else { return };
        self.before += scout.steps_done();
        let unseen = self.unseen();
        let judge = Judge::new(scout.shown(), &self.views, self.seed);
        for (view, fit) in unseen.iter().zip(judge.fits(&unseen)) {
            self.fits[*view] = Some(fit);
        }
        self.phase += 1;
        if self.phase == self.folds.len() {
            self.suspects = verdict::suspects(&self.found(), &self.trusted);
        }
        if self.phase < self.folds.len() || (self.phase == self.folds.len() && !self.suspects.is_empty()) {
            self.scout = Some(self.new_scout());
        }
    }

    /// The views that this phase's scout is not shown.
    fn unseen(&self) -> Vec<usize> {
        self.folds.get(self.phase).unwrap_or(&self.suspects).clone()
    }

    /// What this phase's scout learns from.
    fn shown(&self) -> Vec<Arc<Prepared>> {
        let unseen: BTreeSet<usize> = self.unseen().into_iter().collect();
        (0..self.views.len()).filter(|v| !unseen.contains(v)).map(|v| self.views[v].clone()).collect()
    }

    fn new_scout(&self) -> BaseTrainer {
        let config = self.configs[usize::from(self.phase == self.folds.len())].clone();
        // Another seed for each, so that they do not err alike.
        let seed = mixed(self.seed ^ mixed(self.phase as u64));
        BaseTrainer::of(self.shown(), self.frame.clone(), self.background, config, seed)
    }

    /// The fits, once there is one for every view.
    fn found(&self) -> Vec<ViewFit> {
        self.fits.iter().flatten().cloned().collect()
    }

    /// What came out; `None` before the end.
    pub fn finish(&self) -> Option<Screened> {
        self.scout.is_none().then(|| verdict::screened(&self.found(), &self.trusted))
    }
}

/// Views `0..count` dealt into folds as evenly as can be, by chance.
fn dealt(count: usize, folds: usize, seed: u64) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by_key(|v| (mixed(seed ^ mixed(*v as u64)), *v));
    let folds = folds.min(count);
    (0..folds).map(|fold| order.iter().copied().skip(fold).step_by(folds).collect()).collect()
}

/// A scout's settings: stage 1's on a coarse grid. Every view has an appearance of its own unless the
/// settings forbid: one day among many is no wrong picture.
fn scout_config(field: &FieldConfig, second: bool) -> FieldConfig {
    let Effort { share, min_steps, max_steps } = if second { SECOND } else { SCOUT };
    let voxels = (field.voxels / FEWER_VOXELS).clamp(MIN_VOXELS, MAX_VOXELS);
    FieldConfig {
        steps: ((field.steps as f64 * share) as u64).clamp(min_steps, max_steps),
        levels: if second { 2 } else { 1 },
        voxels: if second { 8 * voxels } else { voxels },
        voxel_px: 0.0,
        // Neighbours in a coarse grid say the same: see `tile_side`.
        tile_px: if second { field.tile_px } else { 1 },
        appearance: match field.appearance {
            AppearanceMode::Off => AppearanceMode::Off,
            AppearanceMode::Auto | AppearanceMode::On => AppearanceMode::On,
        },
        // Each scout sees other views: their fits are compared, so that they have to be equally smooth.
        smoother_beyond_deg: 180.0,
        smooth_in_one_light: 1.0,
        // Coarse fields that are compared as they stand: they gain nothing by this.
        mean_of_last: 0.0,
        ..field.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_view_is_in_one_fold_and_folds_are_even() {
        for (count, folds) in [(8, 4), (17, 4), (118, 4), (9, 16), (10, 2)] {
            let all = dealt(count, folds, 3);
            let mut seen: Vec<usize> = all.iter().flatten().copied().collect();
            seen.sort_unstable();
            assert_eq!(seen, (0..count).collect::<Vec<_>>());
            let sizes = all.iter().map(Vec::len);
            assert!(sizes.clone().max().unwrap() - sizes.min().unwrap() <= 1, "{count} in {folds}");
        }
        assert_ne!(dealt(40, 4, 1), dealt(40, 4, 2), "by chance, and by the seed's");
    }
}
