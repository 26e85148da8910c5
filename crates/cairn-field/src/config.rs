//! Settings of stage 1, checked before anything starts.

use crate::error::FieldError;
use serde::{Deserialize, Serialize};

/// Whether views get an appearance of their own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AppearanceMode {
    /// Where the photographs turn out to differ in light ([`crate::LightVerdict`]).
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Settings of stage 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FieldConfig {
    /// Optimiser steps in all, 1 to 1,000,000.
    pub steps: u64,
    /// Rays a step, 64 to 1,048,576, or up to a tile's more.
    pub rays_per_step: usize,
    /// Vertices of the last grid before pruning, 4,096 to 500,000,000.
    pub voxels: usize,
    /// Where all photographs see one light (or appearances are off), the last grid gets more vertices than
    /// `voxels`, until a voxel is so many pixels of the middling view wide, as seen at the scene's
    /// centre; 0 (never) or 0.25 to 64. Takes two levels at least.
    pub voxel_px: f64,
    /// So many vertices at most for that, 4,096 to 500,000,000.
    pub max_voxels: usize,
    /// The last grid has fewer vertices than `voxels` where a voxel would be narrower than so many pixels
    /// of the middling view, as seen at the scene's centre: small photographs do not tell what lies between
    /// their pixels; 0 (never) to 1. Takes two levels at least.
    pub min_voxel_px: f64,
    /// Coarse-to-fine levels, 1 to 5; each has eight times the voxels of the last (and more where
    /// `voxel_px` asks for more).
    pub levels: usize,
    /// Learning rate of the raw density (Adam), > 0.
    pub learning_rate_density: f64,
    /// Learning rate of the constant colour coefficients, > 0.
    pub learning_rate_colour: f64,
    /// The direction-dependent coefficients' rate as a share of the constant ones', 0 to 1.
    pub view_dependence: f64,
    /// Learning rate of the appearance codes, > 0.
    pub learning_rate_appearance: f64,
    /// Learning rates fall to this share of themselves, exponentially; 0 to 1.
    pub final_rate: f64,
    /// The field is the mean of the states of this last share of the steps, unless the last one explains
    /// the photographs clearly better; 0 (the last state alone) to 0.3, in which the rows are the same.
    pub mean_of_last: f64,
    /// Weight of the distortion loss (mip-NeRF 360 eq. 15), >= 0. In the open, where
    /// nothing ends a ray, 0.03 keeps haze away.
    pub distortion: f64,
    /// Weight of the sum of a ray's alphas, >= 0: clears haze and leaves walls alone, but
    /// wears away thin things and the ground, which is seen at a glancing angle.
    pub sparsity: f64,
    /// In bounded scenes with a known background: weight of the light stopped along rays
    /// whose pixel shows exactly that colour, >= 0. It is a mask loss (as NeuS, Wang et
    /// al. 2021, has one) in its linear form: thin haze of the background's colour goes;
    /// what is opaque has no more to pay.
    pub clear_background: f64,
    /// Weight of density's total variation, >= 0.
    pub smooth_density: f64,
    /// Weight of colour's total variation, >= 0.
    pub smooth_colour: f64,
    /// Where all photographs see one light (or appearances are off), both total variations count this much:
    /// there each photograph's own light is no haze to be smoothed away; above 0, to 1.
    pub smooth_in_one_light: f64,
    /// Where views look further apart than this (see [`crate::Spacing`]), both total
    /// variations are multiplied, and `view_dependence` divided, by the square of how many
    /// times as far, 16 at most; degrees, 1 to 180 (never).
    pub smoother_beyond_deg: f64,
    /// Residuals above this count linearly (Huber), so that passers-by pull
    /// less; 0 = plain squares. In colour units.
    pub huber: f64,
    /// A vertex is dropped when its largest weight in any picture stayed below
    /// this, and at the end a cell that never has this share of a pixel (0.01 at
    /// most); 0 to 1.
    pub prune_weight: f64,
    /// Light the fresh grid stops on the way across, 0 to 1: too little, and it is
    /// wiped out before it has explained anything; too much, and clouds form before
    /// the cameras.
    pub initial_opacity: f64,
    /// Distance between samples in training, voxels, 0.25 to 2; pictures take half
    /// a voxel.
    pub step_voxels: f64,
    /// In training, a sample that weighs less than this in its pixel is passed
    /// over, 0 to 0.1.
    pub skip_weight: f64,
    /// A vertex that weighs less than this in its tile's pixels together moves only
    /// now and then, and then as much the more; 0 to 0.5.
    pub faint_weight: f64,
    /// Side of the square tiles that rays are drawn in on the last level, pixels: 1,
    /// 2, 4, 8 or 16; a quarter of it on each level before.
    pub tile_px: usize,
    /// Per-view appearance.
    pub appearance: AppearanceMode,
}

