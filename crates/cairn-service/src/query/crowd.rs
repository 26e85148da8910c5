//! What a crowd of cameras has in common: which way is up for them, how far they
//! spread and along which directions. Pure geometry, for paths and plans.

use cairn_scene::Pose;
use glam::{DMat3, DVec3};

/// Least length of the mean of unit vectors that still counts as a direction.
const LEAST_AGREEMENT: f64 = 0.2;

/// Up, unit length: photographers hold cameras level, so up is what stands most
/// upright on all cameras' right-hand directions. Where these name no plane
/// (everybody looks the same way) it is the mean of the cameras' own ups; `None`
/// where those cancel out as well, or there is no pose.
pub fn up(poses: &[Pose]) -> Option<DVec3> {
    let mean = mean(poses.iter().map(|p| -p.rotation.y_axis))?;
    let rights = poses.iter().map(|p| p.rotation.x_axis);
    let (spread, axes) = eigen(rights.fold(DMat3::ZERO, |m, r| m + outer(r)) * (1.0 / poses.len() as f64));
    let upright = if mean.length() >= LEAST_AGREEMENT { Some(mean.normalize()) } else { None };
    // Rights that lie in a plane, and in all of it, and not along one line.
    if spread[1] > 0.1 && spread[2] < 0.5 * spread[1] {
        // Cameras straight above agree on no up, but they all look down.
        let towards = match upright {
            Some(up) => up,
            None => -self::mean(poses.iter().map(Pose::forward))?,
        };
        let level = axes[2] * axes[2].dot(towards).signum();
        // Pictures that were taken upright and on the side spoil the plane, not the mean.
        if level.dot(towards) > if upright.is_some() { 0.7 } else { 0.1 } {
            return Some(level);
        }
    }
    upright
}

/// The mean; `None` of nothing or of numbers that are not finite.
pub fn mean(vectors: impl Iterator<Item = DVec3>) -> Option<DVec3> {
    let (sum, count) = vectors.fold((DVec3::ZERO, 0usize), |(s, n), v| (s + v, n + 1));
    (count > 0 && sum.is_finite()).then(|| sum / count as f64)
}

/// The value below which `share` (0 to 1) of the others lie; `None` of nothing.
/// Values that are not finite are left out.
pub fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let last = sorted.len().checked_sub(1)?;
    sorted.sort_by(f64::total_cmp);
    Some(sorted[(last as f64 * share.clamp(0.0, 1.0)).round() as usize])
}

/// Variances of `points` along their principal axes, largest first, and the axes:
/// unit length, at right angles. `None` of nothing.
pub fn principal_axes(points: &[DVec3]) -> Option<([f64; 3], [DVec3; 3])> {
    let middle = mean(points.iter().copied())?;
    let sum = points.iter().fold(DMat3::ZERO, |m, p| m + outer(*p - middle));
    Some(eigen(sum * (1.0 / points.len() as f64)))
}

/// Any unit vector at right angles to `v`, which must not be zero.
pub fn across(v: DVec3) -> DVec3 {
    v.normalize().any_orthonormal_vector()
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Eigenvalues, largest first, and eigenvectors of a symmetric matrix: Jacobi's
/// rotations, which keep the axes at right angles whatever the matrix.
fn eigen(m: DMat3) -> ([f64; 3], [DVec3; 3]) {
    let (mut a, mut axes) = (m.to_cols_array_2d(), DMat3::IDENTITY.to_cols_array_2d());
    for sweep in 0..60 {
        let (p, q) = [(0, 1), (0, 2), (1, 2)][sweep % 3];
        if a[p][q].abs() < 1e-300 {
            continue;
        }
        let angle = 0.5 * (2.0 * a[p][q]).atan2(a[p][p] - a[q][q]);
        let (sin, cos) = angle.sin_cos();
        for row in &mut a {
            (row[p], row[q]) = (cos * row[p] + sin * row[q], cos * row[q] - sin * row[p]);
        }
        for k in 0..3 {
            (a[p][k], a[q][k]) = (cos * a[p][k] + sin * a[q][k], cos * a[q][k] - sin * a[p][k]);
            (axes[p][k], axes[q][k]) = (cos * axes[p][k] + sin * axes[q][k], cos * axes[q][k] - sin * axes[p][k]);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| a[*j][*j].total_cmp(&a[*i][*i]));
    (order.map(|i| a[i][i]), order.map(|i| DVec3::from_array(axes[i])))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(tilt: f64) -> Vec<Pose> {
        let at = |i: i32| {
            let a = f64::from(i) * 0.5;
            Pose::look_at(DVec3::new(3.0 * a.cos(), tilt, 3.0 * a.sin()), DVec3::ZERO, DVec3::Y).unwrap()
        };
        (0..5).map(at).collect()
    }

    #[test]
    fn up_is_found_from_cameras_that_look_down_from_one_side() {
        // Their own ups lean towards the middle; their rights are level all the same.
        let up = up(&ring(2.5)).unwrap();
        assert!((up - DVec3::Y).length() < 1e-9, "{up}");
    }

    #[test]
    fn up_of_a_crowd_that_looks_one_way_and_of_one_that_looks_straight_down() {
        let same = |x: f64| Pose::look_at(DVec3::X * x, DVec3::new(x, 0.0, 5.0), DVec3::Y).unwrap();
        let found = up(&[same(0.0), same(1.0)]).unwrap();
        assert!((found - DVec3::Y).length() < 1e-9, "{found}");
        let down = |a: f64| Pose::look_at(DVec3::Y * 4.0, DVec3::ZERO, DVec3::new(a.cos(), 0.0, a.sin())).unwrap();
        let found = up(&[down(0.0), down(2.1), down(4.2)]).unwrap();
        assert!((found - DVec3::Y).length() < 1e-6, "{found}");
        assert_eq!(up(&[]), None);
    }

    #[test]
    fn principal_axes_are_those_of_the_points() {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.7);
        let points: Vec<DVec3> =
            (0..50).map(f64::from).map(|i| turn * DVec3::new(i.sin(), 5.0 * (i * 1.7).cos(), 0.1)).collect();
        let (variances, axes) = principal_axes(&points).unwrap();
        assert!(variances[0] > 10.0 * variances[1] && variances[2].abs() < 1e-9, "{variances:?}");
        assert!(axes[0].dot(turn * DVec3::Y).abs() > 0.999 && axes[2].dot(turn * DVec3::Z).abs() > 0.999);
        let of_one = principal_axes(&[DVec3::ONE]).unwrap();
        assert!(of_one.1.iter().all(|a| (a.length() - 1.0).abs() < 1e-12) && of_one.0 == [0.0; 3]);
    }

    #[test]
    fn quantiles_leave_out_what_is_no_number() {
        assert_eq!(quantile([3.0, f64::NAN, 1.0, 2.0].into_iter(), 0.5), Some(2.0));
        assert_eq!(quantile([f64::NAN].into_iter(), 0.5), None);
    }
}
