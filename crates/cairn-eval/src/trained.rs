//! Stage 1 as work: a field trained from a capture, scored on held-out views, and rendered by a fresh process.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use cairn_field::{BaseTrainer, Field, FieldConfig};
use cairn_scene::metrics::{psnr_db, ssim};
use cairn_scene::{Camera, Picture, encode_png};
use cairn_service::export::sheet::{Tile, contact_sheet};
use cairn_service::query::evaluate::{OFF, difference, eight_bits, half};
use cairn_service::query::report::PERFECT_DB;
use serde::{Deserialize, Serialize};

use crate::baseline::stego::Stego;
use crate::children::{Children, Work};
use crate::file::{open, read, write};
use crate::measures::psnr_db_masked;
use crate::memory::peak_mib;
use crate::progress::Progress;
use crate::source::Source;
use crate::timing::{median, median_within};

/// Bytes of a MiB.
const MIB: f64 = 1024.0 * 1024.0;
/// Most views on a sheet.
const SHEET_ROWS: usize = 6;
/// Its tiles' width and height, px.
const TILE: [usize; 2] = [256, 256];
/// Renders of a view that are timed at most, and seconds after which no more are.
const LAPS: (usize, f64) = (5, 4.0);

/// A training from decoded photographs to the stored field.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Train {
    /// The capture.
    pub source: Source,
    /// Its settings.
    pub config: FieldConfig,
    /// The seed.
    pub seed: u64,
    /// Views that teach nothing, by their indices in the capture; see [`BaseTrainer::without`].
    pub without: Vec<usize>,
    /// How a picture is hidden in the photographs (suite `baseline`).
    pub stego: Option<Stego>,
    /// The file to store the field in.
    pub field: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

impl Train {
    /// Trains unless the field is there. It gets its own name only once it is whole, so that a run that was stopped goes on
    /// there.
    ///
    /// # Errors
    /// Those of the training, and of a file that cannot be renamed.
    pub fn unless_kept(self, children: &Children) -> anyhow::Result<()> {
        if self.field.is_file() {
            return Ok(());
        }
        let (field, filling) = (self.field.clone(), self.field.with_extension("part"));
        children.run(&Self { field: filling.clone(), ..self })?;
        std::fs::rename(&filling, &field).with_context(|| format!("cannot rename {}", filling.display()))
    }
}

/// How a training went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trained {
    /// Seconds from decoded photographs to the finished field; neither decoding nor storing is in them.
    pub seconds: f64,
    /// Steps taken.
    pub steps: u64,
    /// Rays a second over those seconds.
    pub rays_per_s: f64,
    /// The stored field, MiB.
    pub stored_mib: f64,
    /// The most memory held, photographs and storing included, MiB; `None` where the system does not say.
    pub peak_mib: Option<f64>,
}

impl Work for Train {
    const NAME: &'static str = "train";
    type Result = Trained;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Trained> {
        let opened = self.source.open()?;
        let stego = self.stego.as_ref().map(Stego::open).transpose()?;
        let view = |index: usize| {
            let mut view = opened.view(index)?;
            if let Some(stego) = &stego {
                view.picture = stego.hide(&view.picture)?;
            }
            Ok(view.named())
        };
        let views = opened.training().into_iter().map(view).collect::<anyhow::Result<Vec<_>>>()?;
        let without: Vec<String> = self.without.iter().map(|index| opened.name(*index).to_owned()).collect();
        let (frame, background) = (opened.frame()?, opened.background());
        drop(opened);
        let begun = Instant::now();
        let mut trainer = BaseTrainer::new(views, frame, background, self.config.clone(), self.seed)?;
        if !without.is_empty() {
            trainer = trainer.without(|name| without.iter().any(|out| out == name));
        }
        let mut progress = Progress::new(&self.label, trainer.steps_total());
        while trainer.steps_done() < trainer.steps_total() {
            let stats = trainer.step()?;
            progress.at(stats.step, &format!("{:.1} dB, ", stats.psnr_db));
        }
        drop(progress);
        let steps = trainer.steps_done();
        let field = trainer.finish();
        let seconds = begun.elapsed().as_secs_f64();
        let bytes = field.to_bytes()?;
        write(&self.field, &bytes)?;
        Ok(Trained {
            seconds,
            steps,
            rays_per_s: steps as f64 * self.config.rays_per_step as f64 / seconds.max(1e-9),
            stored_mib: bytes.len() as f64 / MIB,
            peak_mib: peak_mib(),
        })
    }
}

/// Renders of held-out views against their photographs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Score {
    /// The capture.
    pub source: Source,
    /// The stored field.
    pub field: PathBuf,
    /// Whether the appearance is fitted to each photograph's left half and its right half scored (NeRF-W's protocol).
    /// Else whole pictures are scored, in the field's own appearance.
    pub right_half: bool,
    /// The file for a contact sheet.
    pub sheet: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

