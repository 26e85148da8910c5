//! Stage 1: training the base field. A step draws rays, renders, walks back and
//! moves the touched rows; it reads no clock and no file and draws only from
//! its seed, so that the same seed gives the same bytes.

use super::batch::{Batch, BatchSettings};
use super::codes::{self, CodeGradient};
use super::light::{self, LightVerdict};
use super::mean::{self, Mean};
use super::optimise::{Adam, Rates, RowState};
use super::resolution::{dims_of_level, finest, level_end, tile_side};
use super::sampling::{Tile, Tiles};
use super::shown::Shown;
use super::spacing::Spacing;
use super::views::{NamedView, Prepared, mean_colour, prepare};
use crate::appearance::code::{Appearance, CODE};
use crate::config::{AppearanceMode, FieldConfig};
use crate::error::FieldError;
use crate::field::model::Field;
use crate::field::survey::only_what_shows_to;
use crate::grid::lattice::{DENSITY_SCALE, Grid, Part, raw_of};
use crate::rays::frame::SceneFrame;
use crate::rays::lens::Eye;
use crate::rays::march::empty_density;
use crate::render::composite::Thresholds;
use cairn_scene::Camera;
use glam::DVec3;
use std::sync::Arc;

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// Steps done, this one included.
    pub step: u64,
    /// Steps in all.
    pub total: u64,
    /// Mean squared error of the batch, a channel.
    pub loss: f64,
    /// The same as PSNR, dB (of training rays: not a result).
    pub psnr_db: f64,
}

/// Trains a base field; see the module's text.
pub struct BaseTrainer {
    pub(crate) config: FieldConfig,
    pub(crate) frame: SceneFrame,
    pub(crate) seed: u64,
    pub(crate) step: u64,
    /// Tiles drawn so far.
    pub(crate) drawn: u64,
    tiles: Tiles,
    pub(crate) level: usize,
    pub(crate) views: Vec<Arc<Prepared>>,
    pub(crate) grid: Grid<f32>,
    pub(crate) rows: RowState,
    batch: Batch,
    pub(crate) neutral: Appearance,
    /// The colour of pixels that show nothing, where the capture has one.
    pub(crate) background: Option<[f32; 3]>,
    /// One a view; empty where the scene needs none.
    pub(crate) appearances: Vec<Appearance>,
    pub(crate) appearance_adam: Adam,
    pub(crate) light: LightVerdict,
    spacing: Spacing,
    /// The mean of the last states so far.
    pub(crate) mean: Mean,
}

impl BaseTrainer {
    /// Prepares training of `views` in `frame`. `background` is the colour behind
    /// everything in scenes that have one, RGB in [0, 1], and pixels that have exactly
    /// this colour are taken to show nothing else (see [`FieldConfig::clear_background`]);
    /// `None` takes the photographs' mean and says nothing of pixels.
    ///
    /// # Errors
    /// [`FieldError`] for settings out of range, no views, a photograph or a mask whose
    /// size is not its camera's, and masks that leave nothing.
    pub fn new(
        views: Vec<NamedView>,
        frame: SceneFrame,
        background: Option<[f32; 3]>,
        config: FieldConfig,
        seed: u64,
    ) -> Result<Self, FieldError> {
        config.validate()?;
        Ok(Self::of(prepare(views)?, frame, background, config, seed))
    }

