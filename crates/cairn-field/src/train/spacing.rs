//! How far apart views look, and how cautious training is for it. Where photographs look in
//! much the same direction they hold one another to one shape. Where every place is seen from two or three
//! sides only, many shapes explain all photographs, most of them clouds before
//! the cameras, in a colour of their own from each side: then neighbouring voxels have to agree more, and
//! colour may depend less on where it is seen from.
//!
//! Angles between optical axes are all that counts. Cameras side by side that look one way
//! (forward-facing captures, drones above a roof) overlap as far as their baseline lets them and keep the
//! settings as they are.

use crate::config::FieldConfig;
use crate::stats::median;
use cairn_scene::Camera;
use rayon::prelude::*;

/// Smoothness is made so many times as strong at most: beyond, it wore shapes away.
const MAX_SMOOTHING: f64 = 16.0;
/// Views that look less than this apart are one to it: bursts and exposure brackets.
const SAME_DEG: f64 = 2.0;

/// How far apart the views look, and what is made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spacing {
    /// Median over the views (of an even number the larger middle one) of the angle between a view's
    /// optical axis and the second nearest other one's (on a ring: the neighbours' on both sides), those
    /// within two degrees left out; degrees, 0 to 180.
    pub apart_deg: f64,
    /// The pulls of neighbours weigh this many times as much, and colours learn to depend on the
    /// direction this many times as slowly; 1 to 16.
    pub smoothing: f64,
}

impl Spacing {
    /// That of `cameras` under `config` ([`FieldConfig::smoother_beyond_deg`]); 0 degrees without cameras.
    pub fn of(cameras: &[Camera], config: &FieldConfig) -> Self {
        let apart_deg = apart_deg(cameras);
        let smoothing = (apart_deg / config.smoother_beyond_deg).powi(2).clamp(1.0, MAX_SMOOTHING);
        Self { apart_deg, smoothing }
    }
}

/// See [`Spacing::apart_deg`]; of two directions the one other, of one 0.
fn apart_deg(cameras: &[Camera]) -> f64 {
    let axes: Vec<_> = cameras.iter().map(|c| c.pose.rotation.z_axis).collect();
    let same = SAME_DEG.to_radians().cos();
    let second = |axis: &glam::DVec3| {
        let (mut first, mut second) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for cosine in axes.iter().map(|other| axis.dot(*other)).filter(|cosine| *cosine < same) {
            (first, second) = if cosine > first { (cosine, first) } else { (first, second.max(cosine)) };
        }
        let cosine = if second.is_finite() { second } else { first };
        if cosine.is_finite() { cosine.clamp(-1.0, 1.0).acos().to_degrees() } else { 0.0 }
    };
    median(axes.par_iter().map(second).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Distortion, Intrinsics, Pose};
    use glam::DVec3;

    /// Cameras that look at the origin from so many degrees.
    fn ring(degrees: &[f64]) -> Vec<Camera> {
        let intrinsics =
            Intrinsics { width: 8, height: 8, fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0, distortion: Distortion::default() };
        let at = |d: &f64| DVec3::new(d.to_radians().cos(), d.to_radians().sin(), 0.0) * 3.0;
        let pose = |d: &f64| Pose::look_at(at(d), DVec3::ZERO, DVec3::Z).unwrap();
        degrees.iter().map(|d| Camera { intrinsics, pose: pose(d) }).collect()
    }

    fn spacing(degrees: &[f64]) -> Spacing {
        Spacing::of(&ring(degrees), &FieldConfig { smoother_beyond_deg: 14.0, ..FieldConfig::default() })
    }

    #[test]
    fn a_ring_is_as_far_apart_as_its_neighbours_are() {
        for (views, apart, smoothing) in [(9, 40.0, 8.163), (36, 10.0, 1.0), (4, 90.0, 16.0)] {
            let degrees: Vec<f64> = (0..views).map(|i| 360.0 / f64::from(views) * f64::from(i)).collect();
            let found = spacing(&degrees);
            assert!((found.apart_deg - apart).abs() < 1e-6, "{views} views: {found:?}");
            assert!((found.smoothing - smoothing).abs() < 1e-3, "{views} views: {found:?}");
        }
    }

    #[test]
    fn photographs_from_one_place_count_as_one() {
        for burst in [2, 3, 5] {
            let shot = |i: i32| (0..burst).map(move |k| 45.0 * f64::from(i) + 0.3 * f64::from(k));
            let found = spacing(&(0..8).flat_map(shot).collect::<Vec<f64>>());
            assert!((found.apart_deg - 45.0).abs() < 1.5, "{burst} from each place: {found:?}");
        }
    }

    #[test]
    fn one_view_and_two_have_a_spacing() {
        assert_eq!(spacing(&[]), Spacing { apart_deg: 0.0, smoothing: 1.0 });
        assert_eq!(spacing(&[10.0]), Spacing { apart_deg: 0.0, smoothing: 1.0 });
        assert!((spacing(&[0.0, 21.0]).smoothing - 2.25).abs() < 1e-6);
        assert_eq!(spacing(&[7.0; 5]).smoothing, 1.0);
    }
}
