//! Judging as work: a stored marked field and detector on views that no
//! training saw. Renders are read as files hold them, in 8 bits.

use std::ops::Range;
use std::path::PathBuf;

use cairn_mark::{Detector, Distortion, MarkedField, Recipe, Signal};
use cairn_scene::metrics::{psnr_db, ssim};
use cairn_scene::{Picture, encode_png};
use cairn_service::export::sheet::{Tile, contact_sheet};
use cairn_service::query::evaluate::{difference, eight_bits, half, signal_tiles};
use cairn_service::query::recovery::{SeenView, recovery};
use cairn_service::query::report::PERFECT_DB;
use cairn_service::query::report::{Recovery, Right};
use serde::{Deserialize, Serialize};

use super::attack::{self, Set};
use super::judged::{Asked, Attacked, Band, Judged, View};
use super::unmarked::{Base, Foreign};
use super::{exchange, registered, unmarked};
use crate::children::Work;
use crate::file::{read, write};
use crate::marked::{Files, signals};
use crate::measures::expected_calibration_error;
use crate::progress::Progress;
use crate::source::{Opened, Source};

/// Most views on a sheet.
const SHEET_ROWS: usize = 6;
/// How many times the marks' difference is amplified on a sheet.
const AMPLIFIED: f32 = 20.0;
/// A sheet's tiles: width and height, px.
const TILE: [usize; 2] = [176, 176];
/// Confidence bins of the calibration.
const BINS: usize = 15;
/// From which confidences on answers are counted apart.
const BANDS: [f64; 4] = [0.0, 0.5, 0.9, 0.99];

/// What to judge.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Judge {
    /// The capture.
    pub source: Source,
    /// Other captures.
    pub foreign: Vec<Foreign>,
    /// The stored base field.
    pub base: PathBuf,
    /// The stored marked field.
    pub marked: PathBuf,
    /// The stored detector.
    pub detector: PathBuf,
    /// Files of what was hidden.
    pub signals: Vec<Files>,
    /// The settings it was hidden with.
    pub config: Recipe,
    /// Whether light is fitted on left halves and right halves are scored.
    pub right_half: bool,
    /// Whether attacks, pictures without a mark and registration are judged, too; an ablation is about renders as they are.
    pub thorough: bool,
    /// The folder for renders without a mark, which all trainings are asked about.
    pub unmarked: PathBuf,
    /// The file for a contact sheet.
    pub sheet: PathBuf,
    /// The file for the reliability table.
    pub reliability: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

impl Work for Judge {
    const NAME: &'static str = "judge";
    type Result = Judged;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Judged> {
        judge(self)
    }
}

