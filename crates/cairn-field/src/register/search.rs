//! Where to begin: a picture, turned and cut in many ways, laid over small renders of the
//! training views. Likeness is normalised correlation, so that neither brightness nor contrast count.

use super::windows::Level;
use crate::appearance::code::Appearance;
use crate::field::model::Field;
use crate::rays::lens::{Eye, Lens};
use cairn_scene::{Camera, Picture};
use glam::{DMat2, DMat3, DVec2};
use rayon::prelude::*;

/// Longest side of the small renders, px.
pub(super) const SIDE: usize = 20;
/// Turns that are tried either way, degrees.
const TURNS: [f64; 9] = [0.0, -7.5, 7.5, -15.0, 15.0, -22.5, 22.5, -30.0, 30.0];
/// Shares of a view's sides that the picture may show.
const KEPT: [f64; 5] = [1.0, 0.9, 0.8, 0.7, 0.6];
/// Smallest number of a small render's pixels that are compared.
const MIN_COMPARED: usize = 60;

/// A training view, rendered small.
#[derive(Debug)]
pub(super) struct Thumbnail {
    camera: Camera,
    small: Picture,
}

/// A place to begin at.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) camera: Camera,
    likeness: f64,
}

impl Thumbnail {
    pub(super) fn of(field: &Field, camera: &Camera, appearance: &Appearance) -> Self {
        let i = &camera.intrinsics;
        let side = |s: usize| ((s * SIDE) as f64 / i.width.max(i.height) as f64).round().max(1.0) as usize;
        let (w, h) = (side(i.width), side(i.height));
        let nine = camera.resized(3 * w, 3 * h);
        let colours = field.features_of(Eye { camera: &nine, lens: &Lens::new(&nine) }, 3);
        let rgb = colours.iter().flat_map(|f| appearance.shade(f).map(|v| v.clamp(0.0, 1.0))).collect();
        let small = Picture::new(w, h, rgb).expect("one colour a pixel");
        Self { camera: *camera, small }
    }
}

/// How far off a middle, px of the small render.
#[derive(Clone, Copy)]
struct Offset {
    x: i32,
    y: i32,
}

/// A picture turned back and made smaller, as it lies over a small render when their middles meet.
struct Variant {
    /// Turn and share of the view's sides.
    turn: f64,
    kept: f64,
    /// Offsets from the middle, and the colours there.
    colours: Vec<(Offset, [f32; 3])>,
}

