//! Looking for the cameras of pictures of one capture, and of pictures of others, as work of a process of its own.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use cairn_field::Field;
use cairn_register::{Index, Located, Reference, Registrar};
use cairn_scene::encode_png;
use cairn_scene::metrics::psnr_db;
use cairn_service::export::sheet::{Tile, contact_sheet};
use cairn_service::query::evaluate::difference;
use cairn_service::query::report::PERFECT_DB;
use serde::{Deserialize, Serialize};

use super::condition::{CONDITIONS, Condition};
use super::place::{Case, Place};
use super::strangers::Strangers;
use super::trial::{Fix, Outcome, Trial, off_px};
use crate::children::Work;
use crate::file::{read, write};
use crate::progress::Progress;
use crate::source::{Opened, SizedView, Source};

/// How many times differences are shown on the sheet.
const TIMES: f32 = 5.0;
/// Its tiles' width and height, px.
const TILE: [usize; 2] = [300, 300];

/// The work.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Register {
    /// The capture.
    pub source: Source,
    /// Its stored field.
    pub field: PathBuf,
    /// Places at most: held-out views, evenly taken.
    pub max_places: usize,
    /// Captures of other scenes.
    pub strangers: Vec<Source>,
    /// How many of their pictures are looked for, at most.
    pub max_strangers: usize,
    /// How long these are at most, px.
    pub longest_side_px: usize,
    /// The seed of noise and of other lights.
    pub seed: u64,
    /// The file for a contact sheet of placements.
    pub sheet: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

/// What came of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Found {
    /// Places that pictures were made of.
    pub places: usize,
    /// Keypoints of the index.
    pub points: usize,
    /// Seconds that preparing the index took.
    pub index_seconds: f64,
    /// The tries, by place and condition.
    pub trials: Vec<Trial>,
    /// Pictures of other scenes that were looked for.
    pub strangers: usize,
    /// Those of them for which a camera was found, by name.
    pub strangers_located: Vec<String>,
}

impl Work for Register {
    const NAME: &'static str = "register";
    type Result = Found;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Found> {
        let field = Arc::new(Field::from_bytes(&read(&self.field)?)?);
        let opened = self.source.open()?;
        let strangers = Strangers::open(&self.strangers, self.longest_side_px, self.max_strangers)?;
        let held_out = some(&opened.held_out(), self.max_places);
        anyhow::ensure!(!held_out.is_empty(), "{} holds no view out to look for", self.source.folder.display());
        let (index, index_seconds) = self.index(&field, &opened)?;
        let points = index.points();
        let registrar = Registrar::new(field.clone(), Some(Arc::new(index)));
        let run = Run { field: &field, registrar: &registrar, seed: self.seed, places: held_out.len() };
        let mut sheet: [Option<Vec<Tile>>; CONDITIONS.len()] = [const { None }; CONDITIONS.len()];
        let mut trials = Vec::new();
        let mut progress = Progress::new(&self.label, (held_out.len() * CONDITIONS.len() + strangers.len()) as u64);
        for (number, view) in held_out.iter().enumerate() {
            let place = Place::new(&field, opened.view(*view)?, self.seed.wrapping_add(number as u64))?;
            for condition in 0..CONDITIONS.len() {
                progress.at((number * CONDITIONS.len() + condition) as u64, "");
                trials.extend(run.trial(&place, number, condition, &mut sheet[condition])?);
            }
        }
        let mut strangers_located = Vec::new();
        for at in 0..strangers.len() {
            progress.at((held_out.len() * CONDITIONS.len() + at) as u64, "other scenes, ");
            let (name, picture) = strangers.picture(at)?;
            if registrar.locate(&picture, &|| true).is_ok() {
                strangers_located.push(name);
            }
        }
        drop(progress);
        let rows: Vec<Vec<Tile>> = sheet.into_iter().flatten().collect();
        write(&self.sheet, &encode_png(&contact_sheet(&rows, TILE[0], TILE[1])))?;
        let places = held_out.len();
        Ok(Found { places, points, index_seconds, trials, strangers: strangers.len(), strangers_located })
    }
}

