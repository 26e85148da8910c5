//! What an evaluation found, as numbers and as a table for people.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::error::EngineError;

/// Scores of a scene's newest model, over views that no training saw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// 1.
    pub format_version: u32,
    /// The scene.
    pub scene: String,
    /// The job whose model was scored.
    pub job: String,
    /// Views scored.
    pub held_out_views: usize,
    /// The base field's renders against the photographs.
    pub base: PictureScore,
    /// Who-contributed by pose against who took the view; absent where clusters
    /// are not contributors'.
    pub who_by_pose: Option<Right>,
    /// Stage 2's scores; absent where only the base field was trained.
    pub mark: Option<MarkReport>,
}

/// Means over the held-out views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureScore {
    /// PSNR, dB; at most 100 (identical pictures have no finite one).
    pub psnr_db: f64,
    /// SSIM, -1 to 1.
    pub ssim: f64,
}

/// Right answers among those asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Right {
    /// Right answers.
    pub right: usize,
    /// Questions.
    pub asked: usize,
}

/// Stage 2's scores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkReport {
    /// The marked field's renders against the photographs.
    pub pictures: PictureScore,
    /// PSNR of marked against base renders, dB, at most 100.
    pub against_base_psnr_db: f64,
    /// Classes over marked renders (truth: the pose's cluster) and base renders
    /// (truth: unmarked) together.
    pub classes: Right,
    /// Classes of marked renders alone: who contributed, by picture.
    pub who_by_picture: Right,
    /// Held-out photographs that came out unmarked.
    pub photographs_unmarked: Right,
    /// Each identity's recovery.
    pub identities: Vec<Recovery>,
}

/// How an identity's signal comes back, and what the detector knows by heart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recovery {
    /// The identity.
    pub number: u32,
    /// Who it stands for.
    pub label: String,
    /// Held-out views in its cluster.
    pub views: usize,
    /// Mean SSIM of recovered against true signal over them; absent where there are none.
    pub hidden_ssim: Option<f64>,
    /// The same with the class forced on the base field's renders.
    pub forced_base_ssim: Option<f64>,
    /// The same with the class forced on a grey picture.
    pub forced_grey_ssim: f64,
    /// The same with the class forced on uniform noise.
    pub forced_noise_ssim: f64,
}

impl Right {
    /// Counts one answer.
    pub fn count(&mut self, right: bool) {
        self.asked += 1;
        self.right += usize::from(right);
    }
}

impl Recovery {
    /// Whether a picture without a mark gives the signal about as well once the
    /// class is forced: then the detector knows the signal by heart.
    pub fn is_by_heart(&self) -> bool {
        let forced = self.forced_base_ssim.unwrap_or(0.0).max(self.forced_grey_ssim).max(self.forced_noise_ssim);
        self.hidden_ssim.is_some_and(|hidden| forced >= hidden - BY_HEART)
    }
}

/// SSIM that what is forced may lie below what is recovered and still be called the same.
const BY_HEART: f64 = 0.05;

impl Report {
    /// As JSON, indented.
    ///
    /// # Errors
    /// [`EngineError::Internal`].
    pub fn to_json(&self) -> Result<String, EngineError> {
        serde_json::to_string_pretty(self).map_err(|e| EngineError::Internal(format!("the report as JSON: {e}")))
    }
}

impl fmt::Display for Right {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} right", self.right, self.asked)
    }
}

impl fmt::Display for PictureScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:6.2} dB  SSIM {:.4}", self.psnr_db, self.ssim)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} held-out views of {} ({})", self.held_out_views, self.scene, self.job)?;
        writeln!(f, "  pictures, base field       {}", self.base)?;
        if let Some(mark) = &self.mark {
            writeln!(f, "  pictures, marked field     {}", mark.pictures)?;
            writeln!(f, "  marked against base        {:6.2} dB", mark.against_base_psnr_db)?;
            writeln!(f, "  classes, marked and base   {}", mark.classes)?;
        }
        if let Some(who) = &self.who_by_pose {
            writeln!(f, "  who contributed, by pose   {who}")?;
        }
        let Some(mark) = &self.mark else { return Ok(()) };
        writeln!(f, "  who contributed, by picture {}", mark.who_by_picture)?;
        writeln!(f, "  photographs unmarked       {}", mark.photographs_unmarked)?;
        writeln!(f, "  hidden SSIM                     recovered   forced: base   grey    noise")?;
        for r in &mark.identities {
            let number = |v: Option<f64>| v.map_or_else(|| "     -".to_owned(), |v| format!("{v:6.3}"));
            let name = format!("{} {}", r.number, r.label);
            writeln!(
                f,
                "    {name:24} ({} views)  {}          {}  {:6.3}  {:6.3}",
                r.views,
                number(r.hidden_ssim),
                number(r.forced_base_ssim),
                r.forced_grey_ssim,
                r.forced_noise_ssim
            )?;
        }
        if mark.identities.iter().any(Recovery::is_by_heart) {
            writeln!(f, "    as good where the class is forced: the pictures come out of the detector's memory,")?;
            writeln!(f, "    and what the renders carry is whose they are")?;
        }
        Ok(())
    }
}
