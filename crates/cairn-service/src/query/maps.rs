//! Accumulation and depth of a view, and how they become pictures: grey PNGs of 16
//! bits to measure in, and depth in colours to look at.
//!
//! The field tells a pixel's depth in its own cube, where far away is drawn
//! together; here it becomes capture units along the camera's optical axis. Marks and
//! appearance change colours and never geometry, so both fields have the same maps.

use cairn_field::{Rendering, SceneFrame, distance};
use cairn_scene::{Camera, Picture, encode_grey16};
use rayon::prelude::*;

use crate::query::crowd;

/// A pixel whose accumulation is below this has no depth: too little stopped the
/// light there for a mean distance to say anything.
pub const LEAST_ACCUMULATION: f32 = 0.1;
/// The depth map's scale reaches this often as deep as the median pixel, at most.
const DEEPEST: f64 = 16.0;
/// Share of pixels that the colours leave out at either end.
const COLOUR_TAILS: f64 = 0.02;
/// Squares that stand for "no depth" in the coloured map, px.
const CHECK_PX: usize = 6;
/// Their two greys; none of the colours is grey.
const CHECKS: [f32; 2] = [0.32, 0.42];
/// Nine colours evenly apart on matplotlib's viridis (CC0): equal steps look equal,
/// in grey and to colour-blind readers, too.
const VIRIDIS: [u32; 9] = [0x440154, 0x472d7b, 0x3b528b, 0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725];

/// What lies behind a picture's colours, a pixel each, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Share of light that the field stops, 0 to 1.
    pub accumulation: Vec<f32>,
    /// Depth along the optical axis, capture units, above 0; 0 for none
    /// (accumulation below [`LEAST_ACCUMULATION`], or a fisheye's pixel 90 degrees and more off the axis).
    pub depth: Vec<f32>,
}

/// A depth map as a file.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPng {
    /// 16-bit grey PNG; 0 is no depth, 65535 as deep as that or deeper.
    pub png: Vec<u8>,
    /// Capture units a grey value; 0 where no pixel has a depth.
    pub unit: f64,
}

