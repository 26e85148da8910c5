//! Reading by laying pictures over the field: whether marks stand out of held-out renders, and do not where there
//! are none, at the camera that they were rendered with and where it has to be searched for.

use std::time::Instant;

use cairn_capture::{Camera, Picture};
use cairn_stega::{Detector, MarkedField, RegisteredReader};
use serde::{Deserialize, Serialize};

use super::super::field::source::Opened;
use super::judge::View;
use crate::engine::report::Right;

/// Views whose cameras are searched for, at most: each takes three searches of many seconds.
const SEARCHED: usize = 6;

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
    /// Of theta_0's renders and photographs, those in which no mark stands out.
    pub silent: Right,
    /// Seconds for all of them.
    pub seconds: f64,
}

/// Asks about all views at their cameras, and about some without. `None` where nothing can be laid over the field.
///
/// # Errors
/// For pictures that the detector does not take.
pub fn ask(
    (marked, detector): (&MarkedField, &Detector),
    opened: &Opened,
    views: &[View],
) -> anyhow::Result<Option<Laid>> {
    let training = opened.training().into_iter().map(|i| opened.view(i).map(|v| (v.camera, v.name)));
    let training = training.collect::<anyhow::Result<Vec<_>>>()?;
    let training: Vec<(Camera, &str)> = training.iter().map(|(camera, name)| (*camera, name.as_str())).collect();
    let Some(reader) = RegisteredReader::new(marked, &training) else { return Ok(None) };
    let mut laid = Laid::default();
    for view in views {
        tell(&mut laid.known, (marked, detector, &reader), view, Some(&view.camera))?;
    }
    for view in views.iter().step_by(views.len().div_ceil(SEARCHED).max(1)) {
        tell(&mut laid.searched, (marked, detector, &reader), view, None)?;
    }
    Ok(Some(laid))
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
    told.silent.count(stands_out(&view.photograph).is_none());
    told.seconds += begun.elapsed().as_secs_f64();
    Ok(())
}