fn judge(task: &Judge) -> anyhow::Result<Judged> {
    let marked = MarkedField::from_bytes(&read(&task.marked)?)?;
    let detector = Detector::from_bytes(&read(&task.detector)?)?;
    let mut asked = Asked {
        detector,
        signals: signals(&task.signals, &task.config)?,
        answers: Vec::new(),
        by_center_crop: Vec::new(),
    };
    let opened = task.source.open()?;
    let mut progress = Progress::new(&task.label, 5);
    let views = views(&opened, &marked, task.right_half)?;
    anyhow::ensure!(!views.is_empty(), "{} holds no view out to judge on", task.source.folder.display());
    let (classes, marks, identities) = clean(&mut asked, &views)?;
    write(&task.sheet, &encode_png(&draw(&asked.detector, &asked.signals, &views)?))?;
    progress.at(1, "");
    let before = asked.answers.len();
    let attacks = if task.thorough { attacks(&mut asked, &marked, &views)? } else { Vec::new() };
    let attacked = before..asked.answers.len();
    progress.at(2, "");
    let followed = exchange::follow(&asked.detector, &asked.signals, &marked, &views)?;
    progress.at(3, "");
    let (mut unmarked, mut unmarked_pictures, mut registered) = (Vec::new(), 0, None);
    if task.thorough {
        let base = Base { field: marked.base(), file: &task.base };
        (unmarked, unmarked_pictures) =
            unmarked::ask(&mut asked, &task.source, base, &task.foreign, &task.unmarked, &views)?;
        progress.at(4, "");
        let foreign: Vec<Source> = task.foreign.iter().map(|other| other.source.clone()).collect();
        registered = registered::ask(&marked, &asked.detector, &opened, &foreign, &views)?;
    }
    drop(progress);
    let part = |picture: &Picture| if task.right_half { half(picture) } else { Ok(picture.clone()) };
    let (mut sums, mut changes) = ([0.0; 4], Vec::new());
    for view in &views {
        let (photograph, base, marked) = (part(&view.photograph)?, part(&view.base)?, part(&view.marked)?);
        let of = [psnr_db(&photograph, &base)?, psnr_db(&photograph, &marked)?].map(|db| db.min(PERFECT_DB));
        sums[0] += of[0];
        sums[1] += of[1];
        if view.truth > 0 {
            changes.push(of[1] - of[0]);
        }
        sums[2] += ssim(&photograph, &base)?;
        sums[3] += ssim(&photograph, &marked)?;
    }
    let kept = views.iter().filter(|v| v.truth > 0).map(|v| Ok(psnr_db(&v.base, &v.marked)?.min(PERFECT_DB)));
    let kept = kept.collect::<anyhow::Result<Vec<f64>>>()?;
    let [base_psnr_db, marked_psnr_db, base_ssim, marked_ssim] = sums.map(|sum| sum / views.len() as f64);
    write(&task.reliability, reliability(&asked.answers).as_bytes())?;
    let by_center_crop = asked.right_by_center_crop(&(0..0));
    let by_center_crop_unattacked = asked.right_by_center_crop(&attacked);
    let unattacked = without(&asked.answers, attacked);
    Ok(Judged {
        views: views.len(),
        marked_views: kept.len(),
        base_psnr_db,
        marked_psnr_db,
        base_ssim,
        marked_ssim,
        kept_db: mean(&kept).unwrap_or(PERFECT_DB),
        marked_change_db: mean(&changes),
        classes,
        marks,
        identities,
        attacks,
        followed,
        unmarked,
        unmarked_pictures,
        registered,
        calibration_error: expected_calibration_error(&asked.answers, BINS)?,
        calibration_error_unattacked: expected_calibration_error(&unattacked, BINS)?,
        bands: bands(&asked.answers),
        bands_unattacked: bands(&unattacked),
        answers: asked.answers.len(),
        by_center_crop,
        by_center_crop_unattacked,
    })
}

/// The capture's held-out views, rendered; light is fitted on left halves where `right_half`.
///
/// # Errors
/// For photographs that do not read.
pub fn views(opened: &Opened, marked: &MarkedField, right_half: bool) -> anyhow::Result<Vec<View>> {
    let base = marked.base();
    let view = |index: usize| {
        let view = opened.view(index)?;
        let appearance = match right_half {
            true => base.fit_appearance_left_half(&view.camera, &view.picture)?,
            false => base.canonical_appearance().clone(),
        };
        let identity = marked.clusters().identity_of(&view.camera.pose).identity;
        Ok(View {
            base: eight_bits(&base.render(&view.camera, &appearance))?,
            marked: eight_bits(&marked.render(&view.camera, &appearance))?,
            camera: view.camera,
            photograph: view.picture.clone(),
            appearance,
            truth: identity.unwrap_or(0) as usize,
        })
    };
    opened.held_out().into_iter().map(view).collect()
}