impl Maps {
    /// The maps of what `camera` saw in a field with this frame.
    pub fn new(frame: &SceneFrame, camera: &Camera, seen: &Rendering) -> Self {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let forward = camera.pose.forward();
        let depth = (0..width * height).into_par_iter().map(|at| {
            if seen.accumulation[at] < LEAST_ACCUMULATION {
                return 0.0;
            }
            let (origin, direction) = camera.ray((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
            let ahead = direction.dot(forward);
            // What a fisheye sees beside itself and behind has no depth along its axis.
            if ahead <= 0.0 {
                return 0.0;
            }
            let away = distance(frame, origin, direction, f64::from(seen.depth[at]));
            away.map_or(0.0, |t| (t * ahead).max(f64::from(f32::MIN_POSITIVE)) as f32)
        });
        Self { width, height, accumulation: seen.accumulation.clone(), depth: depth.collect() }
    }

    /// Accumulation as a 16-bit grey PNG: 0 is nothing, 65535 everything stopped.
    pub fn accumulation_png(&self) -> Vec<u8> {
        let values: Vec<u16> =
            self.accumulation.iter().map(|a| (a.clamp(0.0, 1.0) * 65_535.0).round() as u16).collect();
        let said = "Accumulation: the share of light that the field stops; 65535 = all of it";
        encode_grey16(self.width, self.height, &values, said)
    }

    /// Depth as a 16-bit grey PNG. Its unit is chosen for the deepest pixel, or for
    /// sixteen times the median where some are deeper; it is also said in the file,
    /// as its PNG `Description`.
    pub fn depth_png(&self) -> DepthPng {
        let there = || self.depth.iter().filter(|d| **d > 0.0).map(|d| f64::from(*d));
        let deepest = there().fold(0.0, f64::max);
        let reach = crowd::quantile(there(), 0.5).map_or(0.0, |median| deepest.min(median * DEEPEST));
        let unit = reach / 65_535.0;
        let value = |d: &f32| match *d > 0.0 {
            true => (f64::from(*d) / unit).round().clamp(1.0, 65_535.0) as u16,
            false => 0,
        };
        let values: Vec<u16> = self.depth.iter().map(value).collect();
        let said = format!(
            "Depth along the optical axis: grey value x {unit:e} capture units; 0 = no depth, 65535 = that deep or deeper"
        );
        DepthPng { png: encode_grey16(self.width, self.height, &values, &said), unit }
    }

    /// Depth for people: near is yellow, far is violet, evenly in inverse depth. The
    /// colours fade into a grey chequer the less light was stopped; where there is
    /// no depth the chequer is all.
    pub fn depth_in_colours(&self) -> Picture {
        let pixels = || self.depth.iter().zip(&self.accumulation).filter(|(d, _)| **d > 0.0);
        let firm = pixels().any(|(_, a)| certainty(*a) >= 0.5);
        let told = || pixels().filter(move |(_, a)| !firm || certainty(**a) >= 0.5);
        let inverse = || told().map(|(d, _)| 1.0 / f64::from(*d));
        let far = crowd::quantile(inverse(), COLOUR_TAILS).unwrap_or(0.0);
        let near = crowd::quantile(inverse(), 1.0 - COLOUR_TAILS).unwrap_or(0.0);
        let mut picture = Picture::constant(self.width, self.height, [0.0; 3]);
        for (at, pixel) in picture.rgb_mut().chunks_exact_mut(3).enumerate() {
            let (x, y) = (at % self.width / CHECK_PX, at / self.width / CHECK_PX);
            let (depth, grey) = (self.depth[at], CHECKS[(x + y) % 2]);
            let share = (1.0 / f64::from(depth) - far) / (near - far);
            let colour = viridis(if share.is_finite() { share } else { 1.0 });
            let strength = if depth > 0.0 { certainty(self.accumulation[at]) } else { 0.0 };
            for (value, colour) in pixel.iter_mut().zip(colour) {
                *value = grey + (colour - grey) * strength;
            }
        }
        picture
    }
}

/// How strongly a pixel shows its depth: not at all below [`LEAST_ACCUMULATION`],
/// fully from half of the light on.
fn certainty(accumulation: f32) -> f32 {
    ((accumulation - LEAST_ACCUMULATION) / (0.5 - LEAST_ACCUMULATION)).clamp(0.0, 1.0)
}

/// From 0 (violet) over blue and green to 1 (yellow); clamped.
fn viridis(share: f64) -> [f32; 3] {
    let at = share.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let low = (at as usize).min(VIRIDIS.len() - 2);
    let part = (at - low as f64) as f32;
    std::array::from_fn(|c| {
        let of = |i: usize| (VIRIDIS[i] >> (16 - 8 * c) & 255) as f32 / 255.0;
        of(low) + (of(low + 1) - of(low)) * part
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Distortion, Fisheye, Intrinsics, Limits, Pose, decode_picture};
    use glam::DVec3;

    fn maps(depth: Vec<f32>) -> Maps {
        Maps { width: depth.len(), height: 1, accumulation: vec![0.5; depth.len()], depth }
    }

    #[test]
    fn thin_pixels_have_no_depth_and_the_others_lie_on_the_axis() {
        let distortion = Distortion::default();
        let intrinsics = Intrinsics { width: 3, height: 1, fx: 2.0, fy: 2.0, cx: 1.5, cy: 0.5, distortion };
        let camera = Camera { intrinsics, pose: Pose::look_at(DVec3::ZERO, DVec3::Z, DVec3::Y).unwrap() };
        let frame = SceneFrame::Bounded { centre: DVec3::Z * 5.0, half: DVec3::splat(4.0) };
        let picture = Picture::constant(3, 1, [0.0; 3]);
        // The box begins at depth 1; 3 of its 8 units are travelled.
        let seen = Rendering { picture, accumulation: vec![0.9, 0.9, 0.05], depth: vec![0.375; 3] };
        let maps = Maps::new(&frame, &camera, &seen);
        assert!((maps.depth[1] - 4.0).abs() < 1e-5 && maps.depth[2] == 0.0, "{:?}", maps.depth);
        // Off the axis the ray is longer than it is deep: half a unit aside for each ahead.
        let slope = 1.25f32.sqrt();
        assert!((maps.depth[0] - (1.0 + 3.0 / slope)).abs() < 1e-5, "{:?}", maps.depth);
    }

    #[test]
    fn what_a_fisheye_sees_beside_itself_and_behind_has_no_depth() {
        let distortion = Fisheye::new([0.0; 4]).into();
        // Pixels 0, 60 and 120 degrees off the axis.
        let focal = 3.0 / std::f64::consts::PI;
        let intrinsics = Intrinsics { width: 3, height: 1, fx: focal, fy: focal, cx: 0.5, cy: 0.5, distortion };
        let camera = Camera { intrinsics, pose: Pose::look_at(DVec3::ZERO, DVec3::Z, DVec3::Y).unwrap() };
        let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::splat(4.0) };
        let picture = Picture::constant(3, 1, [0.0; 3]);
        // 3 of the box's 8 units are travelled.
        let seen = Rendering { picture, accumulation: vec![0.9; 3], depth: vec![0.375; 3] };
        let maps = Maps::new(&frame, &camera, &seen);
        assert!((maps.depth[0] - 3.0).abs() < 1e-5 && (maps.depth[1] - 1.5).abs() < 1e-5, "{:?}", maps.depth);
        assert_eq!(maps.depth[2], 0.0);
        assert_eq!(maps.accumulation[2], 0.9);
    }

    #[test]
    fn the_depth_png_comes_back_in_its_unit() {
        let written = maps(vec![0.0, 1.0, 2.5, 4.0, 1000.0]).depth_png();
        assert!((written.unit * 65_535.0 - 16.0 * 4.0).abs() < 1e-9, "sixteen medians, not a thousand units");
        let read = decode_picture(&written.png, &Limits::default(), None).unwrap();
        let value = |x: usize| f64::from(read.pixel(x, 0)[0]) * 65_535.0 * written.unit;
        assert_eq!(read.pixel(0, 0)[0], 0.0);
        for (x, depth) in [(1, 1.0), (2, 2.5), (3, 4.0)] {
            assert!((value(x) - depth).abs() <= written.unit, "{} for {depth}", value(x));
        }
        assert_eq!(read.pixel(4, 0)[0], 1.0, "deeper than the scale is its end");
        let nothing = maps(vec![0.0, 0.0]).depth_png();
        assert_eq!(nothing.unit, 0.0);
    }

    #[test]
    fn colours_run_from_near_yellow_to_far_violet_and_nothing_is_grey() {
        let picture = maps(vec![1.0, 2.0, 9.0, 0.0]).depth_in_colours();
        let [near, middle, far, none] = [0, 1, 2, 3].map(|x| picture.pixel(x, 0));
        assert!(near[0] > 0.9 && near[1] > 0.8 && near[2] < 0.3, "{near:?}");
        assert!(far[0] < 0.3 && far[1] < 0.1 && far[2] > 0.3, "{far:?}");
        assert!(middle != near && middle != far && none[0] == none[1] && none[1] == none[2]);
        // All at one depth: a colour, no NaN.
        assert!(maps(vec![3.0; 4]).depth_in_colours().rgb().iter().all(|v| v.is_finite()));
    }
}
