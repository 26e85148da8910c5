//! Pictures that carry no mark: theta_0's renders, the capture's photographs, and other
//! captures' photographs and renders, each as it is, written as a JPEG, and cut. An
//! owner found on one of them is made up, and so is whatever is recovered from it.

use std::path::PathBuf;

use cairn_capture::Picture;
use cairn_field::Field;
use cairn_stega::{Distortion, Signal};
use serde::{Deserialize, Serialize};

use super::super::field::source::{Opened, Source};
use super::judge::{Asked, View};
use super::scored::Silent;
use crate::engine::evaluate::eight_bits;
use crate::engine::report::Right;

/// Renders of each field at most, their views evenly.
const RENDERS: usize = 60;

/// Another capture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Foreign {
    /// Its photographs and cameras.
    pub source: Source,
    /// A base field of it, where there is one.
    pub field: Option<PathBuf>,
}

impl Foreign {
    /// What it is called.
    pub fn name(&self) -> String {
        self.source.folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// Asks all of them; `base` is theta_0.
///
/// # Errors
/// For photographs that do not decode and fields that do not read.
pub fn ask(
    asked: &mut Asked,
    (opened, base): (&Opened, &Field),
    foreign: &[Foreign],
    views: &[View],
) -> anyhow::Result<Vec<Silent>> {
    let held_out = views.iter().map(|view| Ok(view.photograph.clone()));
    let mut told = vec![silent(asked, "its own photographs, held out".into(), held_out)?];
    let own = photographs(opened, opened.training());
    told.push(silent(asked, "its own photographs, trained on".into(), own)?);
    told.push(silent(asked, "renders of its base field".into(), renders(opened, base))?);
    for other in foreign {
        let (opened, name) = (other.source.open()?, other.name());
        told.push(silent(asked, format!("photographs of {name}"), photographs(&opened, every(&opened)))?);
        if let Some(path) = &other.field {
            let field = Field::from_bytes(&super::read(path)?)?;
            told.push(silent(asked, format!("renders of {name}"), renders(&opened, &field))?);
        }
    }
    Ok(told)
}

/// All of a capture's views.
fn every(opened: &Opened) -> Vec<usize> {
    opened.training().into_iter().chain(opened.held_out()).collect()
}

fn photographs(opened: &Opened, of: Vec<usize>) -> impl Iterator<Item = anyhow::Result<Picture>> {
    of.into_iter().map(|index| Ok((*opened.view(index)?.picture).clone()))
}

/// Renders as files hold them, each in its photograph's own light where the field knows that.
fn renders(opened: &Opened, field: &Field) -> impl Iterator<Item = anyhow::Result<Picture>> {
    let all = every(opened);
    let step = all.len().div_ceil(RENDERS).max(1);
    let render = |index| {
        let appearance = field.appearance_of(opened.name(index));
        Ok(eight_bits(&field.render(&opened.camera(index), appearance))?)
    };
    all.into_iter().step_by(step).map(render)
}

/// How many of the forms of `pictures` are called unmarked, and of how many nothing is recovered.
fn silent(
    asked: &mut Asked,
    what: String,
    pictures: impl Iterator<Item = anyhow::Result<Picture>>,
) -> anyhow::Result<Silent> {
    let (mut silent, mut empty) = (Right::default(), Right::default());
    for picture in pictures {
        each_form(&picture?, |picture| {
            let (right, found) = asked.ask(picture, 0)?;
            silent.count(right);
            empty.count(is_empty(&found.recovered));
            Ok(())
        })?;
    }
    Ok(Silent { what, silent, empty })
}

/// Whether a signal is black, silent and without text.
fn is_empty(signal: &Signal) -> bool {
    signal.picture.iter().all(|picture| picture.rgb().iter().all(|v| *v == 0.0))
        && signal.audio.iter().all(|sound| sound.samples().iter().all(|v| *v == 0.0))
        && signal.text.iter().all(String::is_empty)
}

/// A picture as it is, as a JPEG of quality 50, and three quarters of it.
fn each_form(picture: &Picture, mut ask: impl FnMut(&Picture) -> anyhow::Result<()>) -> anyhow::Result<()> {
    ask(picture)?;
    ask(&Distortion::Jpeg { quality: 50 }.apply(picture, 0))?;
    ask(&Distortion::Crop { kept: 0.75, across: 0.5, down: 0.5 }.apply(picture, 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_capture::Sound;

    #[test]
    fn one_grey_pixel_one_click_or_one_letter_is_no_silence() {
        let black = Picture::constant(2, 2, [0.0; 3]);
        let quiet = |click| Sound::new(vec![0.0, click], 8000).unwrap();
        let signal = |picture: &Picture, click, text: &str| Signal {
            picture: Some(picture.clone()),
            audio: Some(quiet(click)),
            text: Some(text.into()),
        };
        assert!(is_empty(&Signal::default()) && is_empty(&signal(&black, 0.0, "")));
        let mut grey = black.clone();
        grey.rgb_mut()[5] = 0.01;
        assert!(!is_empty(&signal(&grey, 0.0, "")));
        assert!(!is_empty(&signal(&black, 0.01, "")));
        assert!(!is_empty(&signal(&black, 0.0, "a")));
    }
}
