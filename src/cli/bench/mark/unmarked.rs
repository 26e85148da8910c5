//! Pictures that carry no mark besides theta_0's renders: the capture's
//! photographs, and other captures', as they are, written as a JPEG, and cut. An
//! owner found on one of them is made up.

use cairn_capture::Picture;
use cairn_stega::Distortion;

use super::super::field::source::{Opened, Source};
use super::judge::{Asked, View};
use super::scored::Silent;
use crate::engine::report::Right;

/// Photographs of each other capture, evenly, at most.
const FOREIGN: usize = 120;

/// Asks all of them.
///
/// # Errors
/// For photographs that do not decode.
pub fn ask(asked: &mut Asked, (opened, foreign): (&Opened, &[Source]), views: &[View]) -> anyhow::Result<Vec<Silent>> {
    let mut told = Vec::new();
    let mut seen = Right::default();
    for view in views {
        each_form(&view.photograph, |picture| {
            seen.count(asked.ask(picture, 0)?.0);
            Ok(())
        })?;
    }
    told.push(Silent { what: "its own photographs, held out".into(), silent: seen });
    let mut seen = Right::default();
    for index in opened.training() {
        each_form(&opened.view(index)?.picture, |picture| {
            seen.count(asked.ask(picture, 0)?.0);
            Ok(())
        })?;
    }
    told.push(Silent { what: "its own photographs, trained on".into(), silent: seen });
    for source in foreign {
        let mut seen = Right::default();
        let other = source.open()?;
        let all: Vec<usize> = other.training().into_iter().chain(other.held_out()).collect();
        for index in all.iter().step_by(all.len().div_ceil(FOREIGN).max(1)) {
            each_form(&other.view(*index)?.picture, |picture| {
                seen.count(asked.ask(picture, 0)?.0);
                Ok(())
            })?;
        }
        let name = source.folder.file_name().unwrap_or_default().to_string_lossy();
        told.push(Silent { what: format!("photographs of {name}"), silent: seen });
    }
    Ok(told)
}

/// A picture as it is, as a JPEG of quality 50, and three quarters of it.
fn each_form(picture: &Picture, mut ask: impl FnMut(&Picture) -> anyhow::Result<()>) -> anyhow::Result<()> {
    ask(picture)?;
    ask(&Distortion::Jpeg { quality: 50 }.apply(picture, 0))?;
    ask(&Distortion::Crop { kept: 0.75, across: 0.5, down: 0.5 }.apply(picture, 0))
}
