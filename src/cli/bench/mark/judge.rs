//! Judging as a part: a stored marked field and detector on views that no
//! training saw. Renders are read as files hold them, in 8 bits.

use std::ops::Range;
use std::path::PathBuf;

use cairn_field::Appearance;
use cairn_mark::{Detection, Detector, MarkedField, Recipe, Signal};
use cairn_scene::metrics::{expected_calibration_error, psnr_db, ssim};
use cairn_scene::{Camera, Picture, encode_png};
use serde::{Deserialize, Serialize};

use super::super::field::progress::Progress;
use super::super::field::source::{Opened, Source};
use super::harm::{self, Set};
pub use super::scored::Judged;
use super::scored::{Band, Harmed};
use super::unmarked::Foreign;
use super::{What, laid, permuted, sheet, train, unmarked};
use cairn_service::query::evaluate::{eight_bits, half};
use cairn_service::query::recovery::{SeenView, picture_ssim, recovery};
use cairn_service::query::report::PERFECT_DB;
use cairn_service::query::report::{Recovery, Right};

/// Confidence bins of the calibration.
const BINS: usize = 15;
/// From which confidences on answers are told apart in the ledger.
const BANDS: [f64; 4] = [0.0, 0.5, 0.9, 0.99];

/// What to judge.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
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
    pub signals: Vec<train::Files>,
    /// The settings it was hidden with.
    pub config: Recipe,
    /// By how many identities the clusters' owners were permuted for the training.
    pub permuted: usize,
    /// Whether light is fitted on left halves and right halves are scored.
    pub right_half: bool,
    /// For which suite: an ablation is about renders as they are, and only marks are laid over their field.
    pub what: What,
    /// The folder for renders without a mark, which all trainings are asked about.
    pub unmarked: PathBuf,
    /// The file for a contact sheet.
    pub sheet: PathBuf,
    /// The file for the reliability table.
    pub reliability: PathBuf,
    /// What people are told.
    pub label: String,
}

/// A held-out view.
pub struct View {
    pub camera: Camera,
    pub photograph: Picture,
    pub appearance: Appearance,
    /// The identity of its pose, 0 for none.
    pub truth: usize,
    /// Renders, in 8 bits.
    pub base: Picture,
    pub marked: Picture,
}

/// A detector that is asked, and remembers how sure it was.
pub struct Asked {
    detector: Detector,
    signals: Vec<Signal>,
    /// Confidence of each answer, and whether it was right.
    answers: Vec<(f64, bool)>,
    /// Which of them a closer look gave.
    by_closer_look: Vec<usize>,
}

impl Asked {
    /// Whether `picture`, whose class is `truth`, is told so; and what is recovered of it.
    pub fn ask(&mut self, picture: &Picture, truth: usize) -> anyhow::Result<(bool, Detection)> {
        let found = self.detector.detect(picture)?;
        let class = found.identity.unwrap_or(0) as usize;
        let sure = found.probabilities.get(class).copied().unwrap_or_default();
        if found.is_center_crop {
            self.by_closer_look.push(self.answers.len());
        }
        // Sums of probabilities may miss one by a rounding.
        self.answers.push((f64::from(sure).clamp(0.0, 1.0), class == truth));
        Ok((class == truth, found))
    }

    /// How often answers that a closer look gave are right, but for those at `left_out`.
    fn right_by_closer_look(&self, left_out: &Range<usize>) -> Right {
        let mut right = Right::default();
        let of = self.by_closer_look.iter().filter(|at| !left_out.contains(at));
        of.for_each(|at| right.count(self.answers[*at].1));
        right
    }

    /// SSIM of what was recovered against the picture of identity `truth`, if it hides one.
    fn likeness(&self, truth: usize, found: &Detection) -> anyhow::Result<Option<f64>> {
        Ok(picture_ssim(&self.signals[truth - 1], found)?)
    }
}