    /// As [`BaseTrainer::new`], for settings and views (one at least) that were checked.
    pub(crate) fn of(
        views: Vec<Arc<Prepared>>,
        frame: SceneFrame,
        background: Option<[f32; 3]>,
        config: FieldConfig,
        seed: u64,
    ) -> Self {
        let neutral = Appearance::neutral(background.unwrap_or_else(|| mean_colour(&views)));
        let open = config.appearance == AppearanceMode::Auto && views.len() > 1;
        let with_appearance = open || config.appearance == AppearanceMode::On;
        let appearances = if with_appearance { vec![neutral.clone(); views.len()] } else { Vec::new() };
        let dims = dims_of_level(&config, &frame, 0, config.voxels);
        let density = -(1.0 - config.initial_opacity).ln() / DENSITY_SCALE;
        let raw = raw_of(density);
        let level = mean_colour(&views).iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0;
        let grid = Grid::full(dims, raw, level);
        let rows = grid.rows();
        let tiles = Tiles::of(views.iter().map(|v| &v.lens), tile_side(&config, 0));
        let cameras: Vec<Camera> = views.iter().map(|v| v.view.camera).collect();
        Self {
            spacing: Spacing::of(&cameras, &config),
            appearance_adam: Adam::zero(appearances.len() * CODE),
            config,
            frame,
            seed,
            step: 0,
            drawn: 0,
            tiles,
            level: 0,
            views,
            grid,
            rows: RowState::zero(rows),
            batch: Batch::default(),
            neutral,
            background,
            appearances,
            mean: Mean::default(),
            light: if open { LightVerdict::Open } else { LightVerdict::Settled },
        }
    }

    /// The same training in which some views teach nothing. All else stays as it is: the grid, the order of the others'
    /// pixels, and the steps that look at them, so that two fields differ by what the views taught, and as little as can
    /// be by chance. It is for measuring what photographs are needed for; checkpoints do not know of it, and the
    /// photographs' mean colour, where colours begin, has the views in it.
    ///
    /// # Panics
    /// When training has begun, or no view would teach.
    #[must_use]
    pub fn without(mut self, absent: impl Fn(&str) -> bool) -> Self {
        assert!(self.step == 0, "views are left out before training begins");
        for view in self.views.iter_mut().filter(|view| absent(&view.name)) {
            *view = Arc::new(view.left_out());
        }
        assert!(self.views.iter().any(|view| !view.absent), "a view must teach");
        self
    }

    /// The settings.
    pub fn config(&self) -> &FieldConfig {
        &self.config
    }

    /// Steps done so far.
    pub fn steps_done(&self) -> u64 {
        self.step
    }

    /// Steps in all.
    pub fn steps_total(&self) -> u64 {
        self.config.steps
    }

    /// Whether the photographs differ in light, as far as that is known yet.
    pub fn light(&self) -> LightVerdict {
        self.light
    }

    /// How far apart the photographs look, and how much smoother the field is kept for it.
    pub fn spacing(&self) -> Spacing {
        self.spacing
    }

    /// Vertices of the last level's lattice where they are more than [`FieldConfig::voxels`], because
    /// [`FieldConfig::voxel_px`] asked for them; `None` before that level, too.
    pub fn finer(&self) -> Option<usize> {
        let vertices = self.grid.dims.iter().product::<usize>();
        // Sides are whole numbers: a lattice is never exactly as large as asked.
        let more = vertices as f64 > 1.05 * self.config.voxels as f64;
        (more && self.level + 1 == self.config.levels).then_some(vertices)
    }

    /// Vertices of the last level's lattice where they are fewer than [`FieldConfig::voxels`], because of
    /// [`FieldConfig::min_voxel_px`]; `None` before that level, too.
    pub fn coarser(&self) -> Option<usize> {
        let fewer = self.level + 1 == self.config.levels && self.finest() < self.config.voxels;
        fewer.then(|| self.grid.dims.iter().product())
    }

    /// Vertices that the last level is to have, by what is known of the light now: where a level begins before that
    /// is known, it and those before it are as they were.
    fn finest(&self) -> usize {
        let cameras: Vec<Camera> = self.views.iter().map(|v| v.view.camera).collect();
        finest(&self.config, &self.frame, &cameras, !self.has_appearance())
    }

    /// How many times as much as configured both pulls of neighbours weigh, as far as is known yet.
    fn smoothing(&self) -> f64 {
        self.spacing.smoothing * if self.has_appearance() { 1.0 } else { self.config.smooth_in_one_light }
    }

    /// Whether views have appearances of their own in this scene.
    pub fn has_appearance(&self) -> bool {
        !self.appearances.is_empty()
    }

