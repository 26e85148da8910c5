//! How far along a ray the cube's own distance is in the world.

use super::frame::{RayPath, SceneFrame, contract};
use glam::DVec3;

/// A step through contracted space, unit-cube lengths.
const STEP: f64 = 1.0 / 64.0;
/// Where contracted space ends for depth, in half sides of the inner box.
const FARTHEST: f64 = 1e4;

/// Capture units from `origin` along `direction` (unit length) to where a ray has
/// travelled `along` unit-cube lengths; `None` for one that never enters the cube.
pub fn distance(frame: &SceneFrame, origin: DVec3, direction: DVec3, along: f64) -> Option<f64> {
    // The cube's sides count as long as the box's: voxels are cubes.
    let sides = DVec3::from_array(frame.proportions());
    match (frame.path(origin, direction), frame) {
        (RayPath::Miss, _) => None,
        (RayPath::Straight { origin: a, direction: d, start, end }, _) => {
            let (a, d) = (DVec3::from_array(a), DVec3::from_array(d));
            let t = (start + along / (d * sides).length()).min(end);
            let SceneFrame::ForwardFacing { rotation, position, near, .. } = frame else { return Some(t) };
            // z of the cube is 1 - near / depth; its end is infinitely far.
            let depth = near / (1.0 - (a + d * t).z).max(1.0 / FARTHEST);
            let (o, d) = (*rotation * (origin - *position), *rotation * direction);
            Some((depth - o.z) / d.z)
        }
        (RayPath::Contracted { origin: a, direction: d }, SceneFrame::Unbounded { half, .. }) => {
            let (a, d) = (DVec3::from_array(a), DVec3::from_array(d));
            Some(contracted(a, d, sides * 0.25, along) / (direction / *half).abs().max_element())
        }
        (RayPath::Contracted { .. }, _) => None,
    }
}

/// The t at which `a + t d`, contracted and scaled by `sides`, has travelled `along`.
fn contracted(a: DVec3, d: DVec3, sides: DVec3, along: f64) -> f64 {
    let place = |t: f64| contract(a + d * t) * sides;
    let inner_speed = (d * sides).length();
    let (mut t, mut left) = (0.0, along);
    loop {
        let x = a + d * t;
        let n = x.abs().max_element();
        if n < 1.0 {
            // Straight as far as the inner box goes.
            let out = |k: usize| if d[k] == 0.0 { f64::INFINITY } else { (d[k].signum() - x[k]) / d[k] };
            let room = out(0).min(out(1)).min(out(2)).max(1e-9);
            if left <= room * inner_speed {
                return t + left / inner_speed;
            }
            left -= room * inner_speed;
            t += room;
            continue;
        }
        if n > FARTHEST {
            return t;
        }
        // Far out a step of the cube is n * n as long; a tenth of the way is short enough to be straight.
        let step = (STEP * n * n / inner_speed).min(0.1 * n);
        let length = (place(t + step) - place(t)).length();
        if left <= length {
            return t + step * left / length;
        }
        left -= length;
        t += step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    /// How far the field says that the point at distance `t` is, the slow way.
    fn travelled(frame: &SceneFrame, origin: DVec3, direction: DVec3, t: f64) -> f64 {
        let sides = DVec3::from_array(frame.proportions());
        let inside = |p: DVec3| p.cmpge(DVec3::ZERO).all() && p.cmple(DVec3::ONE).all();
        let steps = 200_000;
        let at = |i: usize| frame.unit(origin + direction * (t * i as f64 / steps as f64));
        let length = |i: usize| match (at(i), at(i + 1)) {
            (Some(a), Some(b)) if inside(a) && inside(b) => ((b - a) * sides).length(),
            _ => 0.0,
        };
        (0..steps).map(length).sum()
    }

    #[test]
    fn a_distance_in_the_cube_becomes_one_in_the_world() {
        let direction = DVec3::new(0.3, -0.2, 1.0).normalize();
        let (low, high) = ([-1.0, -0.8], [1.2, 0.7]);
        let forward = SceneFrame::ForwardFacing {
            rotation: DMat3::from_rotation_y(0.05),
            position: DVec3::new(0.1, 0.0, -0.2),
            near: 2.0,
            low,
            high,
        };
        let half = DVec3::new(2.0, 1.0, 3.0);
        let bounded = SceneFrame::Bounded { centre: DVec3::new(0.5, -1.0, 6.0), half };
        let unbounded = SceneFrame::Unbounded { centre: DVec3::new(0.5, -1.0, 6.0), half };
        for frame in [forward, bounded, unbounded] {
            for wanted in [4.0, 6.5, 8.0, 30.0] {
                if matches!(frame, SceneFrame::Bounded { .. }) && wanted > 9.0 {
                    continue;
                }
                let along = travelled(&frame, DVec3::ZERO, direction, wanted);
                let got = distance(&frame, DVec3::ZERO, direction, along).unwrap();
                assert!((got / wanted - 1.0).abs() < 5e-3, "{frame:?}: {got} for {wanted}");
            }
        }
        let behind = SceneFrame::Bounded { centre: DVec3::new(0.0, 0.0, -9.0), half };
        assert_eq!(distance(&behind, DVec3::ZERO, direction, 0.1), None);
        // Longer than any ray: an end all the same.
        let frame = SceneFrame::Unbounded { centre: DVec3::ZERO, half };
        assert!(distance(&frame, DVec3::splat(400.0), direction, 50.0).unwrap().is_finite());
    }
}
