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
#[serde(deny_unknown_fields)]
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
    /// The field is the mean of the states of this last share of the steps, unless the last one explains
    /// the photographs clearly better; 0 (the last state alone) to 0.3, in which the rows are the same.
    pub mean_of_last: f64,
    /// Weight of the distortion loss (mip-NeRF 360 eq. 15), >= 0. In the open, where
    /// nothing ends a ray, 0.03 keeps haze away.
    pub distortion: f64,
    /// In bounded scenes with a known background: weight of the light stopped along rays
    /// whose pixel shows exactly that colour, >= 0. It is a mask loss (as NeuS, Wang et
    /// al. 2021, has one) in its linear form: thin haze of the background's colour goes;
    /// what is opaque has no more to pay.
    pub clear_background: f64,
    /// Weight of the squared differences of neighbouring densities, >= 0.
    pub smooth_density: f64,
    /// Weight of the squared differences of neighbouring colours, >= 0.
    pub smooth_colour: f64,
    /// Where all photographs see one light (or appearances are off), both count this much:
    /// there each photograph's own light is no haze to be smoothed away; above 0, to 1.
    pub smooth_in_one_light: f64,
    /// Where views look further apart than this (see [`crate::Spacing`]), both total
    /// variations are multiplied, and direction-dependent colour's rate divided, by the square of how many
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
            mean_of_last: 0.2,
            distortion: 0.01,
            clear_background: 0.05,
            smooth_density: 1e-5,
            smooth_colour: 1e-4,
            smooth_in_one_light: 1.0,
            smoother_beyond_deg: 14.0,
            huber: 0.0,
            prune_weight: 0.01,
            initial_opacity: 0.3,
            step_voxels: 1.0,
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
        let check = |ok: bool, key, value: f64, allowed| {
            if ok { Ok(()) } else { Err(FieldError::Setting { key, value: value.to_string(), allowed }) }
        };
        // Training counts in single precision.
        let (least, most) = (f64::MIN_POSITIVE, f64::from(f32::MAX));
        let (positive, weight, share) = ("a finite number above 0", "a finite number from 0 up", "0 to 1");
        for (key, value, low, high, allowed) in [
            ("field.steps", self.steps as f64, 1.0, 1e6, "1 to 1000000"),
            ("field.rays_per_step", self.rays_per_step as f64, 64.0, 1_048_576.0, "64 to 1048576"),
            ("field.voxels", self.voxels as f64, 4096.0, 5e8, "4096 to 500000000"),
            ("field.max_voxels", self.max_voxels as f64, 4096.0, 5e8, "4096 to 500000000"),
            ("field.min_voxel_px", self.min_voxel_px, 0.0, 1.0, share),
            ("field.levels", self.levels as f64, 1.0, 5.0, "1 to 5"),
            ("field.learning_rate_density", self.learning_rate_density, least, most, positive),
            ("field.initial_opacity", self.initial_opacity, least, most, positive),
            ("field.smooth_in_one_light", self.smooth_in_one_light, least, most, positive),
            ("field.distortion", self.distortion, 0.0, most, weight),
            ("field.clear_background", self.clear_background, 0.0, most, weight),
            ("field.smooth_density", self.smooth_density, 0.0, most, weight),
            ("field.smooth_colour", self.smooth_colour, 0.0, most, weight),
            ("field.huber", self.huber, 0.0, most, weight),
            ("field.prune_weight", self.prune_weight, 0.0, 1.0, share),
            ("field.initial_opacity", self.initial_opacity, 0.0, 1.0, share),
            ("field.smooth_in_one_light", self.smooth_in_one_light, 0.0, 1.0, share),
            ("field.mean_of_last", self.mean_of_last, 0.0, 0.3, "0 to 0.3"),
            ("field.smoother_beyond_deg", self.smoother_beyond_deg, 1.0, 180.0, "1 to 180"),
            ("field.step_voxels", self.step_voxels, 0.25, 2.0, "0.25 to 2"),
        ] {
            check((low..=high).contains(&value), key, value, allowed)?;
        }
        let (px, side) = (self.voxel_px, self.tile_px);
        check(px == 0.0 || (0.25..=64.0).contains(&px), "field.voxel_px", px, "0 or 0.25 to 64")?;
        check([1, 2, 4, 8, 16].contains(&side), "field.tile_px", side as f64, "1, 2, 4, 8 or 16")?;
        check(self.initial_opacity < 1.0, "field.initial_opacity", self.initial_opacity, "above 0, below 1")
    }
}