/// The `count` likeliest places, the likeliest first, at most two of one view.
pub(super) fn candidates(thumbnails: &[Thumbnail], picture: &Picture, count: usize) -> Vec<Candidate> {
    let level = Level::whole(picture, 4 * SIDE);
    let (w, h) = level.size;
    let soft = Picture::new(w, h, level.pixels.into_flattened()).expect("one colour a pixel");
    let variants: Vec<Variant> =
        TURNS.iter().flat_map(|turn| KEPT.map(|kept| Variant::of(&soft, *turn, kept))).collect();
    let of = |thumbnail: &Thumbnail| {
        let mut found: Vec<(f64, &Variant, Offset)> = Vec::new();
        for variant in &variants {
            let room = |side: usize| ((side as f64 * (1.0 - variant.kept) / 2.0).round() as i32).max(1);
            let (across, down) = (room(thumbnail.small.width()), room(thumbnail.small.height()));
            let offsets = (-down..=down).flat_map(|y| (-across..=across).map(move |x| Offset { x, y }));
            let likeness = |at| (variant.likeness(&thumbnail.small, at), variant, at);
            found.extend(offsets.map(likeness).max_by(|a, b| a.0.total_cmp(&b.0)));
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.truncate(2);
        let candidate = |(likeness, variant, at): (f64, &Variant, Offset)| Candidate {
            camera: variant.camera(thumbnail, at, picture.width(), picture.height()),
            likeness,
        };
        found.into_iter().map(candidate).collect::<Vec<_>>()
    };
    let mut all: Vec<Candidate> = thumbnails.par_iter().flat_map_iter(of).collect();
    all.sort_by(|a, b| b.likeness.total_cmp(&a.likeness));
    all.truncate(count);
    all
}

impl Variant {
    fn of(picture: &Picture, turn: f64, kept: f64) -> Self {
        let (w, h) = (picture.width(), picture.height());
        let scale = scale(kept, w.max(h));
        let back = DMat2::from_angle(-turn.to_radians());
        let middle = DVec2::new(w as f64, h as f64) / 2.0;
        let reach = (SIDE as f64 * 0.75) as i32;
        let mut colours = Vec::new();
        for y in -reach..reach {
            for x in -reach..reach {
                // From a small pixel's middle, by way of the turn, to the picture's pixels.
                let off = back * (DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) / scale);
                // A turned picture has black corners: what lies within the ellipse has none.
                let within = (off / middle).length() < 1.0 || turn == 0.0;
                let at = middle + off;
                if within && at.x >= 0.0 && at.y >= 0.0 && at.x < w as f64 && at.y < h as f64 {
                    colours.push((Offset { x, y }, picture.pixel(at.x as usize, at.y as usize)));
                }
            }
        }
        Self { turn, kept, colours }
    }

    /// Normalised correlation with a small render, the picture's middle `at` off the render's; -1 where too little
    /// of it lies over the render, or nothing is to be seen.
    fn likeness(&self, small: &Picture, at: Offset) -> f64 {
        let (w, h) = (small.width() as i32, small.height() as i32);
        let (left, top) = (w / 2 + at.x, h / 2 + at.y);
        let (mut n, mut sums) = (0usize, [[0.0f64; 2]; 3]);
        let (mut aa, mut bb, mut ab) = (0.0f64, 0.0f64, 0.0f64);
        for (Offset { x, y }, a) in &self.colours {
            let (x, y) = (x + left, y + top);
            if x < 0 || y < 0 || x >= w || y >= h {
                continue;
            }
            let b = small.pixel(x as usize, y as usize);
            n += 1;
            for c in 0..3 {
                let (a, b) = (f64::from(a[c]), f64::from(b[c]));
                sums[c][0] += a;
                sums[c][1] += b;
                (aa, bb, ab) = (aa + a * a, bb + b * b, ab + a * b);
            }
        }
        // What hangs over the edge was not in the view.
        if n < MIN_COMPARED || 5 * n < 4 * self.colours.len() {
            return -1.0;
        }
        let share = 1.0 / n as f64;
        for [a, b] in sums {
            (aa, bb, ab) = (aa - a * a * share, bb - b * b * share, ab - a * b * share);
        }
        if aa > 1e-6 && bb > 1e-6 { ab / (aa * bb).sqrt() } else { -1.0 }
    }

    /// The camera that took a picture of `width x height` px, if it lies so over the view's render.
    fn camera(&self, thumbnail: &Thumbnail, at: Offset, width: usize, height: usize) -> Camera {
        let view = &thumbnail.camera;
        let (w, h) = (thumbnail.small.width(), thumbnail.small.height());
        let small = view.intrinsics.resized(w, h);
        // Pixels of the picture for one of the small render.
        let larger = 1.0 / scale(self.kept, width.max(height));
        let turn = DMat2::from_angle(-self.turn.to_radians());
        let (half_w, half_h) = ((w / 2) as f64 + f64::from(at.x), (h / 2) as f64 + f64::from(at.y));
        let middle = turn * (DVec2::new(small.cx - half_w, small.cy - half_h) * larger);
        let mut camera = *view;
        camera.intrinsics = cairn_scene::Intrinsics {
            width,
            height,
            fx: small.fx * larger,
            fy: small.fy * larger,
            cx: width as f64 / 2.0 + middle.x,
            cy: height as f64 / 2.0 + middle.y,
            distortion: view.intrinsics.distortion,
        };
        // What the view saw along d the picture shows along the turned d.
        camera.pose.rotation = view.pose.rotation * DMat3::from_rotation_z(self.turn.to_radians());
        camera
    }
}

/// Pixels of a small render for one of a picture `longest_px` long that shows `kept` of a view's sides.
fn scale(kept: f64, longest_px: usize) -> f64 {
    kept * SIDE as f64 / longest_px as f64
}
