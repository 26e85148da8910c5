//! How far each view of a scene is to be trusted: what the other views say of it, what structure from motion says,
//! and what was decided.

use cairn_scene::{Picture, SceneFolder, Support};

use crate::error::EngineError;
use crate::export::sheet::{Tile, contact_sheet};
use crate::query::evaluate::eight_bits;
use crate::store::exclusions::{Entries, Entry, Measured, Score};
use crate::store::model::Model;
use crate::store::support::{supports, unsupported};

/// Most rows of a picture.
const PICTURE_ROWS: usize = 8;
/// Largest side of a tile, px.
const TILE_PX: usize = 256;

/// What is known of a scene's views.
pub struct Checked {
    /// All of them, the most suspicious first; those without a score last, by name.
    pub views: Vec<CheckedView>,
    /// The last screening; `None` for scenes with too few views for one.
    pub measured: Option<Measured>,
    /// The most suspicious photographs beside their renders.
    pub picture: Option<Picture>,
}

/// What is known of a view.
pub struct CheckedView {
    /// Its index in the capture.
    pub index: usize,
    /// What the screening measured.
    pub score: Option<Score>,
    /// What structure from motion says of it.
    pub support: Option<Support>,
    /// What structure from motion says against it.
    pub against: Option<String>,
    /// What was decided about it.
    pub decision: Option<Entry>,
}

/// The views of `scene`, the most suspicious first.
pub fn views(scene: &SceneFolder, entries: &Entries) -> Vec<CheckedView> {
    let scores = entries.measured.iter().flat_map(|measured| &measured.scores);
    let supports = supports(scene.capture());
    let unsupported = unsupported(&supports);
    let of = |index: usize| {
        let name = &scene.capture().views[index].name;
        CheckedView {
            index,
            support: supports[index],
            score: scores.clone().find(|s| s.view == *name).cloned(),
            against: unsupported[index].clone(),
            decision: entries.views.iter().find(|e| e.view == *name).cloned(),
        }
    };
    let mut views: Vec<CheckedView> = (0..supports.len()).map(of).collect();
    // Stable: what has no score stays in the order of names.
    let score = |view: &CheckedView| view.score.as_ref().map_or(f64::NEG_INFINITY, |s| s.score);
    views.sort_by(|a, b| score(b).total_cmp(&score(a)));
    views
}

/// The first photographs of `views` that were taken for training beside the field's renders from the same cameras.
///
/// # Errors
/// cairn-scene's, for a photograph that was altered.
pub fn picture(scene: &SceneFolder, model: &Model, views: &[CheckedView]) -> Result<Picture, EngineError> {
    let mut rows = Vec::new();
    for view in views.iter().filter(|v| v.score.is_some()).take(PICTURE_ROWS) {
        let known = &scene.capture().views[view.index];
        let photograph = scene.photograph(view.index)?;
        let appearance = model.base.appearance_of(&known.name);
        let render = eight_bits(&model.base.render(&known.camera, appearance))?;
        let score = view.score.as_ref().map_or(0.0, |s| s.score);
        rows.push(vec![
            Tile { picture: photograph, label: format!("{} ({score:.1} sigmas)", known.name) },
            Tile { picture: render, label: format!("render, {}", known.contributor) },
        ]);
    }
    let (width, height) = rows.first().map_or((TILE_PX, TILE_PX), |row| {
        let picture = &row[0].picture;
        (picture.width().clamp(96, TILE_PX), picture.height().clamp(96, TILE_PX))
    });
    Ok(contact_sheet(&rows, width, height))
}
