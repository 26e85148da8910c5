//! Scoring as a part: renders of held-out views against their photographs.

use std::path::PathBuf;

use cairn_eval::sheet::{Tile, contact_sheet};
use cairn_field::Field;
use cairn_scene::metrics::{psnr_db, psnr_db_masked, ssim};
use cairn_scene::{Picture, encode_png};
use serde::{Deserialize, Serialize};

use super::progress::Progress;
use super::source::Source;
use cairn_service::query::evaluate::{OFF, difference, eight_bits, half};
use cairn_service::query::report::PERFECT_DB;

/// Most views on a sheet.
const SHEET_ROWS: usize = 6;
/// Its tiles' width and height, px.
const TILE: [usize; 2] = [256, 256];

/// What to score, and how.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The capture.
    pub source: Source,
    /// The stored field.
    pub field: PathBuf,
    /// Whether appearance is fitted to each photograph's left half and its right
    /// half scored; else whole pictures are, in the field's own appearance.
    pub right_half: bool,
    /// The file for a contact sheet.
    pub sheet: PathBuf,
    /// What people are told.
    pub label: String,
}

/// Means over the views, of renders rounded to 8 bits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scored {
    /// Views scored.
    pub views: usize,
    /// Whether right halves were, by the half-image protocol.
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

/// Renders and compares.
///
/// # Errors
/// For a field or photograph that does not read, and pictures too small to compare.
pub fn run(task: &Task) -> anyhow::Result<Scored> {
    let field = Field::from_bytes(&super::read(&task.field)?)?;
    let opened = task.source.open()?;
    let held_out = opened.held_out();
    let mut progress = Progress::new(&task.label, held_out.len() as u64);
    let (mut psnr, mut similarity, mut masked) = (Vec::new(), Vec::new(), Vec::new());
    let (mut has_masks, mut sheet) = (false, Vec::new());
    for (done, index) in held_out.iter().enumerate() {
        progress.at(done as u64, "");
        let view = opened.view(*index)?;
        let appearance = if task.right_half {
            field.fit_appearance_left_half(&view.camera, &view.picture)?
        } else {
            field.canonical_appearance().clone()
        };
        let render = eight_bits(&field.render(&view.camera, &appearance))?;
        if done.is_multiple_of(held_out.len().div_ceil(SHEET_ROWS)) {
            sheet.push(row(&view.picture, &render));
        }
        let cut = |picture: &Picture| if task.right_half { half(picture) } else { Ok(picture.clone()) };
        let (photograph, part) = (cut(&view.picture)?, cut(&render)?);
        psnr.push(psnr_db(&photograph, &part)?.min(PERFECT_DB));
        similarity.push(ssim(&photograph, &part)?);
        let Some(mask) = opened.mask(*index)? else { continue };
        has_masks = true;
        let mask = if task.right_half { right_half_of(&mask, render.width()) } else { mask };
        if mask.contains(&true) {
            masked.push(psnr_db_masked(&photograph, &part, &mask)?.min(PERFECT_DB));
        }
    }
    drop(progress);
    anyhow::ensure!(!psnr.is_empty(), "{} holds no view out to score on", task.source.folder.display());
    anyhow::ensure!(!has_masks || !masked.is_empty(), "no mask has a pixel in the part that is scored; look at masks");
    crate::cli::files::write(&task.sheet, &encode_png(&contact_sheet(&sheet, TILE[0], TILE[1])))?;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    Ok(Scored {
        views: psnr.len(),
        right_half: task.right_half,
        psnr_db: mean(&psnr),
        ssim: mean(&similarity),
        mask: has_masks.then(|| Masked { psnr_db: mean(&masked), views: masked.len() }),
    })
}

/// A view's row on the sheet: the photograph, its render and what that shows otherwise.
fn row(photograph: &Picture, render: &Picture) -> Vec<Tile> {
    let off = difference(render, photograph, OFF);
    [("PHOTOGRAPH", photograph), ("RENDER", render), ("DIFFERENCE X 4", &off)]
        .map(|(label, picture)| Tile { picture: picture.clone(), label: label.to_owned() })
        .to_vec()
}

/// The columns from the middle on, as [`half`] cuts a picture.
fn right_half_of(mask: &[bool], width: usize) -> Vec<bool> {
    mask.chunks_exact(width).flat_map(|row| row[width / 2..].iter().copied()).collect()
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
