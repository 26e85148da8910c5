//! Pictures that carry no mark: theta_0's renders, the capture's photographs, and other
//! captures' photographs and renders, each as it is, written as a JPEG, and cut. An
//! owner found on one of them is made up, and so is anything that is recovered from it. Renders are from where photographs were taken
//! and from between: views that nobody photographed cost nothing but their rendering.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use cairn_field::Field;
use cairn_mark::{Distortion, PlannedView, Signal, virtual_views};
use cairn_scene::Picture;
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use cairn_service::query::evaluate::eight_bits;
use cairn_service::query::report::Right;

use super::judged::{Asked, Silent, View};
use super::kept::Kept;
use crate::file;
use crate::source::{Opened, Source};

/// Renders of each field at most: four captures' and their photographs are over a thousand pictures.
const RENDERS: usize = 170;
/// Of them at most so many from where photographs were taken, evenly.
const PHOTOGRAPHED: usize = 60;
/// What the poses of the others are drawn by: the same for every detector, and no training's.
const POSES_SEED: u64 = 0x0075_6e6d_6172_6b65;

/// One after another: all at once are too many to hold.
type Pictures<'a> = &'a mut dyn Iterator<Item = anyhow::Result<Picture>>;

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

/// theta_0 of a capture.
#[derive(Clone, Copy)]
pub struct Base<'a> {
    /// The field.
    pub field: &'a Field,
    /// Its file.
    pub file: &'a Path,
}

/// Asks about all of them, and counts how many different ones they are; `base` is of the capture at `source`. Renders are
/// kept in the folder `kept`.
///
/// # Errors
/// For photographs that do not decode, fields that do not read, and a folder that cannot be written.
pub fn ask(
    asked: &mut Asked,
    source: &Source,
    base: Base<'_>,
    foreign: &[Foreign],
    kept: &Path,
    views: &[View],
) -> anyhow::Result<(Vec<Silent>, usize)> {
    let (opened, mut seen) = (source.open()?, BTreeSet::new());
    let mut silent = |what: String, pictures: Pictures<'_>| silent(&mut *asked, &mut seen, what, pictures);
    let mut held_out = views.iter().map(|view| anyhow::Ok(view.photograph.clone()));
    let mut found = vec![silent("its own photographs, held out".into(), &mut held_out)?];
    let mut own = photographs(&opened, opened.training());
    found.push(silent("its own photographs, trained on".into(), &mut own)?);
    found.push(silent("renders of its base field".into(), &mut renders(&opened, source, base, kept)?)?);
    for other in foreign {
        let (opened, name) = (other.source.open()?, other.name());
        found.push(silent(format!("photographs of {name}"), &mut photographs(&opened, every(&opened)))?);
        if let Some(path) = &other.field {
            let field = Field::from_bytes(&file::read(path)?)?;
            let base = Base { field: &field, file: path };
            found.push(silent(format!("renders of {name}"), &mut renders(&opened, &other.source, base, kept)?)?);
        }
    }
    Ok((found, seen.len()))
}

/// All of a capture's views.
fn every(opened: &Opened) -> Vec<usize> {
    opened.training().into_iter().chain(opened.held_out()).collect()
}

fn photographs(opened: &Opened, of: Vec<usize>) -> impl Iterator<Item = anyhow::Result<Picture>> {
    of.into_iter().map(|index| Ok(opened.view(index)?.picture))
}

/// Renders as files hold them.
fn renders<'a>(
    opened: &Opened,
    source: &Source,
    base: Base<'a>,
    kept: &Path,
) -> anyhow::Result<impl Iterator<Item = anyhow::Result<Picture>> + use<'a>> {
    let (kept, field) = (Kept::new(base.file, kept)?, base.field);
    let render = |view: &PlannedView| Ok(eight_bits(&field.render(&view.camera, &view.appearance))?);
    Ok(poses(opened, source, field)?.into_iter().map(move |view| kept.picture(&view, || render(&view))))
}

/// From where they are: photographs' poses, each in its photograph's own light where the field knows that, and
/// poses between those in light between theirs, as many of these as the source gives views of a split.
fn poses(opened: &Opened, source: &Source, field: &Field) -> anyhow::Result<Vec<PlannedView>> {
    let view = |index| {
        let appearance = field.appearance_of(opened.name(index)).clone();
        PlannedView { camera: opened.camera(index), appearance }
    };
    let views: Vec<PlannedView> = every(opened).into_iter().map(view).collect();
    let step = views.len().div_ceil(PHOTOGRAPHED).max(1);
    let mut poses: Vec<PlannedView> = views.iter().step_by(step).cloned().collect();
    let between = source.max_views.unwrap_or(RENDERS).min(RENDERS - poses.len());
    let photographed: Vec<_> = views.iter().map(|view| view.camera.pose).collect();
    // One cluster of all: what lies among the photographs belongs to it.
    let all = ClusterConfig { anchors: 1, neighbours: photographed.len(), ..ClusterConfig::default() };
    let all = Clusters::build(&photographed, &Grouping::Anchors(all), &[], POSES_SEED)?;
    poses.extend(virtual_views(&all, 1, &views, between, &mut ChaCha8Rng::seed_from_u64(POSES_SEED)));
    Ok(poses)
}

/// How many of the forms of `pictures` are called unmarked, and of how many nothing is recovered. Pictures that are
/// there twice are one; those not in `seen` come into it.
fn silent(
    asked: &mut Asked,
    seen: &mut BTreeSet<[u8; 32]>,
    what: String,
    pictures: Pictures<'_>,
) -> anyhow::Result<Silent> {
    let (mut silent, mut empty, mut different) = (Right::default(), Right::default(), BTreeSet::new());
    for picture in pictures {
        let picture = picture?;
        different.insert(digest(&picture));
        each_form(&picture, |picture| {
            let (right, found) = asked.ask(picture, 0)?;
            silent.count(right);
            empty.count(is_empty(&found.recovered));
            Ok(())
        })?;
    }
    seen.extend(&different);
    Ok(Silent { what, pictures: different.len(), silent, empty })
}

/// SHA-256 of a picture in 8 bits.
fn digest(picture: &Picture) -> [u8; 32] {
    let width = (picture.width() as u64).to_le_bytes();
    Sha256::new().chain_update(width).chain_update(picture.to_rgb8()).finalize().into()
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
    use cairn_scene::Sound;

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
