//! What an evaluation found, as numbers and as a table for people.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::error::EngineError;

/// What 8 bits cannot tell from perfect, dB.
pub const PERFECT_DB: f64 = 100.0;

/// Scores of a scene's newest model, over views that no training saw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// [`VERSION`].
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
    /// Held-out views of some identity's cluster: the marked field's other renders are the base field's.
    pub marked_views: usize,
    /// PSNR of these views' marked against base renders, dB, at most 100; `None` where there are none.
    pub against_base_psnr_db: Option<f64>,
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
    /// SSIM of the hidden picture, -1 to 1; absent where it hides none.
    pub picture_ssim: Option<Measured>,
    /// Signal-to-noise ratio of the hidden sound, dB, at most 100; absent where it hides none.
    pub audio_snr_db: Option<Measured>,
    /// Log-spectral distance of the hidden sound, dB, 0 for the same; absent where it hides none.
    pub audio_lsd_db: Option<Measured>,
    /// Share of the hidden text's characters (bytes), 0 to 1; absent where it hides none.
    pub text_characters: Option<Measured>,
    /// Share of the hidden text's bits, 0 to 1; absent where it hides none.
    pub text_bits: Option<Measured>,
}

/// How near what was recovered comes to the truth, means over the held-out views of
/// the identity's cluster, and how near where the class is forced instead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// From the marked renders; absent where there are no such views.
    pub recovered: Option<f64>,
    /// With the class forced on the base field's renders of them.
    pub forced_base: Option<f64>,
    /// With the class forced on a grey picture.
    pub forced_grey: f64,
    /// With the class forced on uniform noise.
    pub forced_noise: f64,
}

impl Right {
    /// Counts one answer.
    pub fn count(&mut self, right: bool) {
        self.asked += 1;
        self.right += usize::from(right);
    }
}

impl Measured {
    /// Whether the best that is forced comes within `slack` of what is recovered.
    fn is_by_heart(&self, slack: f64) -> bool {
        let forced = self.forced_base.into_iter().chain([self.forced_grey, self.forced_noise]);
        let best = forced.fold(f64::NEG_INFINITY, f64::max);
        self.recovered.is_some_and(|recovered| best >= recovered - slack)
    }
}

impl Recovery {
    /// Whether a picture without a mark gives a part of the signal about as well once
    /// the class is forced: then the detector knows it by heart.
    pub fn is_by_heart(&self) -> bool {
        let within = |m: &Option<Measured>, slack| m.is_some_and(|m| m.is_by_heart(slack));
        within(&self.picture_ssim, SHARE_BY_HEART)
            || within(&self.audio_snr_db, DB_BY_HEART)
            || within(&self.text_characters, SHARE_BY_HEART)
    }

    /// What was measured, with its heading and digits behind the point.
    fn measures(&self) -> [(&'static str, usize, Option<Measured>); 5] {
        [
            ("hidden SSIM", 3, self.picture_ssim),
            ("hidden sound, SNR in dB", 2, self.audio_snr_db),
            ("hidden sound, LSD in dB", 2, self.audio_lsd_db),
            ("hidden text, characters", 3, self.text_characters),
            ("hidden text, bits", 3, self.text_bits),
        ]
    }
}

/// Format version of a report: 2 since signals are sounds and texts as well.
pub const VERSION: u32 = 2;
/// SSIM, or share of characters, that what is forced may lie below what is recovered
/// and still be called the same.
const SHARE_BY_HEART: f64 = 0.05;
/// The same for SNR, dB.
const DB_BY_HEART: f64 = 3.0;

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
            if let Some(db) = mark.against_base_psnr_db {
                let (marked, all) = (mark.marked_views, self.held_out_views);
                writeln!(f, "  marked against base        {db:6.2} dB  ({marked} of {all} views carry a mark)")?;
            }
            writeln!(f, "  classes, marked and base   {}", mark.classes)?;
        }
        if let Some(who) = &self.who_by_pose {
            writeln!(f, "  who contributed, by pose   {who}")?;
        }
        let Some(mark) = &self.mark else { return Ok(()) };
        writeln!(f, "  who contributed, by picture {}", mark.who_by_picture)?;
        writeln!(f, "  photographs unmarked       {}", mark.photographs_unmarked)?;
        for measure in 0..5 {
            let hidden = mark.identities.iter().filter_map(|r| {
                let (heading, digits, measured) = r.measures()[measure];
                Some((r, heading, digits, measured?))
            });
            for (i, (r, heading, digits, m)) in hidden.enumerate() {
                if i == 0 {
                    writeln!(f, "  {heading:32}recovered   forced: base   grey    noise")?;
                }
                let number = |v: Option<f64>| v.map_or_else(|| "     -".to_owned(), |v| format!("{v:6.digits$}"));
                let name = format!("{} {}", r.number, r.label);
                writeln!(
                    f,
                    "    {name:24} ({} views)  {}          {}  {:6.digits$}  {:6.digits$}",
                    r.views,
                    number(m.recovered),
                    number(m.forced_base),
                    m.forced_grey,
                    m.forced_noise
                )?;
            }
        }
        if mark.identities.iter().any(Recovery::is_by_heart) {
            writeln!(f, "    as good where the class is forced: the signals come out of the detector's memory,")?;
            writeln!(f, "    and what the renders carry is whose they are")?;
        }
        Ok(())
    }
}
