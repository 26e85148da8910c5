//! How far apart two cameras are, without a unit: a capture's unit is arbitrary
//! (COLMAP's certainly is), so positions are measured in the capture's own spread.

use crate::cameras::pose::Pose;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Distances are rounded to multiples of 2^-24 (6e-8 of the capture's spread).
/// Two distances that are equal on paper then are equal in floating point too,
/// in whatever unit and axes the scene is given, and ties can go by index.
const STEPS: f64 = (1u32 << 24) as f64;

/// Cameras that spread less than this share of their distance from the
/// coordinate origin stand in one place: rounding noise is no measure.
const COINCIDENT: f64 = 1e-9;

/// A scale-free distance between poses:
/// `d^2 = |p - q|^2 / spread^2 + direction_weight * chord^2`, where `spread` is
/// the root mean square distance of the camera centres from their centroid and
/// `chord = 2 sin(angle / 2)`, in [0, 2], lies between the viewing directions.
/// Roll about the viewing direction does not count: it shows the same things.
///
/// The distance does not change when the scene is scaled or turned, nor when it
/// is moved by up to 1e6 times its spread (beyond about 1e9 the positions' own
/// rounding hides the spread, and the cameras count as standing in one place).
/// Where all cameras stand in one place there is no unit of length, and only
/// directions count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseMetric {
    /// The unit of position, in the capture's unit; 0 where all cameras coincide.
    spread: f64,
    /// Weight of the squared chord between viewing directions, at least 0.
    direction_weight: f64,
}

impl PoseMetric {
    /// The metric of a capture with these `poses`. `direction_weight` is at
    /// least 0 and finite; the poses are finite, as [`Pose::new`] makes them.
    pub fn new(poses: &[Pose], direction_weight: f64) -> Self {
        Self { spread: spread(poses), direction_weight }
    }

    /// The unit of position: root mean square distance of the camera centres
    /// from their centroid, in the capture's unit; 0 where all coincide.
    pub fn spread(&self) -> f64 {
        self.spread
    }

    /// The weight of the squared chord between viewing directions.
    pub fn direction_weight(&self) -> f64 {
        self.direction_weight
    }

    /// The distance between two poses, dimensionless, at least 0, rounded to a
    /// multiple of 2^-24; symmetric, and 0 for the same pose.
    pub fn distance(&self, a: &Pose, b: &Pose) -> f64 {
        let apart = if self.spread > 0.0 { ((a.position - b.position) / self.spread).length_squared() } else { 0.0 };
        let chord = (a.forward() - b.forward()).length_squared();
        ((apart + self.direction_weight * chord).sqrt() * STEPS).round() / STEPS
    }

    /// Whether the stored numbers can be a metric's.
    pub(crate) fn is_valid(&self) -> bool {
        [self.spread, self.direction_weight].iter().all(|v| v.is_finite() && *v >= 0.0)
    }
}

fn spread(poses: &[Pose]) -> f64 {
    let Some(first) = poses.first() else { return 0.0 };
    // Relative to one of them: far from the origin a plain mean loses digits,
    // and coincident cameras come out as exactly 0.
    let offsets = poses.iter().map(|p| p.position - first.position);
    let count = poses.len() as f64;
    let largest = offsets.clone().fold(0.0f64, |m, o| m.max(o.abs().max_element()));
    let origin = poses.iter().fold(0.0f64, |m, p| m.max(p.position.abs().max_element()));
    if largest <= COINCIDENT * origin {
        return 0.0;
    }
    let centroid = offsets.clone().map(|o| o / largest).sum::<DVec3>() / count;
    let mean_square = offsets.map(|o| (o / largest - centroid).length_squared()).sum::<f64>() / count;
    largest * mean_square.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looking(position: DVec3, towards: DVec3) -> Pose {
        Pose::look_at(position, position + towards, DVec3::Y).unwrap()
    }

    #[test]
    fn a_known_distance() {
        // Centres at -1 and 1: centroid 0, spread 1; directions 90 degrees apart: chord sqrt(2).
        let a = looking(DVec3::new(-1.0, 0.0, 0.0), DVec3::Z);
        let b = looking(DVec3::new(1.0, 0.0, 0.0), DVec3::X);
        let metric = PoseMetric::new(&[a, b], 0.5);
        assert!((metric.spread() - 1.0).abs() < 1e-15);
        assert!((metric.distance(&a, &b) - (4.0f64 + 0.5 * 2.0).sqrt()).abs() < 1e-7);
        assert_eq!(metric.distance(&a, &b), metric.distance(&b, &a));
        assert_eq!(metric.distance(&a, &a), 0.0);
    }

    #[test]
    fn one_place_counts_directions_only() {
        let at = DVec3::new(0.1, 0.2, 0.3) * 1e6;
        let poses = [looking(at, DVec3::Z), looking(at + DVec3::splat(1e-5), DVec3::X)];
        let metric = PoseMetric::new(&poses, 1.0);
        assert_eq!(metric.spread(), 0.0);
        assert!((metric.distance(&poses[0], &poses[1]) - 2.0f64.sqrt()).abs() < 1e-7);
    }

    #[test]
    fn tiny_and_huge_units_neither_vanish_nor_overflow() {
        for unit in [1e-200, 1.0, 1e200] {
            let poses = [looking(DVec3::X * unit, DVec3::Z), looking(-DVec3::X * unit, DVec3::Z)];
            let metric = PoseMetric::new(&poses, 1.0);
            assert!((metric.distance(&poses[0], &poses[1]) - 2.0).abs() < 1e-7, "unit {unit}");
        }
    }
}
