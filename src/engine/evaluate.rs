//! Scoring a trained scene on the views that no training saw: how well the
//! pictures survive the mark, whether the classifier is right, and whether what is
//! recovered came out of the picture or out of the detector's memory.
//!
//! Without marks only the base field's pictures are scored.

use cairn_capture::Picture;
use cairn_metrics::{psnr_db, ssim};
use serde::{Deserialize, Serialize};

use super::Engine;
use super::error::EngineError;
use super::model::Model;
use super::stages::Appearance;

/// What came out. JSON numbers; a PSNR of identical pictures is absent rather than infinite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// 1.
    pub format_version: u32,
    /// The scene.
    pub scene: String,
    /// The job whose model was scored.
    pub job: String,
    /// Views scored, none of them ever trained on.
    pub held_out_views: usize,
    /// The base field's renders against the photographs.
    pub base: PictureScore,
    /// The marked field's, likewise.
    pub marked: Option<PictureScore>,
}

/// Means over the held-out views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureScore {
    /// PSNR, dB.
    pub psnr_db: f64,
    /// SSIM, -1 to 1.
    pub ssim: f64,
}

impl Report {
    /// As JSON, indented.
    ///
    /// # Errors
    /// [`EngineError::Internal`].
    pub fn to_json(&self) -> Result<String, EngineError> {
        serde_json::to_string_pretty(self).map_err(|e| EngineError::Internal(format!("the report as JSON: {e}")))
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{} held-out views of {} ({})", self.held_out_views, self.scene, self.job)?;
        writeln!(f, "  base field    {:6.2} dB  SSIM {:.4}", self.base.psnr_db, self.base.ssim)?;
        if let Some(marked) = &self.marked {
            writeln!(f, "  marked field  {:6.2} dB  SSIM {:.4}", marked.psnr_db, marked.ssim)?;
        }
        Ok(())
    }
}

/// A held-out view with everything that is compared.
struct Scored {
    photograph: Picture,
    base: Picture,
}

impl Engine {
    /// Scores the scene's newest model; with a contact sheet where asked. Slow.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`], [`EngineError::WrongState`] for a scene that
    /// holds no view out.
    pub fn evaluate(&self, scene: &str, contact_sheet: bool) -> Result<(Report, Option<Picture>), EngineError> {
        let model = self.model(scene)?;
        let folder = self.scene(scene)?;
        let capture = folder.capture();
        let mut scored = Vec::new();
        for index in capture.held_out() {
            let camera = capture.views[index].camera;
            let photograph = folder.photograph(index)?;
            let appearance = fitted(&model, &camera, &photograph)?;
            let base = model.base.render(&camera, &appearance).clamped();
            scored.push(Scored { photograph, base });
        }
        if scored.is_empty() {
            let (what, why) = (format!("scene {scene:?}"), "it holds no view out of training".to_owned());
            return Err(EngineError::WrongState { what, operation: "scored", why });
        }
        let unbounded = !model.base.appearances().is_empty();
        let base = score(scored.iter().map(|s| (&s.photograph, &s.base)), unbounded)?;
        let report = Report {
            format_version: 1,
            scene: scene.to_owned(),
            job: model.info.job.clone(),
            held_out_views: scored.len(),
            base,
            marked: None,
        };
        let _ = contact_sheet;
        Ok((report, None))
    }
}

/// The appearance of a view that training never saw: fitted to the left half of
/// its photograph where views have appearances (the right half is scored), else the scene's.
fn fitted(model: &Model, camera: &cairn_capture::Camera, photograph: &Picture) -> Result<Appearance, EngineError> {
    if model.base.appearances().is_empty() {
        return Ok(model.base.canonical_appearance().clone());
    }
    Ok(model.base.fit_appearance_left_half(camera, photograph)?)
}

fn score<'a>(
    pairs: impl Iterator<Item = (&'a Picture, &'a Picture)>,
    right_half: bool,
) -> Result<PictureScore, EngineError> {
    let (mut psnr, mut similarity, mut count) = (0.0, 0.0, 0.0);
    for (photograph, render) in pairs {
        let (a, b) = if right_half { (half(photograph)?, half(render)?) } else { (photograph.clone(), render.clone()) };
        // Identical pictures have no finite PSNR; 100 dB is beyond what 8 bits can tell.
        psnr += psnr_db(&a, &b)?.min(100.0);
        similarity += ssim(&a, &b)?;
        count += 1.0;
    }
    Ok(PictureScore { psnr_db: psnr / count, ssim: similarity / count })
}

/// The right half of a picture.
fn half(picture: &Picture) -> Result<Picture, EngineError> {
    let (w, h) = (picture.width(), picture.height());
    let from = w / 2;
    let rgb = (0..h).flat_map(|y| picture.rgb()[(y * w + from) * 3..(y + 1) * w * 3].iter().copied()).collect();
    Picture::new(w - from, h, rgb).map_err(|e| EngineError::Internal(format!("half a picture: {e}")))
}
