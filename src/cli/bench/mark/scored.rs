//! What a judgement of a marked field says.

use serde::{Deserialize, Serialize};

use super::harm::Set;
use super::laid::Laid;
use super::permuted::Followed;
use cairn_service::query::report::{Recovery, Right};

/// Everything about one marked field and its detector; pictures are rounded to 8 bits.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Judged {
    /// Held-out views.
    pub views: usize,
    /// Of them, those in some identity's cluster.
    pub marked_views: usize,
    /// Mean PSNR of the base field's renders against photographs, dB.
    pub base_psnr_db: f64,
    /// Mean PSNR of the marked field's, dB.
    pub marked_psnr_db: f64,
    /// Mean SSIM of the base field's renders against photographs.
    pub base_ssim: f64,
    /// Mean SSIM of the marked field's.
    pub marked_ssim: f64,
    /// Mean PSNR of marked against base renders where there is a mark, dB.
    pub kept_db: f64,
    /// Mean change of the PSNR against photographs where there is a mark, dB; `None` where no view has one.
    pub marked_change_db: Option<f64>,
    /// Right classes over theta's and theta_0's renders.
    pub classes: Right,
    /// Of theta's renders where there is a mark, those whose identity is told.
    pub marks: Right,
    /// Each identity's signal.
    pub identities: Vec<Recovery>,
    /// Under each distortion.
    pub harms: Vec<Harmed>,
    /// Whether class and hidden picture follow the mark or the view, with permuted identities.
    pub followed: Followed,
    /// What carries no mark, and is to be `unmarked`.
    pub unmarked: Vec<Silent>,
    /// Different pictures among them, all kinds together.
    pub unmarked_pictures: usize,
    /// What laying pictures over the field says, where that was asked for and can be.
    pub laid: Option<Laid>,
    /// Expected calibration error of the answers to all of the above but `followed` and `laid`.
    pub calibration_error: f64,
    /// The same of those of them that are not about harmed renders.
    pub calibration_error_unharmed: f64,
    /// How often the answers behind the first are right, by how sure they are.
    pub bands: Vec<Band>,
    /// The same of those behind the second.
    pub bands_unharmed: Vec<Band>,
    /// Answers behind the first.
    pub answers: usize,
    /// Of them, those that only a closer look gave.
    pub by_closer_look: Right,
    /// The same of those behind the second.
    pub by_closer_look_unharmed: Right,
}

/// Answers of about the same confidence.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Band {
    /// The least confidence, [0, 1].
    pub from: f64,
    /// Right ones.
    pub right: Right,
}

/// Recovery after something was done to the renders.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Harmed {
    /// What was done.
    pub name: String,
    /// Its set.
    pub set: Set,
    /// Right classes over theta's and theta_0's renders.
    pub classes: Right,
    /// Of theta's renders where there is a mark, those whose identity is told.
    pub marks: Right,
    /// Of theta_0's renders alone, after the same was done to them, those that are called `unmarked`.
    pub twins: Right,
    /// Mean hidden SSIM of theta's renders.
    pub ssim: Option<f64>,
}

/// Pictures without a mark.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Silent {
    /// What they are.
    pub what: String,
    /// Different pictures.
    pub pictures: usize,
    /// Of the answers, one to each of a picture's forms, those that were called `unmarked`.
    pub silent: Right,
    /// Those of which nothing is recovered: black, silent and without text.
    pub empty: Right,
}
