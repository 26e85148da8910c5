//! Intrinsics and pose together: rays out of a picture, and points into it.
//!
//! Distortion is honoured in the rays: a photograph is never resampled, so its pixels (and what they are worth as
//! evidence) stay as the contributor took them.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::cameras::intrinsics::Intrinsics;
use crate::cameras::pose::Pose;

/// Intrinsics and pose together: everything needed to shoot a ray.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Size, focal lengths, lens.
    pub intrinsics: Intrinsics,
    /// Camera to world.
    pub pose: Pose,
}

impl Camera {
    /// The ray through image point (`x`, `y`), in pixels from the top left
    /// corner (pixel `i`'s centre is `i + 0.5`): its origin and its direction,
    /// unit length, in the world. Lens distortion is taken out.
    pub fn ray(&self, x: f64, y: f64) -> (DVec3, DVec3) {
        (self.pose.position, (self.pose.rotation * self.direction(x, y)).normalize())
    }

    /// The direction through image point (`x`, `y`) in the camera's own axes: of a pinhole scaled so that its depth
    /// (z) is 1, of a fisheye of unit length, since its depth may be 0 or less.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        let i = &self.intrinsics;
        i.distortion.direction(DVec2::new((x - i.cx) / i.fx, (y - i.cy) / i.fy))
    }

    /// Where a world point lands, in pixels; `None` where the lens does not see it: a pinhole what is behind the
    /// camera, a fisheye what is farther off its axis than its widest angle. The point may lie outside the image.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let local = self.pose.rotation.transpose() * (point - self.pose.position);
        let i = &self.intrinsics;
        let at = i.distortion.project(local)?;
        Some(DVec2::new(at.x * i.fx + i.cx, at.y * i.fy + i.cy))
    }

    /// The same camera at another resolution.
    ///
    /// # Panics
    /// When a new side is zero.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self { intrinsics: self.intrinsics.resized(width, height), pose: self.pose }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cameras::fisheye::Fisheye;
    use crate::cameras::lens::{BrownConrady, Distortion};
    use crate::cameras::pose::{PoseError, off_orthonormal};
    use glam::DMat3;

    fn camera(distortion: Distortion) -> Camera {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, -3.0), DVec3::new(0.1, 0.2, 0.3), DVec3::Y).unwrap();
        let intrinsics = Intrinsics { width: 400, height: 300, fx: 380.0, fy: 390.0, cx: 201.0, cy: 149.0, distortion };
        Camera { intrinsics, pose }
    }

    #[test]
    fn ray_and_projection_are_inverse_under_every_distortion() {
        for distortion in [
            Distortion::default(),
            BrownConrady { k1: -0.2, ..Default::default() }.into(),
            BrownConrady { k1: 0.1, k2: -0.05, k3: 0.01, p1: 1e-3, p2: -2e-3 }.into(),
            Fisheye::new([-0.03, 0.004, -0.003, 0.0004]).into(),
        ] {
            let camera = camera(distortion);
            for (x, y) in [(0.5, 0.5), (201.0, 149.0), (399.5, 10.5), (17.25, 280.0)] {
                let (origin, direction) = camera.ray(x, y);
                assert!((direction.length() - 1.0).abs() < 1e-12);
                let back = camera.project(origin + direction * 7.5).unwrap();
                assert!((back - DVec2::new(x, y)).length() < 1e-8, "{distortion:?} at {x}, {y}: {back}");
            }
        }
    }

    #[test]
    fn a_lens_that_folds_within_the_frame_is_told_apart() {
        // The corner is at 0.65; x (1 + k1 x^2) turns back at 0.577 / sqrt(-k1), where it is two thirds of that.
        for (k1, folds) in [(0.0, false), (0.3, false), (-0.2, false), (-0.33, false), (-0.4, true), (-2.0, true)] {
            assert_eq!(camera(BrownConrady { k1, ..Default::default() }.into()).intrinsics.folds(), folds, "k1 {k1}");
        }
        let in_time = BrownConrady { k1: -0.4, k2: 0.5, ..Default::default() };
        assert!(!camera(in_time.into()).intrinsics.folds(), "turned back in time");
    }

    #[test]
    fn a_fisheye_reaches_the_farthest_corner_or_is_refused() {
        // The corner is 251.4 px off; t (1 + k1 t^2) turns back where it is two thirds of 0.577 / sqrt(-k1).
        let check = |k1: f64, focal: f64| {
            let mut i = camera(Fisheye::new([k1, 0.0, 0.0, 0.0]).into()).intrinsics;
            (i.fx, i.fy) = (focal, focal);
            i.check_lens().map_err(|e| e.to_string())
        };
        assert_eq!(check(-0.33, 382.0), Ok(()));
        let refused = check(-0.4, 382.0).unwrap_err();
        assert!(refused.contains("ends 52.3 degrees") && refused.contains("0.6086 focal lengths"), "{refused}");
        assert!(refused.contains("turns back") && refused.contains("corner lies 0.6581 out"), "{refused}");
        // Nearly the whole way around, and beyond it.
        assert_eq!(check(0.0, 81.0), Ok(()));
        let refused = check(0.0, 79.0).unwrap_err();
        assert!(refused.contains("ends 180.0 degrees") && refused.contains("straight behind"), "{refused}");
        // Scaled pixels keep what a lens reaches, to rounding.
        let mut whole = camera(Fisheye::new([0.0; 4]).into()).intrinsics;
        whole.fx = whole.cx.hypot(151.0) / std::f64::consts::PI;
        whole.fy = whole.fx;
        for side in [100, 399, 1001, 3333] {
            assert_eq!(whole.resized(side, side * 3 / 4).check_lens(), Ok(()), "{side}");
        }
    }

    #[test]
    fn what_a_picture_shows_across_is_a_pinhole_s_slope_and_at_most_45_degrees_of_a_fisheye() {
        let pinhole = camera(Distortion::default()).intrinsics;
        assert_eq!(pinhole.half_width(), 400.0 / 380.0 / 2.0);
        let mut fisheye = camera(Fisheye::new([0.0; 4]).into()).intrinsics;
        fisheye.fx = 400.0 / 2.0 / 30f64.to_radians();
        assert!((fisheye.half_width() - 30f64.to_radians().tan()).abs() < 1e-12);
        fisheye.fx = 100.0;
        assert!((fisheye.half_width() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_file_s_rotation_may_be_scaled_and_rounded() {
        let pose = camera(Distortion::default()).pose;
        let near = |matrix: DMat3, off: f64| {
            let read = Pose::from_file(matrix, pose.position).unwrap().rotation;
            assert!(off_orthonormal(&read) < 1e-12);
            assert!(
                (read - pose.rotation).to_cols_array().iter().all(|v| v.abs() < off),
                "{read} is not {}",
                pose.rotation
            );
        };
        near(pose.rotation, 1e-12);
        near(pose.rotation * 3.0, 1e-12);
        near(pose.rotation * 0.01, 1e-12);
        let rounded = DMat3::from_cols_array(&pose.rotation.to_cols_array().map(|v| (v * 100.0).round() / 100.0));
        assert!(Pose::new(rounded * 2.0, pose.position).is_err());
        near(rounded, 0.01);
        near(rounded * 2.0, 0.01);
        for bad in [DVec3::new(1.0, 1.0, 1.1), DVec3::new(1.0, 1.0, -1.0), DVec3::new(1.0, 1.0, 0.0), DVec3::ZERO] {
            let refused = Pose::from_file(DMat3::from_diagonal(bad), DVec3::ZERO);
            assert!(matches!(refused, Err(PoseError::NotARotation { .. })), "{bad}");
        }
    }

    #[test]
    fn looks_where_it_was_told() {
        let camera = camera(Distortion::default());
        let at = camera.project(DVec3::new(0.1, 0.2, 0.3)).unwrap();
        assert!((at - DVec2::new(201.0, 149.0)).length() < 1e-9);
        // Image y grows downwards, so a point further up lands on a smaller y.
        assert!(camera.project(DVec3::new(0.1, 0.4, 0.3)).unwrap().y < 149.0);
    }

    #[test]
    fn a_reflection_and_a_nan_are_refused() {
        let flip = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        assert!(matches!(Pose::new(flip, DVec3::ZERO), Err(PoseError::NotARotation { .. })));
        assert_eq!(Pose::new(DMat3::IDENTITY, DVec3::new(0.0, f64::NAN, 0.0)), Err(PoseError::NotFinite));
    }
}
