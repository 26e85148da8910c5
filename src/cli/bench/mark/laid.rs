//! Reading by laying pictures over the field: whether marks stand out of held-out renders at the camera that they
//! were rendered with and where it has to be searched for; and that they do not where there are none: of base
//! renders, as they are and harmed, of photographs, of a marked render from elsewhere, of other captures.

use std::time::Instant;

use cairn_mark::{Detector, MarkedField, RegisteredReader};
use cairn_scene::{Camera, Picture};
use serde::{Deserialize, Serialize};

use super::super::field::source::{Opened, Source};
use super::harm;
use super::judge::View;
use cairn_service::query::report::Right;

/// Views whose cameras are searched for, and that are harmed, at most: searches take many seconds each.
const SOME: usize = 6;
/// What is done to renders before they are laid over the field, by `harm`'s names: what leaves every pixel where it was.
const HARMS: [&str; 5] = ["JPEG 90", "JPEG 50", "JPEG 30", "blur 2 px", "noise 0.1"];
/// Photographs of each other capture that are searched for, at most.
const FOREIGN: usize = 3;

/// What came of it with cameras known, and searched for.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Laid {
    /// At the cameras that renders were made with.
    pub known: Told,
    /// Where they were searched for, on fewer views.
    pub searched: Told,
    /// At the cameras that renders were made with, on fewer views, after each of some harms.
    pub harmed: Vec<(String, Told)>,
}

/// Answers to pictures laid over the field.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Told {
    /// Right classes over theta's and theta_0's renders: a mark that stands out is believed, and where none does the
    /// classifier answers.
    pub classes: Right,
    /// Of theta's renders that have a mark, those in which it stands out.
    pub found: Right,
    /// Of pictures without a mark, or whose mark is another place's, those in which none stands out.
    pub silent: Right,
    /// Pictures, and the seconds for all of them; the classifier's, where it was asked, and small renders of the
    /// training views are in them.
    pub pictures: usize,
    /// See `pictures`.
    pub seconds: f64,
}

/// Asks about all views at their cameras, about some without and after harm, and about `foreign` captures' photographs without. `None` where nothing can be laid over the field.
///
/// # Errors
/// For pictures that the detector does not take.
pub fn ask(
    (marked, detector): (&MarkedField, &Detector),
    (opened, foreign): (&Opened, &[Source]),
    views: &[View],
) -> anyhow::Result<Option<Laid>> {
    let training = opened.training().into_iter().map(|i| opened.view(i).map(|v| (v.camera, v.name)));
    let training = training.collect::<anyhow::Result<Vec<_>>>()?;
    let training: Vec<(Camera, &str)> = training.iter().map(|(camera, name)| (*camera, name.as_str())).collect();
    let Some(reader) = RegisteredReader::new(marked, &training) else { return Ok(None) };
    let mut laid = Laid::default();
    for (at, view) in views.iter().enumerate() {
        let from = Some(&view.camera);
        tell(&mut laid.known, (marked, detector, &reader), view, [&view.marked, &view.base], from)?;
        laid.known.silent(marked, &reader, &view.photograph, from);
        let elsewhere = &views[(at + 1) % views.len()];
        if views.len() > 1 {
            laid.known.silent(marked, &reader, &elsewhere.marked, from);
        }
    }
    let some = || views.iter().step_by(views.len().div_ceil(SOME).max(1));
    for view in some() {
        tell(&mut laid.searched, (marked, detector, &reader), view, [&view.marked, &view.base], None)?;
        laid.searched.silent(marked, &reader, &view.photograph, None);
    }
    for harm in harm::of_pictures().iter().filter(|harm| HARMS.contains(&harm.name)) {
        let mut told = Told::default();
        for (at, view) in some().enumerate() {
            // Two files: each has noise of its own.
            let done = |picture: &Picture, salt| harm.tries[0].iter().fold(picture.clone(), |p, d| d.apply(&p, salt));
            let pair = [done(&view.marked, 2 * at as u64), done(&view.base, 2 * at as u64 + 1)];
            tell(&mut told, (marked, detector, &reader), view, [&pair[0], &pair[1]], Some(&view.camera))?;
        }
        laid.harmed.push((harm.name.to_owned(), told));
    }
    for source in foreign {
        let other = source.open()?;
        let held_out = other.held_out();
        for index in held_out.iter().step_by(held_out.len().div_ceil(FOREIGN).max(1)) {
            laid.searched.silent(marked, &reader, &other.view(*index)?.picture, None);
        }
    }
    Ok(Some(laid))
}

impl Told {
    /// Counts whether no mark stands out of `picture`.
    fn silent(&mut self, marked: &MarkedField, reader: &RegisteredReader, picture: &Picture, from: Option<&Camera>) {
        let begun = Instant::now();
        self.silent.count(reader.read(marked, picture, from, &|| true).and_then(|read| read.identity()).is_none());
        self.pictures += 1;
        self.seconds += begun.elapsed().as_secs_f64();
    }
}

/// Counts what is told of a view's `pictures`, theta's and theta_0's.
fn tell(
    told: &mut Told,
    (marked, detector, reader): (&MarkedField, &Detector, &RegisteredReader),
    view: &View,
    pictures: [&Picture; 2],
    from: Option<&Camera>,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    let stands_out = |picture: &Picture| reader.read(marked, picture, from, &|| true).and_then(|read| read.identity());
    for (picture, truth) in pictures.into_iter().zip([view.truth as u32, 0]) {
        let found = stands_out(picture);
        if truth > 0 {
            told.found.count(found == Some(truth));
        } else {
            told.silent.count(found.is_none());
        }
        let answer = match found {
            None => detector.detect(picture)?.identity,
            believed => believed,
        };
        told.classes.count(answer.unwrap_or(0) == truth);
    }
    told.pictures += 2;
    told.seconds += begun.elapsed().as_secs_f64();
    Ok(())
}