/// Judges.
///
/// # Errors
/// For files that do not read, and pictures too small to compare.
pub fn run(task: &Task) -> anyhow::Result<Judged> {
    let marked = MarkedField::from_bytes(&super::read(&task.marked)?)?;
    let detector = Detector::from_bytes(&super::read(&task.detector)?)?;
    let mut asked = Asked {
        detector,
        signals: train::signals(&task.signals, &task.config)?,
        answers: Vec::new(),
        by_closer_look: Vec::new(),
    };
    let opened = task.source.open()?;
    let mut progress = Progress::new(&task.label, 5);
    let views = views(&opened, &marked, task.right_half)?;
    anyhow::ensure!(!views.is_empty(), "{} holds no view out to judge on", task.source.folder.display());
    let (classes, marks, identities) = clean(&mut asked, &views)?;
    crate::cli::files::write(&task.sheet, &encode_png(&sheet::draw(&asked.detector, &asked.signals, &views)?))?;
    progress.at(1, "");
    let before = asked.answers.len();
    let harms = if task.what == What::Ablation { Vec::new() } else { harms(&mut asked, &marked, &views)? };
    let harmed = before..asked.answers.len();
    progress.at(2, "");
    let followed = permuted::follow((&asked.detector, &asked.signals), (&marked, task.permuted), &views)?;
    progress.at(3, "");
    let (unmarked, unmarked_pictures) = match task.what {
        What::Ablation => (Vec::new(), 0),
        _ => {
            let base = (marked.base().as_ref(), task.base.as_path());
            unmarked::ask(&mut asked, (&task.source, base), (&task.foreign, &task.unmarked), &views)?
        }
    };
    progress.at(4, "");
    let foreign: Vec<Source> = task.foreign.iter().map(|other| other.source.clone()).collect();
    let laid = match task.what {
        What::Marks => laid::ask((&marked, &asked.detector), (&opened, &foreign), &views)?,
        _ => None,
    };
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
    crate::cli::files::write(&task.reliability, reliability(&asked.answers).as_bytes())?;
    let by_closer_look = asked.right_by_closer_look(&(0..0));
    let by_closer_look_unharmed = asked.right_by_closer_look(&harmed);
    let unharmed = without(&asked.answers, harmed);
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
        harms,
        followed,
        unmarked,
        unmarked_pictures,
        laid,
        calibration_error: expected_calibration_error(&asked.answers, BINS)?,
        calibration_error_unharmed: expected_calibration_error(&unharmed, BINS)?,
        bands: bands(&asked.answers),
        bands_unharmed: bands(&unharmed),
        answers: asked.answers.len(),
        by_closer_look,
        by_closer_look_unharmed,
    })
}

/// The capture's held-out views, rendered; light is fitted on left halves where `right_half`.
///
/// # Errors
/// For photographs that do not read.
pub(super) fn views(opened: &Opened, marked: &MarkedField, right_half: bool) -> anyhow::Result<Vec<View>> {
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
        identities.push(recovery(&forced, (at as u32 + 1, ""), truth, &seen, size)?);
    }
    Ok((classes, marks, identities))
}

fn harms(asked: &mut Asked, marked: &MarkedField, views: &[View]) -> anyhow::Result<Vec<Harmed>> {
    let mut all = Vec::new();
    for harm in harm::of_pictures() {
        let mut pairs = Vec::new();
        for (seed, list) in harm.tries.iter().enumerate() {
            for view in views {
                // A mark and its twin in noise of their own: they are two files.
                let done = |picture: &Picture, salt: u64| {
                    let seed = |at: usize| 1000 * seed as u64 + 10 * at as u64 + salt;
                    list.iter().enumerate().fold(picture.clone(), |p, (at, d)| d.apply(&p, seed(at)))
                };
                pairs.push((view.truth, done(&view.marked, 0), done(&view.base, 1)));
            }
        }
        all.push(harmed(asked, (harm.name, harm.set), pairs)?);
    }
    for (name, set, field) in harm::of_weights(marked) {
        let pair = |view: &View| {
            let marked = eight_bits(&field.render(&view.camera, &view.appearance))?;
            Ok((view.truth, marked, eight_bits(&field.base().render(&view.camera, &view.appearance))?))
        };
        all.push(harmed(asked, (name, set), views.iter().map(pair).collect::<anyhow::Result<_>>()?)?);
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
        all.push(harmed(asked, ("another view's appearance", Set::Hard), pairs)?);
    }
    Ok(all)
}

/// Asks pairs of marked and base renders, each with its view's identity.
fn harmed(
    asked: &mut Asked,
    (name, set): (&str, Set),
    pairs: Vec<(usize, Picture, Picture)>,
) -> anyhow::Result<Harmed> {
    let (mut classes, mut marks, mut twins, mut hidden) =
        (Right::default(), Right::default(), Right::default(), Vec::new());
    for (truth, marked, base) in pairs {
        let (right, read) = asked.ask(&marked, truth)?;
        let (silent, _) = asked.ask(&base, 0)?;
        classes.count(right);
        classes.count(silent);
        twins.count(silent);
        if truth > 0 {
            marks.count(right);
            hidden.extend(asked.likeness(truth, &read)?);
        }
    }
    Ok(Harmed { name: name.to_owned(), set, classes, marks, twins, ssim: mean(&hidden) })
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