/// Classes of renders as they are, and each identity's signal.
fn clean(asked: &mut Asked, views: &[View]) -> anyhow::Result<(Right, Right, Vec<Recovery>)> {
    let (mut classes, mut marks) = (Right::default(), Right::default());
    let mut read = Vec::new();
    for view in views {
        let (right, found) = asked.ask(&view.marked, view.truth)?;
        classes.count(right);
        if view.truth > 0 {
            marks.count(right);
        }
        classes.count(asked.ask(&view.base, 0)?.0);
        read.push(found);
    }
    let size = (views[0].base.width(), views[0].base.height());
    let mut identities = Vec::new();
    for (at, truth) in asked.signals.iter().enumerate() {
        let of = views.iter().zip(&read).filter(|(view, _)| view.truth == at + 1);
        let seen: Vec<_> = of.map(|(view, found)| SeenView { base: &view.base, found }).collect();
        let forced = |picture: &Picture| Ok(asked.detector.detect_forced(picture, at + 1)?);
        identities.push(recovery(&forced, at as u32 + 1, "", truth, &seen, size.into())?);
    }
    Ok((classes, marks, identities))
}

fn attacks(asked: &mut Asked, marked: &MarkedField, views: &[View]) -> anyhow::Result<Vec<Attacked>> {
    let mut all = Vec::new();
    for attack in attack::of_pictures() {
        let mut pairs = Vec::new();
        for (seed, list) in attack.tries.iter().enumerate() {
            for view in views {
                // A marked render and its unmarked pair in noise of their own: they are two files.
                let done = |picture: &Picture, salt: u64| {
                    let seed = |at: usize| 1000 * seed as u64 + 10 * at as u64 + salt;
                    list.iter().enumerate().fold(picture.clone(), |p, (at, d)| d.apply(&p, seed(at)))
                };
                pairs.push((view.truth, done(&view.marked, 0), done(&view.base, 1)));
            }
        }
        all.push(attacked(asked, attack.name, attack.set, pairs)?);
    }
    for (name, set, field) in attack::of_weights(marked) {
        let pair = |view: &View| {
            let marked = eight_bits(&field.render(&view.camera, &view.appearance))?;
            Ok((view.truth, marked, eight_bits(&field.base().render(&view.camera, &view.appearance))?))
        };
        all.push(attacked(asked, name, set, views.iter().map(pair).collect::<anyhow::Result<_>>()?)?);
    }
    let lights = marked.base().appearances();
    if !lights.is_empty() {
        let pair = |(at, view): (usize, &View)| {
            // Far from the view in the list, and another for each.
            let light = &lights[(at * 7 + lights.len() / 2) % lights.len()].1;
            let marked_there = eight_bits(&marked.render(&view.camera, light))?;
            Ok((view.truth, marked_there, eight_bits(&marked.base().render(&view.camera, light))?))
        };
        let pairs = views.iter().enumerate().map(pair).collect::<anyhow::Result<_>>()?;
        all.push(attacked(asked, "another view's appearance", Set::Hard, pairs)?);
    }
    Ok(all)
}

/// Asks pairs of marked and base renders, each with its view's identity.
fn attacked(
    asked: &mut Asked,
    name: &str,
    set: Set,
    pairs: Vec<(usize, Picture, Picture)>,
) -> anyhow::Result<Attacked> {
    let (mut classes, mut marks, mut unmarked_pairs, mut hidden) =
        (Right::default(), Right::default(), Right::default(), Vec::new());
    for (truth, marked, base) in pairs {
        let (right, read) = asked.ask(&marked, truth)?;
        let (silent, _) = asked.ask(&base, 0)?;
        classes.count(right);
        classes.count(silent);
        unmarked_pairs.count(silent);
        if truth > 0 {
            marks.count(right);
            hidden.extend(asked.likeness(truth, &read)?);
        }
    }
    Ok(Attacked { name: name.to_owned(), set, classes, marks, unmarked_pairs, ssim: mean(&hidden) })
}

