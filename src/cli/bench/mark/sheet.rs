//! A contact sheet of a judgement: what the figures are about, to be looked at.

use cairn_bench::sheet::{Tile, contact_sheet};
use cairn_capture::Picture;
use cairn_stega::{Detector, Distortion, Signal};

use super::judge::View;

/// Most views on a sheet.
const ROWS: usize = 6;
/// How many times the marks' difference is amplified.
const AMPLIFIED: f32 = 20.0;
/// Tiles' width and height, px.
const TILE: [usize; 2] = [176, 176];

/// A row a view: photograph, base, marked, their difference, what is read from it
/// as it is and after a JPEG of quality 50, and what was hidden.
///
/// # Errors
/// For pictures that the detector refuses.
pub fn draw(detector: &Detector, signals: &[Signal], views: &[View]) -> anyhow::Result<Picture> {
    let tile = |picture: &Picture, label: String| Tile { picture: picture.clone(), label };
    let mut rows = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(ROWS)) {
        let mut difference = view.marked.clone();
        for (d, b) in difference.rgb_mut().iter_mut().zip(view.base.rgb()) {
            *d = (0.5 + AMPLIFIED * (*d - b)).clamp(0.0, 1.0);
        }
        let read = detector.detect(&view.marked)?;
        let harmed = detector.detect(&Distortion::Jpeg { quality: 50 }.apply(&view.marked, 0))?;
        let shown = |signal: Option<&Signal>| {
            signal.and_then(|s| s.picture.clone()).unwrap_or_else(|| Picture::constant(8, 8, [0.0; 3]))
        };
        let truth = shown(view.truth.checked_sub(1).map(|at| &signals[at]));
        rows.push(vec![
            tile(&view.photograph, "PHOTOGRAPH".into()),
            tile(&view.base, "BASE".into()),
            tile(&view.marked, "MARKED".into()),
            tile(&difference, format!("DIFFERENCE X {AMPLIFIED}")),
            tile(&shown(Some(&read.recovered)), format!("READ: {}", read.identity.unwrap_or(0))),
            tile(&shown(Some(&harmed.recovered)), format!("JPEG 50: {}", harmed.identity.unwrap_or(0))),
            tile(&truth, format!("TRUE: {}", view.truth)),
        ]);
    }
    Ok(contact_sheet(&rows, TILE[0], TILE[1]))
}