impl Register {
    /// The index of the training views, and the seconds that it took; decoding photographs is not in them.
    fn index(&self, field: &Field, opened: &Opened) -> anyhow::Result<(Index, f64)> {
        let views = opened.training().into_iter().map(|view| opened.view(view)).collect::<anyhow::Result<Vec<_>>>()?;
        fn reference(view: &SizedView) -> Reference<'_> {
            let photograph = Box::new(|| Some(view.picture.clone()));
            Reference { camera: view.camera, name: &view.name, photograph }
        }
        let references: Vec<Reference<'_>> = views.iter().map(reference).collect();
        let mut progress = Progress::new(&format!("{}, index of places", self.label), references.len() as u64);
        let begun = Instant::now();
        let index = Index::build(field, &references, &mut |done, total| {
            progress.of(done as u64, total as u64);
            true
        });
        let seconds = begun.elapsed().as_secs_f64();
        let index = index.with_context(|| format!("{} has no view to train on", self.source.folder.display()))?;
        Ok((index, seconds))
    }
}

/// What tries have in common.
struct Run<'a> {
    field: &'a Field,
    registrar: &'a Registrar,
    seed: u64,
    places: usize,
}

impl Run<'_> {
    /// A try; `None` where a place has no such picture. `shown` is a row of the sheet: each condition shows a place of its
    /// own, or the first that was found where that one was not.
    fn trial(
        &self,
        place: &Place,
        number: usize,
        condition: usize,
        shown: &mut Option<Vec<Tile>>,
    ) -> anyhow::Result<Option<Trial>> {
        let how = &CONDITIONS[condition];
        let seed = self.seed.wrapping_add((number * CONDITIONS.len() + condition) as u64);
        let Some(case) = place.case(self.field, how, seed) else { return Ok(None) };
        let begun = Instant::now();
        let located = self.registrar.locate(&case.picture, &|| true);
        let seconds = begun.elapsed().as_secs_f64();
        let outcome = match located {
            Ok(located) => {
                let fix = self.fix(&case, &located, place)?;
                if how.on_sheet && (shown.is_none() || number == condition % self.places) {
                    *shown = Some(self.row(how, place, &located, &fix));
                }
                Outcome::Located(fix)
            }
            Err(reason) => Outcome::NotLocated(reason.to_string()),
        };
        Ok(Some(Trial { condition, place: number, view: place.name().to_owned(), seconds, outcome }))
    }

    fn fix(&self, case: &Case<'_>, located: &Located, place: &Place) -> anyhow::Result<Fix> {
        let truth = &case.truth;
        let (width, height) = (truth.intrinsics.width, truth.intrinsics.height);
        let found = located.registered.camera.resized(width, height);
        let render = |camera| self.field.render(camera, case.light).clamped();
        let uncertainty = located.uncertainty_px * width as f64 / located.registered.picture.width() as f64;
        Ok(Fix {
            off_px: off_px(&found, truth, &place.points),
            longest_px: width.max(height),
            psnr_db: psnr_db(&render(&found), &render(truth))?.min(PERFECT_DB),
            uncertainty_px: Some(uncertainty).filter(|uncertainty| uncertainty.is_finite()),
            explained: located.registered.explained,
            surprise: located.surprise,
        })
    }

    /// A row of the sheet: the picture, what the field shows from where it was found, and how they differ.
    fn row(&self, how: &Condition, place: &Place, located: &Located, fix: &Fix) -> Vec<Tile> {
        let found = &located.registered;
        let render = self.field.render(&found.camera, &found.appearance).clamped();
        let off = difference(&render, &found.picture, TIMES);
        let of = format!("{}: {}", how.name, place.name());
        let at = format!("Found {:.2} px off, {:.1} dB", fix.off_px, fix.psnr_db);
        [(of, found.picture.clone()), (at, render), (format!("Difference x {TIMES}"), off)]
            .map(|(label, picture)| Tile { picture, label })
            .to_vec()
    }
}

/// At most `max` of some views, evenly taken.
fn some(views: &[usize], max: usize) -> Vec<usize> {
    let count = views.len().min(max);
    (0..count).map(|k| views[k * views.len() / count]).collect()
}
