//! A contact sheet of a judgement: what the figures are about, to be looked at.

use cairn_eval::sheet::{Tile, contact_sheet};
use cairn_mark::{Detector, Distortion, Signal};
use cairn_scene::Picture;

use super::judge::View;
use cairn_service::query::evaluate::{difference, signal_tiles};

/// Most views on a sheet.
const ROWS: usize = 6;
/// How many times the marks' difference is amplified.
const AMPLIFIED: f32 = 20.0;
/// Tiles' width and height, px.
const TILE: [usize; 2] = [176, 176];

/// A row a view: photograph, base, marked, their difference, what is read from it after a JPEG of quality 50, as it
/// is, and what was hidden; sounds and texts as well, where there are any.
///
/// # Errors
/// For pictures that the detector refuses.
pub fn draw(detector: &Detector, signals: &[Signal], views: &[View]) -> anyhow::Result<Picture> {
    let tile = |picture: &Picture, label: String| Tile { picture: picture.clone(), label };
    let mut rows = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(ROWS)) {
        let difference = difference(&view.marked, &view.base, AMPLIFIED);
        let read = detector.detect(&view.marked)?;
        let harmed = detector.detect(&Distortion::Jpeg { quality: 50 }.apply(&view.marked, 0))?;
        let shown = |signal: &Signal| signal.picture.clone().unwrap_or_else(|| Picture::constant(8, 8, [0.0; 3]));
        let truth = view.truth.checked_sub(1).map(|at| signals[at].clone()).unwrap_or_default();
        let classes = (Some(read.identity.unwrap_or(0)), view.truth as u32);
        let mut row = vec![
            tile(&view.photograph, "PHOTOGRAPH".into()),
            tile(&view.base, "BASE".into()),
            tile(&view.marked, "MARKED".into()),
            tile(&difference, format!("DIFFERENCE X {AMPLIFIED}")),
            tile(&shown(&harmed.recovered), format!("JPEG 50: {}", harmed.identity.unwrap_or(0))),
        ];
        row.extend(signal_tiles(&read.recovered, &truth, classes, (TILE[0], TILE[1])));
        rows.push(row);
    }
    Ok(contact_sheet(&rows, TILE[0], TILE[1]))
}
