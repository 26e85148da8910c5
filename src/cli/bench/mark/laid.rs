//! Reading by laying pictures over the field: whether marks stand out of held-out renders at the camera that they
//! were rendered with and where it has to be searched for; and that they do not where there are none: of base
//! renders, as they are and harmed, of photographs, of a marked render from elsewhere, of other captures.

use std::time::Instant;

use cairn_capture::{Camera, Picture};
use cairn_stega::{Detector, Distortion, MarkedField, RegisteredReader};
use serde::{Deserialize, Serialize};

use super::super::field::source::{Opened, Source};
use super::judge::View;
use crate::engine::report::Right;

/// Views whose cameras are searched for, at most: each takes three searches of many seconds.
const SEARCHED: usize = 6;
/// Photographs of each other capture that are searched for, at most.
const FOREIGN: usize = 3;

/// What came of it with cameras known, and searched for.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Laid {
    /// At the cameras that renders were made with.
    pub known: Told,
    /// Where they were searched for, on fewer views.
    pub searched: Told,
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

/// Asks about all views at their cameras, and about some views and `foreign` captures' photographs without. `None` where nothing can be laid over the field.
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
        tell(&mut laid.known, (marked, detector, &reader), view, from)?;
        let mut silent = |picture: &Picture| laid.known.silent(marked, &reader, picture, from);
        let elsewhere = &views[(at + 1) % views.len()];
        if views.len() > 1 {
            silent(&elsewhere.marked);
        }
        let harms =
            [Distortion::Jpeg { quality: 90 }, Distortion::Jpeg { quality: 50 }, Distortion::Blur { sigma_px: 1.0 }];
        harms.iter().for_each(|harm| silent(&harm.apply(&view.base, at as u64)));
    }
    for view in views.iter().step_by(views.len().div_ceil(SEARCHED).max(1)) {
        tell(&mut laid.searched, (marked, detector, &reader), view, None)?;
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
        self.silent.count(reader.read(marked, picture, from).and_then(|read| read.identity()).is_none());
        self.pictures += 1;
        self.seconds += begun.elapsed().as_secs_f64();
    }
}

fn tell(
    told: &mut Told,
    (marked, detector, reader): (&MarkedField, &Detector, &RegisteredReader),
    view: &View,
    from: Option<&Camera>,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    let stands_out = |picture: &Picture| reader.read(marked, picture, from).and_then(|read| read.identity());
    for (picture, truth) in [(&view.marked, view.truth as u32), (&view.base, 0)] {
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
    told.silent(marked, reader, &view.photograph, from);
    Ok(())
}
