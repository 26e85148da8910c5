//! Scoring a trained scene on the views that no training saw: how well the
//! pictures survive the mark, whether the classifier is right, and whether what is
//! recovered came out of the picture or out of the detector's memory.
//!
//! Renders are read as their users have them: rounded to 8 bits.

use std::collections::BTreeSet;

use crate::export::sheet::{Tile, contact_sheet, paper};
use crate::export::sound::sounds;
use cairn_mark::Signal;
use cairn_scene::cluster::Grouping;
use cairn_scene::metrics::{psnr_db, ssim};
use cairn_scene::{Camera, Capture, Picture, SceneFolder, Sound};

use crate::error::EngineError;
use crate::query::recovery::{SeenView, recovery};
use crate::query::report::{self, MarkReport, PERFECT_DB, PictureScore, Report, Right};
use crate::store::classes::Found;
use crate::store::model::{Mark, Model};
use crate::store::snapshot::SceneSnapshot;
use cairn_field::Appearance;

/// Most rows of a contact sheet.
const SHEET_ROWS: usize = 8;
/// How many times what a field shows otherwise than photographs is amplified on sheets.
pub const OFF: f32 = 4.0;

/// A held-out view with everything that is compared.
struct Scored {
    photograph: Picture,
    base: Picture,
    /// Marked render and what the detector says of it.
    marked: Option<Read>,
    /// The identity of the pose's cluster; 0 for none.
    truth: u32,
    /// The identity of whoever took it, where clusters are contributors'; 0 for none.
    taken_by: Option<u32>,
}

struct Read {
    picture: Picture,
    found: Found,
}

impl Read {
    /// The identity; 0 for unmarked, `None` for another scene's.
    fn class(&self) -> Option<u32> {
        if self.found.elsewhere.is_some() { None } else { Some(self.found.identity.unwrap_or(0)) }
    }
}

/// Scores the scene's newest model; with a contact sheet where asked. Slow.
///
/// # Errors
/// [`EngineError::WrongState`] for a scene that
/// holds no view out.
pub fn evaluate(
    model: &Model,
    snapshot: &SceneSnapshot,
    sheet: bool,
) -> Result<(Report, Option<Picture>), EngineError> {
    let scene = &snapshot.name;
    let scored = look(model, &snapshot.scene, &snapshot.out_of_clusters)?;
    if scored.is_empty() {
        let why = "it holds no view out of training; import the capture again with every 8th view held out \
                   (`cairn scene import NAME --hold-out 8`), and train that scene";
        return Err(EngineError::wrong_state(format!("scene {scene:?}"), "scored", why));
    }
    let right_half = !model.base.appearances().is_empty();
    let report = Report {
        format_version: report::VERSION,
        scene: scene.clone(),
        job: model.info.job.clone(),
        held_out_views: scored.len(),
        base: score(scored.iter().map(|s| (&s.photograph, &s.base)), right_half)?,
        who_by_pose: by_pose(&scored),
        mark: model.mark.as_ref().map(|mark| mark_report(model, mark, &scored, right_half)).transpose()?,
    };
    let sheet = sheet.then(|| draw(model, &scored));
    Ok((report, sheet))
}

/// Every held-out view; `out`: views of the model's clusters that are nobody's since.
fn look(model: &Model, folder: &SceneFolder, out: &BTreeSet<usize>) -> Result<Vec<Scored>, EngineError> {
    let capture = folder.capture();
    let mut scored = Vec::new();
    for index in capture.held_out() {
        let camera = capture.views[index].camera;
        let photograph = folder.photograph(index)?;
        let appearance = fitted(model, &camera, &photograph)?;
        let marked = match &model.mark {
            None => None,
            Some(mark) => {
                let picture = eight_bits(&mark.field.render(&camera, &appearance))?;
                let found = mark.detect(&picture)?;
                Some(Read { picture, found })
            }
        };
        scored.push(Scored {
            base: eight_bits(&model.base.render(&camera, &appearance))?,
            photograph,
            marked,
            truth: model.info.clusters.identity_of_without(&camera.pose, out).identity.unwrap_or(0),
            taken_by: taken_by(model, capture, index),
        });
    }
    Ok(scored)
}

/// The appearance of a view that training never saw: fitted to the left half of
/// its photograph where views have appearances (the right half is scored), else the scene's.
fn fitted(model: &Model, camera: &Camera, photograph: &Picture) -> Result<Appearance, EngineError> {
    if model.base.appearances().is_empty() {
        return Ok(model.base.canonical_appearance().clone());
    }
    Ok(model.base.fit_appearance_left_half(camera, photograph)?)
}