    /// Rows of the grid in use and vertices of its lattice.
    pub fn size(&self) -> (usize, [usize; 3]) {
        (self.grid.rows() - 1, self.grid.dims)
    }

    /// Takes one step. After the last one, does nothing but report.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`] when a number went wrong; the state is then as before.
    pub fn step(&mut self) -> Result<StepStats, FieldError> {
        if self.step >= self.config.steps {
            return Ok(self.stats(0.0));
        }
        let progress = self.step as f64 / self.config.steps as f64;
        // A young field explains little yet: a price on it from the first step wiped it out.
        let begun = ((progress - 0.02) / 0.1).clamp(0.0, 1.0);
        let (tiles, drawn) = self.draw_tiles();
        let mut batch = std::mem::take(&mut self.batch);
        batch.draw(&BatchSettings {
            shown: self.shown(),
            tiles: &tiles,
            huber: self.config.huber as f32,
            nothing: self.nothing(),
            distortion: (self.config.distortion * begun) as f32,
            limits: Thresholds { alpha: 1e-4, transmittance: 2e-3, weight: SKIP_WEIGHT, step: self.config.step_voxels },
            faint: FAINT_WEIGHT,
            stream: (self.seed, self.step),
        });
        if !batch.loss.is_finite() {
            return Err(self.not_finite("the loss"));
        }
        // Everything is looked at before anything moves.
        if !batch.finite {
            return Err(self.not_finite("a gradient at a sample"));
        }
        let codes = CodeGradient::of(&batch, self.appearances.len());
        if !codes.is_finite() {
            return Err(self.not_finite("a gradient of an appearance"));
        }
        let decay = FINAL_RATE.powf(progress) as f32;
        let smoothing = self.smoothing();
        let rates = Rates {
            density: self.config.learning_rate_density as f32 * decay,
            colour: RATE_COLOUR * decay,
            view_dependence: (VIEW_DEPENDENCE / self.spacing.smoothing) as f32,
            smooth_density: (self.config.smooth_density * smoothing) as f32,
            smooth_colour: (self.config.smooth_colour * smoothing) as f32,
        };
        if !self.rows.step(&mut self.grid, &batch.debts(), &rates) {
            return Err(self.not_finite("a gradient of the grid"));
        }
        let pull = if self.light == LightVerdict::Open { codes::PULL_OPEN } else { codes::PULL };
        let rate = RATE_APPEARANCE * decay;
        codes::apply(codes, &mut self.appearances, &mut self.appearance_adam, &self.neutral, pull, rate);
        self.step += 1;
        self.drawn = drawn;
        let loss = batch.loss;
        self.batch = batch;
        // Here, and not before the next step: that one may be refused.
        self.make_ready();
        if Mean::is_due(self.step, self.averaged_from(), self.config.steps) {
            self.mean.take_in(&self.grid, &self.appearances);
        }
        Ok(self.stats(loss))
    }

    /// The 8-bit colour of pixels that show nothing, and the price of what stands before
    /// them. In the open there is always something: a white sky is no empty place.
    fn nothing(&self) -> Option<([u8; 3], f32)> {
        let bits = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let price = self.config.clear_background as f32;
        let bounded = matches!(self.frame, SceneFrame::Bounded { .. });
        self.background.filter(|_| bounded && price > 0.0).map(|rgb| (rgb.map(bits), price))
    }

    /// Begins to draw tiles of the level's size.
    pub(crate) fn lay_tiles(&mut self) {
        self.tiles = Tiles::of(self.views.iter().map(|v| &v.lens), tile_side(&self.config, self.level));
        self.drawn = 0;
    }

    /// The next step's tiles, and how many were drawn with them.
    fn draw_tiles(&self) -> (Vec<Tile>, u64) {
        let (mut tiles, mut rays, mut drawn) = (Vec::new(), 0, self.drawn);
        while rays < self.config.rays_per_step {
            let tile = self.tiles.draw(self.seed, drawn);
            drawn += 1;
            let used = self.views[tile.view].used_in(&tile);
            rays += used;
            if used > 0 {
                tiles.push(tile);
            }
        }
        (tiles, drawn)
    }