/// A row a view: photograph, base, marked, their difference, what is read from it after a JPEG of quality 50, as it
/// is, and what was hidden; sounds and texts as well, where there are any.
fn draw(detector: &Detector, signals: &[Signal], views: &[View]) -> anyhow::Result<Picture> {
    let tile = |picture: &Picture, label: String| Tile { picture: picture.clone(), label };
    let mut rows = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(SHEET_ROWS)) {
        let difference = difference(&view.marked, &view.base, AMPLIFIED);
        let read = detector.detect(&view.marked)?;
        let attacked = detector.detect(&Distortion::Jpeg { quality: 50 }.apply(&view.marked, 0))?;
        let shown = |signal: &Signal| signal.picture.clone().unwrap_or_else(|| Picture::constant(8, 8, [0.0; 3]));
        let truth = view.truth.checked_sub(1).map(|at| signals[at].clone()).unwrap_or_default();
        let read_class = Some(read.identity.unwrap_or(0));
        let mut row = vec![
            tile(&view.photograph, "Photograph".into()),
            tile(&view.base, "Base".into()),
            tile(&view.marked, "Marked".into()),
            tile(&difference, format!("Difference x {AMPLIFIED}")),
            tile(&shown(&attacked.recovered), format!("JPEG 50: {}", attacked.identity.unwrap_or(0))),
        ];
        row.extend(signal_tiles(&read.recovered, &truth, read_class, view.truth as u32, [TILE[0], TILE[1]]));
        rows.push(row);
    }
    Ok(contact_sheet(&rows, TILE[0], TILE[1]))
}

/// All but those at `left_out`.
fn without<T: Clone>(all: &[T], left_out: Range<usize>) -> Vec<T> {
    [&all[..left_out.start], &all[left_out.end..]].concat()
}

/// How often answers are right, by how sure they are.
fn bands(answers: &[(f64, bool)]) -> Vec<Band> {
    let band = |at: usize| {
        let (from, to) = (BANDS[at], BANDS.get(at + 1).copied().unwrap_or(f64::INFINITY));
        let mut right = Right::default();
        answers.iter().filter(|(sure, _)| (from..to).contains(sure)).for_each(|(_, is_right)| right.count(*is_right));
        Band { from, right }
    };
    (0..BANDS.len()).map(band).collect()
}

/// A row for each bin of confidence that has answers: how sure, how often right, how many.
fn reliability(answers: &[(f64, bool)]) -> String {
    let mut table = "from,to,confidence,accuracy,answers\n".to_owned();
    for bin in 0..BINS {
        let (from, to) = (bin as f64 / BINS as f64, (bin + 1) as f64 / BINS as f64);
        let of: Vec<_> = answers.iter().filter(|(sure, _)| *sure > from && *sure <= to).collect();
        if !of.is_empty() {
            let n = of.len() as f64;
            let sure = of.iter().map(|(sure, _)| sure).sum::<f64>() / n;
            let right = of.iter().filter(|(_, right)| *right).count() as f64 / n;
            table += &format!("{from:.4},{to:.4},{sure:.4},{right:.4},{}\n", of.len());
        }
    }
    table
}

/// `None` of nothing.
fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reliability_table_has_every_answer_once() {
        let answers: Vec<(f64, bool)> = (1..=30).map(|i| (f64::from(i) / 30.0, i % 3 != 0)).collect();
        let table = reliability(&answers);
        let counts = table.lines().skip(1).map(|line| line.rsplit(',').next().unwrap().parse::<usize>().unwrap());
        assert_eq!(counts.sum::<usize>(), 30);
        assert!(table.contains("0.9333,1.0000,0.9833,0.5000,2"), "{table}");
        assert_eq!(without(&answers, 3..29).len(), 4);
        assert_eq!(without(&answers, 0..29), answers[29..]);
    }

    #[test]
    fn every_answer_is_in_one_band_of_confidence() {
        let answers = [(0.2, false), (0.5, true), (0.89, false), (0.9, true), (0.99, true), (1.0, true), (1.0, false)];
        let right: Vec<_> =
            bands(&answers).iter().map(|band| (band.from, band.right.right, band.right.asked)).collect();
        assert_eq!(right, [(0.0, 0, 1), (0.5, 1, 2), (0.9, 1, 1), (0.99, 2, 3)]);
    }
}