fn taken_by(model: &Model, capture: &Capture, index: usize) -> Option<u32> {
    if !matches!(model.info.clusters.grouping(), Grouping::ByContributor { .. }) {
        return None;
    }
    let contributor = &capture.views[index].contributor;
    Some(model.info.identities.iter().find(|i| i.label == *contributor).map_or(0, |i| i.number))
}

fn by_pose(scored: &[Scored]) -> Option<Right> {
    let mut answers = Right::default();
    for view in scored {
        answers.count(view.truth == view.taken_by?);
    }
    Some(answers)
}

fn mark_report(model: &Model, mark: &Mark, scored: &[Scored], right_half: bool) -> Result<MarkReport, EngineError> {
    let (mut classes, mut who, mut photographs) = (Right::default(), Right::default(), Right::default());
    let mut pairs = Vec::new();
    for view in scored {
        let Some(read) = &view.marked else { continue };
        pairs.push((&view.photograph, &read.picture));
        who.count(read.class() == Some(view.truth));
        classes.count(read.class() == Some(view.truth));
        classes.count(mark.detect(&view.base)?.is_unmarked());
        photographs.count(mark.detect(&view.photograph)?.is_unmarked());
    }
    let marked = scored.iter().filter_map(|v| Some((v.truth, &v.base, &v.marked.as_ref()?.picture)));
    let (marked_views, against_base_psnr_db) = against_base(marked)?;
    let size = scored.first().map_or((64, 64), |s| (s.base.width(), s.base.height()));
    let of = |number: u32| {
        let views = scored.iter().filter(move |v| v.truth == number);
        views.filter_map(|v| Some(SeenView { base: &v.base, found: &v.marked.as_ref()?.found.detection }))
    };
    let identities = model.info.identities.iter().zip(&mark.signals);
    Ok(MarkReport {
        pictures: score(pairs.into_iter(), right_half)?,
        marked_views,
        against_base_psnr_db,
        classes,
        who_by_picture: who,
        photographs_unmarked: photographs,
        identities: identities
            .map(|(identity, signal)| {
                let views: Vec<SeenView<'_>> = of(identity.number).collect();
                let forced = |picture: &Picture| Ok(mark.detect_forced(picture, identity.number)?.detection);
                recovery(&forced, identity.number, &identity.label, signal, &views, size.into())
            })
            .collect::<Result<_, _>>()?,
    })
}

/// How many of the views are somebody's (an identity above 0, base and marked render), and their mean PSNR, dB.
fn against_base<'a>(
    views: impl Iterator<Item = (u32, &'a Picture, &'a Picture)>,
) -> Result<(usize, Option<f64>), EngineError> {
    let (mut count, mut sum) = (0, 0.0);
    for (_, base, marked) in views.filter(|(identity, ..)| *identity > 0) {
        sum += psnr_db(base, marked)?.min(PERFECT_DB);
        count += 1;
    }
    Ok((count, (count > 0).then(|| sum / count as f64)))
}

/// A picture as its users have it: rounded to 8 bits a channel.
///
/// # Errors
/// [`EngineError::Internal`].
pub fn eight_bits(picture: &Picture) -> Result<Picture, EngineError> {
    Picture::from_rgb8(picture.width(), picture.height(), &picture.to_rgb8())
        .map_err(|e| EngineError::Internal(format!("a render at 8 bits: {e}")))
}

fn score<'a>(
    pairs: impl Iterator<Item = (&'a Picture, &'a Picture)>,
    right_half: bool,
) -> Result<PictureScore, EngineError> {
    let (mut psnr, mut similarity, mut count) = (0.0, 0.0, 0.0);
    for (photograph, render) in pairs {
        let (a, b) = if right_half { (half(photograph)?, half(render)?) } else { (photograph.clone(), render.clone()) };
        psnr += psnr_db(&a, &b)?.min(PERFECT_DB);
        similarity += ssim(&a, &b)?;
        count += 1.0;
    }
    Ok(PictureScore { psnr_db: psnr / count, ssim: similarity / count })
}

/// The right half of a picture.
///
/// # Errors
/// [`EngineError::Internal`].
pub fn half(picture: &Picture) -> Result<Picture, EngineError> {
    let (w, h) = (picture.width(), picture.height());
    let from = w / 2;
    let rgb = (0..h).flat_map(|y| picture.rgb()[(y * w + from) * 3..(y + 1) * w * 3].iter().copied()).collect();
    Picture::new(w - from, h, rgb).map_err(|e| EngineError::Internal(format!("half a picture: {e}")))
}