    /// The step after which states are averaged: rows are the same from then on, since the last level is half done.
    pub(crate) fn averaged_from(&self) -> u64 {
        let last = self.level + 1 == self.config.levels;
        let share = if last { self.config.mean_of_last } else { 0.0 };
        let from = self.config.steps - (share * self.config.steps as f64) as u64;
        from.max(self.halfway().1)
    }

    /// The trained field: the mean of the last states ([`FieldConfig::mean_of_last`]), or the last one
    /// where that explains the photographs clearly better; before those begin the present one.
    pub fn finish(self) -> Field {
        self.finish_in_f32().with_stored_colours()
    }

    /// As [`BaseTrainer::finish`], before its colours are rounded as files hold them: to see what that does.
    pub fn finish_in_f32(mut self) -> Field {
        self.settle();
        let min_weight = self.config.prune_weight.min(SHOWS);
        let mut all = self.views.iter();
        self.appearances.retain(|_| all.next().is_some_and(|view| !view.absent));
        let views: Vec<_> = self.views.iter().filter(|view| !view.absent).collect();
        let names = views.iter().map(|v| v.name.clone());
        let canonical = Appearance::mean(&self.appearances.iter().collect::<Vec<_>>()).unwrap_or(self.neutral);
        let field = Field::new(self.frame, self.grid, canonical, names.zip(self.appearances).collect());
        let eyes: Vec<Eye<'_>> = views.iter().map(|v| v.eye()).collect();
        if min_weight > 0.0 { only_what_shows_to(field, &eyes, min_weight) } else { field }
    }

    /// The steps at which this level began and is half done.
    fn halfway(&self) -> (u64, u64) {
        let start = if self.level == 0 { 0 } else { level_end(&self.config, self.level - 1) };
        (start, start + (level_end(&self.config, self.level) - start) / 2)
    }

    /// Whether so many rays were drawn since the record of what was seen began
    /// that a row without a mark is one that does not show. With fewer rays than
    /// half the rows, walls were lost that no ray had happened to meet.
    fn knows_enough(&self) -> bool {
        let (start, middle) = self.halfway();
        let since = self.step - if self.step > middle { middle } else { start };
        since * self.config.rays_per_step as u64 >= self.grid.rows() as u64 / 2
    }

    /// The rows worth keeping, by what was seen of late.
    fn kept(&self) -> Vec<bool> {
        self.grid.near_seen(&self.rows.seen, self.config.prune_weight as f32)
    }

    fn stats(&self, loss: f64) -> StepStats {
        StepStats { step: self.step, total: self.config.steps, loss, psnr_db: -10.0 * loss.max(1e-20).log10() }
    }

    fn not_finite(&self, place: &str) -> FieldError {
        FieldError::NotFinite { step: self.step, place: place.into() }
    }

    /// What is due between two steps.
    fn make_ready(&mut self) {
        if self.step >= self.config.steps {
            return;
        }
        let due = |since: u64| since.is_multiple_of((self.config.steps / 16).max(1));
        if self.light == LightVerdict::Open && self.step.checked_sub(light_step(&self.config)).is_some_and(due) {
            self.look_at_light();
        }
        self.change_level();
    }

    /// Asks whether the photographs differ in light, and leaves appearances out if not.
    fn look_at_light(&mut self) {
        let late = 2 * self.step >= self.config.steps;
        let Some(found) = light::differing(&self.shown(), self.seed, late) else { return };
        let spread = found.spread;
        if spread < light::WORTH {
            self.light = LightVerdict::OneLight { spread };
            self.appearances.clear();
            self.appearance_adam = Adam::zero(0);
        } else {
            self.light = LightVerdict::ManyLights { spread };
            // The moments are those of codes that were held back.
            self.appearance_adam = Adam::zero(found.codes.len() * CODE);
            self.appearances = found.codes;
            // Neither codes nor coefficients mean what they did.
            self.mean = Mean::default();
        }
    }

