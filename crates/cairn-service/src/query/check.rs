//! How far each view of a scene is to be trusted: what the other views say of it, what structure from motion says,
//! and what was decided.

use std::sync::Arc;

use cairn_register::{NotLocated, Registrar};
use cairn_scene::{Picture, SceneFolder, Support};

use crate::error::EngineError;
use crate::export::sheet::{Tile, contact_sheet};
use crate::query::evaluate::eight_bits;
use crate::store::exclusions::{Entries, Entry, Measured, Score};
use crate::store::model::Model;
use crate::store::support::{supports, unsupported};

/// So many of the most suspicious photographs are looked at, at most: drawn, and looked for.
const LOOKED_AT: usize = 8;
/// Largest side of a tile, px.
const TILE_PX: usize = 256;

/// What is looked at beside what was measured; both ask for a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Looks {
    /// The most suspicious photographs beside their renders, as a picture.
    pub picture: bool,
    /// Where they are found among the other photographs' places: seconds a photograph.
    pub places: bool,
}

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
    /// Where the other photographs' places have it, where that was asked for.
    pub found: Option<Whereabouts>,
}

/// Where a photograph was taken by the places that the others tell.
pub enum Whereabouts {
    /// A camera was found.
    Found {
        /// How far off the view's own camera has what the photograph shows, the median over places, px of the photograph;
        /// infinite where most of it lies behind that camera.
        off_px: f64,
        /// The found camera's standard deviation, as far; infinite where nothing tells.
        uncertainty_px: f64,
    },
    /// None was, and why.
    NotFound(NotLocated),
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
            found: None,
        }
    };
    let mut views: Vec<CheckedView> = (0..supports.len()).map(of).collect();
    // Stable: what has no score stays in the order of names.
    let score = |view: &CheckedView| view.score.as_ref().map_or(f64::NEG_INFINITY, |s| s.score);
    views.sort_by(|a, b| score(b).total_cmp(&score(a)));
    views
}

/// Looks for the first photographs of `views` that were judged among the places that the others tell. A photograph with
/// a wrong camera is found elsewhere, unless others that are as wrong show the same.
///
/// # Errors
/// As [`Model::places`], and cairn-scene's for a photograph that was altered.
pub fn look_for(
    scene: &SceneFolder,
    model: &Model,
    views: &mut [CheckedView],
    wanted: &dyn Fn() -> bool,
) -> Result<(), EngineError> {
    let index = model.places()?;
    for view in views.iter_mut().filter(|v| v.score.is_some()).take(LOOKED_AT) {
        if !wanted() {
            break;
        }
        let known = &scene.capture().views[view.index];
        let photograph = scene.photograph(view.index)?;
        let registrar = Registrar::new(model.base.clone(), Some(Arc::new(index.without(&known.name))));
        view.found = Some(match registrar.locate(&photograph, wanted) {
            Ok(found) => {
                let larger = photograph.width() as f64 / found.registered.picture.width() as f64;
                let [off_px, uncertainty_px] =
                    [found.off_px(&known.camera), found.uncertainty_px].map(|px| larger * px);
                Whereabouts::Found { off_px, uncertainty_px }
            }
            Err(why) => Whereabouts::NotFound(why),
        });
    }
    Ok(())
}

/// The first photographs of `views` that were taken for training beside the field's renders from the same cameras.
///
/// # Errors
/// cairn-scene's, for a photograph that was altered.
pub fn picture(scene: &SceneFolder, model: &Model, views: &[CheckedView]) -> Result<Picture, EngineError> {
    let mut rows = Vec::new();
    for view in views.iter().filter(|v| v.score.is_some()).take(LOOKED_AT) {
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