impl Default for FieldConfig {
    fn default() -> Self {
        Self {
            steps: 1000,
            rays_per_step: 4096,
            voxels: 2_000_000,
            voxel_px: 0.0,
            max_voxels: 48_000_000,
            min_voxel_px: 0.8,
            levels: 3,
            learning_rate_density: 0.3,
            learning_rate_colour: 0.05,
            view_dependence: 0.2,
            learning_rate_appearance: 0.01,
            final_rate: 0.3,
            mean_of_last: 0.2,
            distortion: 0.01,
            sparsity: 0.0,
            clear_background: 0.05,
            smooth_density: 1e-5,
            smooth_colour: 1e-4,
            smooth_in_one_light: 1.0,
            smoother_beyond_deg: 14.0,
            huber: 0.0,
            prune_weight: 0.01,
            initial_opacity: 0.3,
            step_voxels: 1.0,
            skip_weight: 5e-4,
            faint_weight: 0.003,
            tile_px: 4,
            appearance: AppearanceMode::Auto,
        }
    }
}

impl FieldConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// [`FieldError::Setting`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), FieldError> {
        let check = |ok: bool, key, value: String, allowed| {
            if ok { Ok(()) } else { Err(FieldError::Setting { key, value, allowed }) }
        };
        // Training counts in single precision.
        let positive = |v: f64| (v as f32).is_finite() && v > 0.0;
        let weight = |v: f64| (v as f32).is_finite() && v >= 0.0;
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let number = |v: f64| v.to_string();
        check((1..=1_000_000).contains(&self.steps), "field.steps", self.steps.to_string(), "1 to 1000000")?;
        check(
            (64..=1 << 20).contains(&self.rays_per_step),
            "field.rays_per_step",
            self.rays_per_step.to_string(),
            "64 to 1048576",
        )?;
        check(
            (4096..=500_000_000).contains(&self.voxels),
            "field.voxels",
            self.voxels.to_string(),
            "4096 to 500000000",
        )?;
        let px = self.voxel_px;
        check(px == 0.0 || (0.25..=64.0).contains(&px), "field.voxel_px", number(px), "0 or 0.25 to 64")?;
        check(
            (4096..=500_000_000).contains(&self.max_voxels),
            "field.max_voxels",
            self.max_voxels.to_string(),
            "4096 to 500000000",
        )?;
        check((0.0..=1.0).contains(&self.min_voxel_px), "field.min_voxel_px", number(self.min_voxel_px), "0 to 1")?;
        check((1..=5).contains(&self.levels), "field.levels", self.levels.to_string(), "1 to 5")?;
        for (key, value) in [
            ("field.learning_rate_density", self.learning_rate_density),
            ("field.learning_rate_colour", self.learning_rate_colour),
            ("field.learning_rate_appearance", self.learning_rate_appearance),
            ("field.final_rate", self.final_rate),
            ("field.initial_opacity", self.initial_opacity),
            ("field.smooth_in_one_light", self.smooth_in_one_light),
        ] {
            check(positive(value), key, number(value), "a finite number above 0")?;
        }
        for (key, value) in [
            ("field.distortion", self.distortion),
            ("field.sparsity", self.sparsity),
            ("field.clear_background", self.clear_background),
            ("field.smooth_density", self.smooth_density),
            ("field.smooth_colour", self.smooth_colour),
            ("field.huber", self.huber),
        ] {
            check(weight(value), key, number(value), "a finite number from 0 up")?;
        }
        for (key, value) in [
            ("field.view_dependence", self.view_dependence),
            ("field.prune_weight", self.prune_weight),
            ("field.final_rate", self.final_rate),
            ("field.initial_opacity", self.initial_opacity),
            ("field.smooth_in_one_light", self.smooth_in_one_light),
        ] {
            check(share(value), key, number(value), "0 to 1")?;
        }
        check((0.0..=0.3).contains(&self.mean_of_last), "field.mean_of_last", number(self.mean_of_last), "0 to 0.3")?;
        let apart = self.smoother_beyond_deg;
        check((1.0..=180.0).contains(&apart), "field.smoother_beyond_deg", number(apart), "1 to 180")?;
        check((0.25..=2.0).contains(&self.step_voxels), "field.step_voxels", number(self.step_voxels), "0.25 to 2")?;
        check((0.0..=0.1).contains(&self.skip_weight), "field.skip_weight", number(self.skip_weight), "0 to 0.1")?;
        check((0.0..=0.5).contains(&self.faint_weight), "field.faint_weight", number(self.faint_weight), "0 to 0.5")?;
        let sides = [1, 2, 4, 8, 16];
        check(sides.contains(&self.tile_px), "field.tile_px", self.tile_px.to_string(), "1, 2, 4, 8 or 16")?;
        check(self.initial_opacity < 1.0, "field.initial_opacity", number(self.initial_opacity), "above 0, below 1")
    }
}
