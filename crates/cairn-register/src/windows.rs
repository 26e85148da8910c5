//! The pixels of a picture that are compared: small parts with much to see, spread over it.

use std::ops::Range;

use crate::blur::Blur;
use cairn_scene::{Camera, Picture};

/// Where a part of a picture begins, px; each is [`PART`] wide and high.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) x: usize,
    pub(super) y: usize,
}

impl Window {
    /// Its pixels, row-major.
    fn places(self) -> impl Iterator<Item = (usize, usize)> {
        (self.y..self.y + PART).flat_map(move |y| (self.x..self.x + PART).map(move |x| (x, y)))
    }
}

/// What is compared.
#[derive(Debug)]
pub(super) struct Parts {
    /// The picture's size, px.
    pub(super) size: (usize, usize),
    pub(super) windows: Vec<Window>,
    /// The windows' pixels, one after another, row-major.
    pub(super) pixels: Vec<[f32; 3]>,
    /// Whether there is something to be seen at each of them: a picture's flat background fits everywhere.
    pub(super) tells: Vec<bool>,
    /// How blurred what the field shows is before it is compared.
    pub(super) blur: Blur,
}

/// Side of a part, px.
pub(super) const PART: usize = 8;
/// Its pixels.
pub(super) const WINDOW: usize = PART * PART;
/// Parts across the longer side.
const PARTS: usize = 12;
/// Where neighbours differ by less (root of the sum of squares over channels, right and below), nothing is to be seen.
const FLAT: f32 = 0.01;

impl Parts {
    /// Of each cell of a lattice the part where most is to be seen.
    pub(super) fn of(picture: &Picture) -> Self {
        let (w, h) = (picture.width(), picture.height());
        let cell = (w.max(h) / PARTS).max(PART);
        let (mut windows, detail) = (Vec::new(), detail(picture));
        let seen = |window: &Window| window.places().any(|(x, y)| detail[y * w + x] > FLAT);
        for top in (0..h).step_by(cell) {
            for left in (0..w).step_by(cell) {
                let [right, bottom] = [(left + cell).min(w), (top + cell).min(h)];
                windows.extend(most_detailed(&detail, w, left..right, top..bottom).filter(seen));
            }
        }
        let places: Vec<(usize, usize)> = windows.iter().flat_map(|w| w.places()).collect();
        let pixels = places.iter().map(|(x, y)| picture.pixel(*x, *y)).collect();
        // An edge tells on both of its sides.
        let near = |x: usize, y: usize| [(x, y), (x.saturating_sub(1), y), (x, y.saturating_sub(1))];
        let tells = |(x, y): &(usize, usize)| near(*x, *y).iter().any(|(x, y)| detail[y * w + x] > FLAT);
        Self { size: (w, h), tells: places.iter().map(tells).collect(), windows, pixels, blur: Blur::NONE }
    }

    /// The camera of window `w` with `margin` px about it, where `camera` took the whole picture.
    pub(super) fn camera(&self, camera: &Camera, w: &Window, margin: usize) -> Camera {
        let mut part = camera.resized(self.size.0, self.size.1);
        let i = &mut part.intrinsics;
        i.cx += margin as f64 - w.x as f64;
        i.cy += margin as f64 - w.y as f64;
        (i.width, i.height) = (PART + 2 * margin, PART + 2 * margin);
        part
    }
}

/// Differences to the right and lower neighbours, root of the sum of squares, a pixel each.
fn detail(picture: &Picture) -> Vec<f32> {
    let (w, h) = (picture.width(), picture.height());
    let at = |x: usize, y: usize| {
        let (here, right, below) =
            (picture.pixel(x, y), picture.pixel((x + 1).min(w - 1), y), picture.pixel(x, (y + 1).min(h - 1)));
        (0..3).map(|c| (right[c] - here[c]).powi(2) + (below[c] - here[c]).powi(2)).sum::<f32>().sqrt()
    };
    (0..w * h).map(|i| at(i % w, i / w)).collect()
}

/// Of the parts in a cell the one with the largest sum; `None` where no part fits.
fn most_detailed(detail: &[f32], w: usize, across: Range<usize>, down: Range<usize>) -> Option<Window> {
    let sum = |x: usize, y: usize| -> f32 {
        (y..y + PART).map(|y| detail[y * w + x..y * w + x + PART].iter().sum::<f32>()).sum()
    };
    let (right, bottom) = (across.end.checked_sub(PART)?, down.end.checked_sub(PART)?);
    let at = |y: usize| (across.start..=right).step_by(PART / 2).map(move |x| Window { x, y });
    let windows = (down.start..=bottom).step_by(PART / 2).flat_map(at);
    windows.max_by(|a, b| sum(a.x, a.y).total_cmp(&sum(b.x, b.y)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(w: usize, h: usize) -> Picture {
        let at = |i: usize| {
            let (x, y) = (i % w, i / w);
            if x > w / 2 && (x + y) % 2 == 0 { 1.0 } else { x as f32 / w as f32 }
        };
        Picture::new(w, h, (0..w * h).flat_map(|i| [at(i); 3]).collect()).unwrap()
    }

    #[test]
    fn each_windows_pixels_are_in_their_order() {
        let picture = ramp(230, 180);
        let parts = Parts::of(&picture);
        assert_eq!(parts.size, (230, 180));
        assert_eq!(parts.pixels.len(), parts.windows.len() * PART * PART);
        let w = parts.windows[5];
        assert_eq!(parts.pixels[5 * PART * PART + PART + 2], picture.pixel(w.x + 2, w.y + 1));
        // Cells of 19 px: of the one that is chequered from 116 on, the part lies in that half.
        let mixed = parts.windows.iter().find(|w| (114..133).contains(&w.x)).unwrap();
        assert!(mixed.x >= 116, "{mixed:?}");
    }

    #[test]
    fn a_windows_camera_sees_what_the_whole_sees_there() {
        let intrinsics = cairn_scene::Intrinsics {
            width: 120,
            height: 90,
            fx: 100.0,
            fy: 100.0,
            cx: 58.0,
            cy: 46.0,
            distortion: cairn_scene::BrownConrady { k1: 0.05, ..Default::default() }.into(),
        };
        let pose = cairn_scene::Pose::look_at(glam::DVec3::X, glam::DVec3::ZERO, glam::DVec3::Z).unwrap();
        let camera = Camera { intrinsics, pose };
        let parts = Parts::of(&ramp(120, 90));
        let w = parts.windows[3];
        let part = parts.camera(&camera, &w, 2);
        assert_eq!((part.intrinsics.width, part.intrinsics.height), (PART + 4, PART + 4));
        let (x, y) = (3.5, 5.5);
        let whole = camera.direction(w.x as f64 + x, w.y as f64 + y);
        assert!((part.direction(x + 2.0, y + 2.0) - whole).length() < 1e-9);
    }
}