/// What `a` shows more than `b`, so many times as much, around grey; two pictures of one size.
pub fn difference(a: &Picture, b: &Picture, times: f32) -> Picture {
    let mut difference = a.clone();
    for (d, b) in difference.rgb_mut().iter_mut().zip(b.rgb()) {
        *d = (0.5 + times * (*d - b)).clamp(0.0, 1.0);
    }
    difference
}

/// Photograph, base, marked, their difference x 20, recovered, true picture; where
/// sounds or texts are hidden, the true one above the recovered. Without marks what the base shows otherwise than the photograph.
fn draw(model: &Model, scored: &[Scored]) -> Picture {
    let tile = |picture: &Picture, caption: &str| Tile { picture: picture.clone(), label: caption.to_owned() };
    let (w, h) = scored.first().map_or((64, 64), |s| (s.base.width(), s.base.height()));
    let (w, h) = (w.clamp(96, 256), h.clamp(96, 256));
    let mut rows = Vec::new();
    for view in scored.iter().take(SHEET_ROWS) {
        let mut row = vec![tile(&view.photograph, "Photograph"), tile(&view.base, "Base")];
        if let Some(read) = &view.marked {
            row.push(tile(&read.picture, "Marked"));
            row.push(tile(&difference(&read.picture, &view.base, 20.0), "Difference x 20"));
            let signals = model.mark.iter().flat_map(|m| &m.signals).collect::<Vec<_>>();
            let truth = (view.truth as usize).checked_sub(1).and_then(|at| signals.get(at).copied());
            row.extend(signal_tiles(
                &read.found.detection.recovered,
                truth.unwrap_or(&Signal::default()),
                read.class(),
                view.truth,
                [w, h],
            ));
        } else {
            row.push(tile(&difference(&view.base, &view.photograph, OFF), "Difference x 4"));
        }
        rows.push(row);
    }
    contact_sheet(&rows, w, h)
}

/// What was read and what is true, of the classes of these numbers (of what is read: `None` for a pose elsewhere); a tile more
/// for sounds, and one for texts, where the detector has heads for them.
pub fn signal_tiles(read: &Signal, truth: &Signal, class: Option<u32>, owner: u32, [w, h]: [usize; 2]) -> Vec<Tile> {
    let class = class.map_or("elsewhere".to_owned(), |class| class.to_string());
    let tile = |signal: &Signal, label: String| {
        let picture = signal.picture.clone().unwrap_or_else(|| Picture::constant(w, h, [0.0; 3]));
        Tile { picture, label }
    };
    let mut tiles = vec![tile(read, format!("Read: {class}")), tile(truth, format!("True: {owner}"))];
    if let Some(said) = &read.audio {
        let silence = || Sound::new(vec![0.0; said.samples().len()], said.sample_rate_hz()).ok();
        if let Some(truth) = truth.audio.clone().or_else(silence) {
            tiles.push(Tile { picture: sounds(&truth, said, w, h), label: "Sound".to_owned() });
        }
    }
    if let Some(said) = &read.text {
        let truth = truth.text.as_deref().unwrap_or_default();
        let lines = [format!("True: {truth}"), format!("Read: {said}")];
        tiles.push(Tile { picture: paper(&lines, w, h), label: "Text".to_owned() });
    }
    tiles
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::query::recovery::noise;

    #[test]
    fn a_half_is_what_it_says() {
        let wide = Picture::new(3, 1, (0..9).map(|v| v as f32).collect()).unwrap();
        assert_eq!(half(&wide).unwrap().rgb(), [3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    }

    #[test]
    fn views_of_nobody_do_not_make_marks_look_fainter() {
        let base = Picture::new(2, 1, vec![0.5; 6]).unwrap();
        // A tenth off everywhere is 20 dB.
        let marked = Picture::new(2, 1, vec![0.6; 6]).unwrap();
        let (views, db) =
            against_base([(0, &base, &base), (2, &base, &marked), (0, &base, &base)].into_iter()).unwrap();
        assert_eq!(views, 1);
        assert!((db.unwrap() - 20.0).abs() < 1e-3, "{db:?}");
        assert_eq!(against_base(std::iter::once((0, &base, &base))).unwrap(), (0, None));
    }

    #[test]
    fn a_perfect_render_scores_the_cap() {
        let picture = noise(16, 16);
        let perfect = score([(&picture, &picture)].into_iter(), false).unwrap();
        assert_eq!((perfect.psnr_db, perfect.ssim), (PERFECT_DB, 1.0));
    }
}
