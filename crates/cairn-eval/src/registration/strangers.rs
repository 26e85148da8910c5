//! Pictures of other scenes, for which no camera is to be found: whole photographs and their quarters.

use cairn_mark::Distortion::{self, Crop, EightBits};
use cairn_scene::Picture;

use crate::source::{Opened, Source};

/// Parts of a photograph, each a picture of its own.
const PARTS: [(&str, Distortion); 5] = [
    ("whole", EightBits),
    ("top left", quarter(0.0, 0.0)),
    ("top right", quarter(1.0, 0.0)),
    ("bottom left", quarter(0.0, 1.0)),
    ("bottom right", quarter(1.0, 1.0)),
];

const fn quarter(across: f32, down: f32) -> Distortion {
    Crop { kept: 0.5, across, down }
}

/// The pictures of some captures.
pub struct Strangers {
    captures: Vec<Opened>,
    /// Capture, view and part of each.
    pictures: Vec<[usize; 3]>,
    longest_side_px: usize,
}

impl Strangers {
    /// At most `max` pictures of `captures`, evenly taken; none is longer than `longest_side_px`.
    ///
    /// # Errors
    /// For captures that do not read.
    pub fn open(captures: &[Source], longest_side_px: usize, max: usize) -> anyhow::Result<Self> {
        let captures = captures.iter().map(Source::open).collect::<anyhow::Result<Vec<_>>>()?;
        let views: Vec<Vec<usize>> =
            captures.iter().map(|capture| [capture.training(), capture.held_out()].concat()).collect();
        let pictures = evenly(&all(&views), max);
        Ok(Self { captures, pictures, longest_side_px })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.pictures.len()
    }

    /// Picture `at`, with what it is of.
    ///
    /// # Errors
    /// For a photograph that does not decode.
    pub fn picture(&self, at: usize) -> anyhow::Result<(String, Picture)> {
        let [capture, view, part] = self.pictures[at];
        let view = self.captures[capture].view(view)?;
        let (part, cut) = &PARTS[part];
        let picture = cut.apply(&view.picture, 0);
        let longest = picture.width().max(picture.height());
        let name = format!("{}, {part}", view.name);
        if longest <= self.longest_side_px {
            return Ok((name, picture));
        }
        let side = |side: usize| ((side * self.longest_side_px) as f64 / longest as f64).round().max(1.0) as usize;
        Ok((name, picture.resized(side(picture.width()), side(picture.height()))))
    }
}

/// Every part of every view: first all that are whole, then all first quarters, and so on, so that few of them, evenly
/// taken, are of all kinds.
fn all(views: &[Vec<usize>]) -> Vec<[usize; 3]> {
    let of =
        |part: usize| views.iter().enumerate().flat_map(move |(k, of)| of.iter().map(move |view| [k, *view, part]));
    (0..PARTS.len()).flat_map(of).collect()
}

fn evenly(all: &[[usize; 3]], max: usize) -> Vec<[usize; 3]> {
    let count = all.len().min(max);
    (0..count).map(|k| all[k * all.len() / count]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_pictures_are_of_all_captures_and_parts() {
        let views = [(0..40).collect::<Vec<usize>>(), (3..43).collect()];
        let pictures = all(&views);
        assert_eq!((pictures.len(), pictures[0], pictures[79]), (400, [0, 0, 0], [1, 42, 0]));
        let distinct = |of: &[[usize; 3]]| of.iter().collect::<std::collections::BTreeSet<_>>().len();
        assert_eq!((distinct(&pictures), evenly(&pictures, 500)), (400, pictures.clone()));
        // Were a view's five parts beside each other, a step of five would take whole photographs only.
        let few = evenly(&pictures, 80);
        assert_eq!((few.len(), distinct(&few)), (80, 80));
        for (capture, part) in (0..2).flat_map(|capture| (0..PARTS.len()).map(move |part| (capture, part))) {
            let count = few.iter().filter(|picture| picture[0] == capture && picture[2] == part).count();
            assert_eq!(count, 8, "capture {capture}, part {part}");
        }
    }

    #[test]
    fn quarters_are_different_pictures() {
        let picture = Picture::new(4, 4, (0..16).flat_map(|k| [k as f32 / 16.0; 3]).collect()).unwrap();
        let firsts: Vec<f32> = PARTS[1..].iter().map(|(_, cut)| cut.apply(&picture, 0).pixel(0, 0)[0] * 16.0).collect();
        assert_eq!(firsts, [0.0, 2.0, 8.0, 10.0]);
    }
}