    /// Puts the mean of the last states in the state's place, where there is one and it explains the
    /// photographs about as well.
    pub(super) fn settle(&mut self) {
        if self.mean.states == 0 {
            return;
        }
        let last = mean::error_on_photographs(&self.shown(), self.seed);
        self.mean.exchange(&mut self.grid, &mut self.appearances);
        if mean::error_on_photographs(&self.shown(), self.seed) > mean::WORSE * last {
            self.mean.exchange(&mut self.grid, &mut self.appearances);
        }
    }

    /// What the state shows, and the photographs.
    pub(crate) fn shown(&self) -> Shown<'_> {
        Shown {
            views: &self.views,
            frame: &self.frame,
            grid: &self.grid,
            neutral: &self.neutral,
            appearances: &self.appearances,
        }
    }

    /// Moves to the next level when its time has come, and keeps occupancy and
    /// the record of what was seen fresh within one.
    fn change_level(&mut self) {
        let end = |level: usize| level_end(&self.config, level);
        if self.level + 1 < self.config.levels && self.step >= end(self.level) {
            // Coarse cells are kept whole: that is margin enough.
            let min_weight = if self.knows_enough() { self.config.prune_weight as f32 } else { 0.0 };
            let keep: Vec<bool> = self.rows.seen.iter().map(|w| *w >= min_weight).collect();
            self.level += 1;
            let part = self.tighten(&keep);
            let dims = dims_of_level(&self.config, &self.frame, self.level, self.finest());
            self.grid = self.grid.resampled(dims, part, &keep);
            self.grid.refresh_occupancy(empty_density(self.grid.dims));
            self.rows = RowState::zero(self.grid.rows());
            self.lay_tiles();
            return;
        }
        if self.step == self.halfway().1 {
            // The first level is still finding out what is there.
            if self.level > 0 && self.knows_enough() {
                let keep = self.kept();
                self.grid.clear(&keep);
                self.grid.refresh_occupancy(empty_density(self.grid.dims));
            }
            self.rows.seen.fill(0.0);
        }
        if self.step % 64 == 63 {
            self.grid.refresh_occupancy(empty_density(self.grid.dims));
        }
    }

    /// Draws a bounded scene's box in to what is there, so that the next level's
    /// vertices are not spent on the air around it; returns the part of the old box.
    fn tighten(&mut self, keep: &[bool]) -> Part {
        let SceneFrame::Bounded { centre, half } = &mut self.frame else { return Part::WHOLE };
        let part = self.grid.bounds(keep, 1);
        let (l, h) = (DVec3::from(part.low), DVec3::from(part.high));
        let before = half.max_element();
        *centre += (l + h - 1.0) * *half;
        *half *= h - l;
        // Densities are per length of the cube, which is another now.
        self.grid.scale_density(half.max_element() / before);
        part
    }
}

/// Learning rate of the constant colour coefficients.
const RATE_COLOUR: f32 = 0.05;
/// The direction-dependent coefficients' rate as a share of the constant ones'.
const VIEW_DEPENDENCE: f64 = 0.2;
/// Learning rate of the appearance codes.
const RATE_APPEARANCE: f32 = 0.01;
/// Learning rates fall to this share of themselves, exponentially.
const FINAL_RATE: f64 = 0.3;
/// In training, a sample that weighs less than this in its pixel is passed over.
const SKIP_WEIGHT: f64 = 5e-4;
/// A vertex that weighs less than this in its tile's pixels together moves only now and then, and then as much the more.
const FAINT_WEIGHT: f32 = 0.003;
/// A cell that never has this share of a pixel is not missed: dropping those changed
/// held-out views by 0.02 dB, three times as much by 0.2 dB (fern).
const SHOWS: f64 = 0.01;

/// Step before which it is first asked whether the photographs differ in light: when the
/// coarsest level is done, and after a quarter of all steps at the latest.
fn light_step(config: &FieldConfig) -> u64 {
    level_end(config, 0).min(config.steps / 4).max(1)
}
