//! The pixels of a picture that are compared at one size: small parts with much to see, spread over a copy.

use crate::sizes::smaller;
use cairn_scene::{Camera, Picture};

/// A part of a copy, pixels of the copy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Window {
    /// Its pixels, row-major.
    fn places(self) -> impl Iterator<Item = (usize, usize)> {
        (self.y..self.y + self.height).flat_map(move |y| (self.x..self.x + self.width).map(move |x| (x, y)))
    }
}

/// What is compared at one size.
#[derive(Debug)]
pub(super) struct Level {
    /// The copy's size, px.
    pub(super) size: (usize, usize),
    /// Rays across and down a pixel: a small copy's pixels are means over many of the picture's.
    pub(super) rays: usize,
    pub(super) windows: Vec<Window>,
    /// The windows' pixels, one after another, row-major.
    pub(super) pixels: Vec<[f32; 3]>,
    /// Whether there is something to be seen at each of them: a picture's flat background fits everywhere.
    pub(super) tells: Vec<bool>,
}

/// Side of a part, px.
const PART: usize = 8;
/// Parts across the longer side.
const PARTS: usize = 12;
/// Largest number of rays across a pixel of a copy.
const MAX_RAYS: usize = 2;
/// Where neighbours differ by less (root of the sum of squares over channels, right and below), nothing is to be seen.
const FLAT: f32 = 0.01;

impl Level {
    /// Parts of a copy: of each cell of a lattice the one where most is to be seen.
    pub(super) fn of_parts(picture: &Picture, longest: usize) -> Self {
        let copy = smaller(picture, longest);
        let (w, h) = (copy.width(), copy.height());
        let cell = (w.max(h) / PARTS).max(PART);
        let (mut windows, detail) = (Vec::new(), detail(&copy));
        let seen = |window: &Window| window.places().any(|(x, y)| detail[y * w + x] > FLAT);
        for top in (0..h).step_by(cell) {
            for left in (0..w).step_by(cell) {
                let cell = Window { x: left, y: top, width: cell.min(w - left), height: cell.min(h - top) };
                windows.extend(most_detailed(&detail, w, cell).filter(seen));
            }
        }
        Self::of(copy, windows, rays_for(picture, w))
    }

    fn of(copy: Picture, windows: Vec<Window>, rays: usize) -> Self {
        let size = (copy.width(), copy.height());
        let places: Vec<(usize, usize)> = windows.iter().flat_map(|w| w.places()).collect();
        let pixels = places.iter().map(|(x, y)| copy.pixel(*x, *y)).collect();
        let detail = detail(&copy);
        // An edge tells on both of its sides.
        let near = |x: usize, y: usize| [(x, y), (x.saturating_sub(1), y), (x, y.saturating_sub(1))];
        let tells = |(x, y): &(usize, usize)| near(*x, *y).iter().any(|(x, y)| detail[y * size.0 + x] > FLAT);
        Self { size, rays, tells: places.iter().map(tells).collect(), windows, pixels }
    }

    /// The camera of window `w` of the copy, where `camera` took the whole picture; its pixels are the window's rays.
    pub(super) fn camera(&self, camera: &Camera, w: &Window) -> Camera {
        let mut part = camera.resized(self.size.0 * self.rays, self.size.1 * self.rays);
        let i = &mut part.intrinsics;
        i.cx -= (w.x * self.rays) as f64;
        i.cy -= (w.y * self.rays) as f64;
        (i.width, i.height) = (w.width * self.rays, w.height * self.rays);
        part
    }
}

/// Rays across a pixel of a copy `width` px wide: as many as it is smaller than the picture, within [`MAX_RAYS`].
fn rays_for(picture: &Picture, width: usize) -> usize {
    (picture.width() / width).clamp(1, MAX_RAYS)
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
fn most_detailed(detail: &[f32], w: usize, cell: Window) -> Option<Window> {
    let sum = |x: usize, y: usize| -> f32 {
        (y..y + PART).map(|y| detail[y * w + x..y * w + x + PART].iter().sum::<f32>()).sum()
    };
    let (right, bottom) = ((cell.x + cell.width).checked_sub(PART)?, (cell.y + cell.height).checked_sub(PART)?);
    let places =
        (cell.y..=bottom).step_by(PART / 2).flat_map(|y| (cell.x..=right).step_by(PART / 2).map(move |x| (x, y)));
    let best = places.max_by(|a, b| sum(a.0, a.1).total_cmp(&sum(b.0, b.1)))?;
    Some(Window { x: best.0, y: best.1, width: PART, height: PART })
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
    fn a_level_has_each_windows_pixels_in_their_order() {
        let picture = ramp(120, 90);
        let small = Level::of_parts(&picture, 30);
        assert_eq!((small.size, small.rays), ((30, 23), 2));
        let parts = Level::of_parts(&picture, 800);
        assert_eq!((parts.size, parts.rays), ((120, 90), 1));
        assert_eq!(parts.pixels.len(), parts.windows.len() * PART * PART);
        let w = parts.windows[5];
        assert_eq!(parts.pixels[5 * PART * PART + PART + 2], picture.pixel(w.x + 2, w.y + 1));
        // Cells of 15 px: where half of one is chequered, the part lies in that half.
        let mixed = parts.windows.iter().find(|w| (45..75).contains(&w.x)).unwrap();
        assert!(mixed.x + PART <= 60 || mixed.x >= 60);
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
        let level = Level::of_parts(&ramp(120, 90), 60);
        let w = level.windows[3];
        let part = level.camera(&camera, &w);
        // Two rays a pixel of a copy half as large: one for each pixel of the picture.
        let (x, y) = (3.5, 5.5);
        let whole = camera.direction(2.0 * w.x as f64 + x, 2.0 * w.y as f64 + y);
        assert!((part.direction(x, y) - whole).length() < 1e-9);
    }
}
