//! Reading by registration: whether marks stand out of held-out renders, at the camera that they were rendered with and
//! where it has to be searched for. And that they do not where there are none: in base renders, as they are and after
//! attacks, in photographs, in a marked render from elsewhere, and in other captures.

use std::sync::Arc;
use std::time::Instant;

use cairn_mark::{Detector, MarkedField, RegisteredReader};
use cairn_register::{Index, Reference};
use cairn_scene::{Camera, Picture};

use super::attack;
use super::judged::{Answers, Registered, View};
use crate::source::{Opened, Source};

/// Views whose cameras are searched for, and that are attacked, at most: searches take many seconds each.
const SOME: usize = 6;
/// What is done to renders before they are registered, by the attacks' names: what leaves every pixel where it was.
const ATTACKS: [&str; 5] = ["JPEG 90", "JPEG 50", "JPEG 30", "blur 2 px", "noise 0.1"];
/// Photographs of each other capture that are searched for, at most.
const FOREIGN: usize = 3;

/// Asks about all views at their cameras, about some without and after attacks, and about `foreign` captures' photographs
/// without. `None` where nothing can be registered.
///
/// # Errors
/// For pictures that the detector does not take.
pub fn ask(
    marked: &MarkedField,
    detector: &Detector,
    opened: &Opened,
    foreign: &[Source],
    views: &[View],
) -> anyhow::Result<Option<Registered>> {
    let training = opened.training();
    let reference = |index: usize| Reference {
        camera: opened.camera(index),
        name: opened.name(index),
        photograph: Box::new(move || opened.view(index).ok().map(|view| view.picture)),
    };
    let references: Vec<Reference<'_>> = training.into_iter().map(reference).collect();
    let index = Index::build(marked.base(), &references, &mut |_, _| true).map(Arc::new);
    let Some(reader) = RegisteredReader::new(marked, index) else { return Ok(None) };
    let by = By { marked, detector, reader: &reader };
    let mut found = Registered::default();
    for (at, view) in views.iter().enumerate() {
        let from = Some(&view.camera);
        count(&mut found.known, by, view, [&view.marked, &view.base], from)?;
        silent(&mut found.known, by, &view.photograph, from);
        let elsewhere = &views[(at + 1) % views.len()];
        if views.len() > 1 {
            silent(&mut found.known, by, &elsewhere.marked, from);
        }
    }
    let some = || views.iter().step_by(views.len().div_ceil(SOME).max(1));
    for view in some() {
        count(&mut found.searched, by, view, [&view.marked, &view.base], None)?;
        silent(&mut found.searched, by, &view.photograph, None);
    }
    for attack in attack::of_pictures().iter().filter(|attack| ATTACKS.contains(&attack.name)) {
        let mut answers = Answers::default();
        for (at, view) in some().enumerate() {
            // Two files: each has noise of its own.
            let done = |picture: &Picture, salt| attack.tries[0].iter().fold(picture.clone(), |p, d| d.apply(&p, salt));
            let pair = [done(&view.marked, 2 * at as u64), done(&view.base, 2 * at as u64 + 1)];
            count(&mut answers, by, view, [&pair[0], &pair[1]], Some(&view.camera))?;
        }
        found.attacked.push((attack.name.to_owned(), answers));
    }
    for source in foreign {
        let other = source.open()?;
        let held_out = other.held_out();
        for index in held_out.iter().step_by(held_out.len().div_ceil(FOREIGN).max(1)) {
            silent(&mut found.searched, by, &other.view(*index)?.picture, None);
        }
    }
    Ok(Some(found))
}

/// Counts whether no mark stands out of `picture`.
fn silent(answers: &mut Answers, by: By<'_>, picture: &Picture, from: Option<&Camera>) {
    let begun = Instant::now();
    answers.silent.count(by.stands_out(picture, from).is_none());
    answers.pictures += 1;
    answers.seconds += begun.elapsed().as_secs_f64();
}

/// What pictures are read by.
#[derive(Clone, Copy)]
struct By<'a> {
    marked: &'a MarkedField,
    detector: &'a Detector,
    reader: &'a RegisteredReader,
}

impl By<'_> {
    /// The identity whose mark stands out of `picture`.
    fn stands_out(&self, picture: &Picture, from: Option<&Camera>) -> Option<u32> {
        self.reader.read(self.marked, picture, from, &|| true).ok().and_then(|read| read.identity())
    }
}

/// Counts what is predicted of a view's `pictures`, theta's and theta_0's.
fn count(
    answers: &mut Answers,
    by: By<'_>,
    view: &View,
    pictures: [&Picture; 2],
    from: Option<&Camera>,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    for (picture, truth) in pictures.into_iter().zip([view.truth as u32, 0]) {
        let found = by.stands_out(picture, from);
        if truth > 0 {
            answers.found.count(found == Some(truth));
        } else {
            answers.silent.count(found.is_none());
        }
        let answer = match found {
            None => by.detector.detect(picture)?.identity,
            believed => believed,
        };
        answers.classes.count(answer.unwrap_or(0) == truth);
    }
    answers.pictures += 2;
    answers.seconds += begun.elapsed().as_secs_f64();
    Ok(())
}