/// Means over the views, of renders rounded to 8 bits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scored {
    /// Views scored.
    pub views: usize,
    /// Whether right halves were scored.
    pub right_half: bool,
    /// Mean PSNR, dB.
    pub psnr_db: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// On the subject alone, where the capture has masks.
    pub mask: Option<Masked>,
}

/// A score on masks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Masked {
    /// Mean PSNR, dB.
    pub psnr_db: f64,
    /// Views with a pixel of the subject in the part that is scored.
    pub views: usize,
}

impl Work for Score {
    const NAME: &'static str = "score";
    type Result = Scored;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Scored> {
        let field = Field::from_bytes(&read(&self.field)?)?;
        let opened = self.source.open()?;
        let held_out = opened.held_out();
        let mut progress = Progress::new(&self.label, held_out.len() as u64);
        let (mut psnr, mut similarity, mut masked) = (Vec::new(), Vec::new(), Vec::new());
        let (mut has_masks, mut sheet) = (false, Vec::new());
        for (done, index) in held_out.iter().enumerate() {
            progress.at(done as u64, "");
            let view = opened.view(*index)?;
            let appearance = if self.right_half {
                field.fit_appearance_left_half(&view.camera, &view.picture)?
            } else {
                field.canonical_appearance().clone()
            };
            let render = eight_bits(&field.render(&view.camera, &appearance))?;
            if done.is_multiple_of(held_out.len().div_ceil(SHEET_ROWS)) {
                sheet.push(row(&view.picture, &render));
            }
            let cut = |picture: &Picture| if self.right_half { half(picture) } else { Ok(picture.clone()) };
            let (photograph, part) = (cut(&view.picture)?, cut(&render)?);
            psnr.push(psnr_db(&photograph, &part)?.min(PERFECT_DB));
            similarity.push(ssim(&photograph, &part)?);
            let Some(mask) = opened.mask(*index)? else { continue };
            has_masks = true;
            let mask = if self.right_half { right_half_of(&mask, render.width()) } else { mask };
            if mask.contains(&true) {
                masked.push(psnr_db_masked(&photograph, &part, &mask)?.min(PERFECT_DB));
            }
        }
        drop(progress);
        anyhow::ensure!(!psnr.is_empty(), "{} holds no view out to score on", self.source.folder.display());
        let shown = !has_masks || !masked.is_empty();
        anyhow::ensure!(shown, "no mask has a pixel in the part that is scored; look at masks");
        write(&self.sheet, &encode_png(&contact_sheet(&sheet, TILE[0], TILE[1])))?;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        Ok(Scored {
            views: psnr.len(),
            right_half: self.right_half,
            psnr_db: mean(&psnr),
            ssim: mean(&similarity),
            mask: has_masks.then(|| Masked { psnr_db: mean(&masked), views: masked.len() }),
        })
    }
}

/// A view's row on the sheet: the photograph, its render and how they differ.
fn row(photograph: &Picture, render: &Picture) -> Vec<Tile> {
    let off = difference(render, photograph, OFF);
    [("Photograph", photograph), ("Render", render), ("Difference x 4", &off)]
        .map(|(label, picture)| Tile { picture: picture.clone(), label: label.to_owned() })
        .to_vec()
}

/// The columns from the middle on, as [`half`] cuts a picture.
fn right_half_of(mask: &[bool], width: usize) -> Vec<bool> {
    mask.chunks_exact(width).flat_map(|row| row[width / 2..].iter().copied()).collect()
}

/// A fresh process that loads a stored field and renders, and nothing else.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Serve {
    /// The stored field.
    pub field: PathBuf,
    /// From where.
    pub cameras: Vec<Camera>,
    /// What is shown while it runs.
    pub label: String,
}

/// How serving went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Served {
    /// Rays a second: the median over views of each one's median warm render.
    pub rays_per_s: f64,
    /// The most memory held, MiB; `None` where the system does not say.
    pub peak_mib: Option<f64>,
}

impl Work for Serve {
    const NAME: &'static str = "serve";
    type Result = Served;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Served> {
        let field = Field::read_from(&mut open(&self.field)?).with_context(|| self.field.display().to_string())?;
        let mut progress = Progress::new(&self.label, self.cameras.len() as u64);
        let mut rates = Vec::new();
        for camera in &self.cameras {
            progress.at(rates.len() as u64, "");
            let render = || field.render(camera, field.canonical_appearance());
            let seconds = median_within(LAPS.0, LAPS.1, render);
            rates.push((camera.intrinsics.width * camera.intrinsics.height) as f64 / seconds.max(1e-9));
        }
        let rays_per_s = median(&rates).context("there is no view to render")?;
        Ok(Served { rays_per_s, peak_mib: peak_mib() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_is_cut_as_its_picture_is() {
        let mask = [true, false, true, false, false, true];
        assert_eq!(right_half_of(&mask, 3), [false, true, false, true]);
        let picture = Picture::new(3, 2, (0..18).map(|v| v as f32).collect()).unwrap();
        let cut = half(&picture).unwrap();
        assert_eq!((cut.width(), cut.pixel(0, 0)[0]), (2, 3.0));
    }
}
