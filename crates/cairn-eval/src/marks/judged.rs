//! What a judgement of a marked field says, and what it is made of.

use std::ops::Range;

use cairn_field::Appearance;
use cairn_mark::{Detection, Detector, Signal};
use cairn_scene::{Camera, Picture};
use cairn_service::query::recovery::picture_ssim;
use cairn_service::query::report::{Recovery, Right};
use serde::{Deserialize, Serialize};

use super::attack::Set;

/// A held-out view.
pub struct View {
    /// Its camera.
    pub camera: Camera,
    /// Its photograph.
    pub photograph: Picture,
    /// The light that it is rendered in.
    pub appearance: Appearance,
    /// The identity of its pose, 0 for none.
    pub truth: usize,
    /// The base field's render, in 8 bits.
    pub base: Picture,
    /// The marked field's, in 8 bits.
    pub marked: Picture,
}

/// A detector that is asked, and remembers how sure it was.
pub struct Asked {
    /// The detector.
    pub detector: Detector,
    /// What each identity hides.
    pub signals: Vec<Signal>,
    /// Confidence of each answer, and whether it was right.
    pub answers: Vec<(f64, bool)>,
    /// Which of them a center crop gave.
    pub by_center_crop: Vec<usize>,
}

impl Asked {
    /// Whether `picture`, whose class is `truth`, is predicted so; and what is recovered of it.
    pub fn ask(&mut self, picture: &Picture, truth: usize) -> anyhow::Result<(bool, Detection)> {
        let found = self.detector.detect(picture)?;
        let class = found.identity.unwrap_or(0) as usize;
        let sure = found.probabilities.get(class).copied().unwrap_or_default();
        if found.is_center_crop {
            self.by_center_crop.push(self.answers.len());
        }
        // Sums of probabilities may miss one by a rounding.
        self.answers.push((f64::from(sure).clamp(0.0, 1.0), class == truth));
        Ok((class == truth, found))
    }

    /// How often answers that a center crop gave are right, but for those at `left_out`.
    pub(super) fn right_by_center_crop(&self, left_out: &Range<usize>) -> Right {
        let mut right = Right::default();
        let of = self.by_center_crop.iter().filter(|at| !left_out.contains(at));
        of.for_each(|at| right.count(self.answers[*at].1));
        right
    }

    /// SSIM of what was recovered against the picture of identity `truth`, if it hides one.
    pub(super) fn likeness(&self, truth: usize, found: &Detection) -> anyhow::Result<Option<f64>> {
        Ok(picture_ssim(&self.signals[truth - 1], found)?)
    }
}

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
    /// Of theta's renders where there is a mark, those whose identity is predicted.
    pub marks: Right,
    /// Each identity's signal.
    pub identities: Vec<Recovery>,
    /// Under each distortion.
    pub attacks: Vec<Attacked>,
    /// Whether class and hidden picture follow the mark or the view, with exchanged marks.
    pub followed: Followed,
    /// What carries no mark, and is to be `unmarked`.
    pub unmarked: Vec<Silent>,
    /// Different pictures among them, all kinds together.
    pub unmarked_pictures: usize,
    /// What registration says, where that was asked for and can be.
    pub registered: Option<Registered>,
    /// Expected calibration error of the answers to all of the above but `followed` and `registered`.
    pub calibration_error: f64,
    /// The same of those of them that are not about attacked renders.
    pub calibration_error_unattacked: f64,
    /// How often the answers behind the first are right, by how sure they are.
    pub bands: Vec<Band>,
    /// The same of those behind the second.
    pub bands_unattacked: Vec<Band>,
    /// Answers behind the first.
    pub answers: usize,
    /// Of them, those that only a center crop gave.
    pub by_center_crop: Right,
    /// The same of those behind the second.
    pub by_center_crop_unattacked: Right,
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
pub struct Attacked {
    /// What was done.
    pub name: String,
    /// Its set.
    pub set: Set,
    /// Right classes over theta's and theta_0's renders.
    pub classes: Right,
    /// Of theta's renders where there is a mark, those whose identity is predicted.
    pub marks: Right,
    /// Of theta_0's renders alone, after the same was done to them, those that are called `unmarked`.
    pub unmarked_pairs: Right,
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

/// Of renders whose mark and view speak for different identities, how many follow which.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// The class is that of the mark.
    pub mark: Right,
    /// The class is that which the view had before.
    pub view: Right,
    /// What is recovered is the mark's hidden picture: like it ([`MIN_SSIM`]), and more so than like the view's.
    pub hidden_mark: Right,
    /// The other way round.
    pub hidden_view: Right,
    /// theta_0's renders at the same poses that are called `unmarked`.
    pub unmarked: Right,
}

/// What came of it with cameras known, and searched for.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Registered {
    /// At the cameras that renders were made with.
    pub known: Answers,
    /// Where they were searched for, on fewer views.
    pub searched: Answers,
    /// At the cameras that renders were made with, on fewer views, after each of some attacks.
    pub attacked: Vec<(String, Answers)>,
}

/// Answers to registered pictures.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Answers {
    /// Right classes over theta's and theta_0's renders: a mark that stands out is believed, and where none does the
    /// classifier answers.
    pub classes: Right,
    /// Of theta's renders that have a mark, those in which it stands out.
    pub found: Right,
    /// Of pictures without a mark, or whose mark is another place's, those in which none stands out.
    pub silent: Right,
    /// Pictures, and the seconds for all of them; the classifier's, where it was asked, and small renders of the
    /// training views are in them.
    pub pictures: usize,
    /// See `pictures`.
    pub seconds: f64,
}
