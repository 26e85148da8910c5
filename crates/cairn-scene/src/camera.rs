//! The camera model: one pinhole with Brown-Conrady distortion covers every
//! camera Cairn reads (SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV).
//!
//! Distortion is honoured in the rays: a photograph is never resampled, so its
//! pixels (and what they are worth as evidence) stay as the contributor took them.

use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Brown-Conrady lens distortion (OpenCV's model without k4..k6), dimensionless,
/// applied to normalised image coordinates `x = X/Z, y = Y/Z`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, second order.
    pub k1: f64,
    /// Radial, fourth order.
    pub k2: f64,
    /// Radial, sixth order.
    pub k3: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
}

impl Distortion {
    /// Whether every coefficient is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Ideal normalised coordinates to distorted ones (OpenCV `projectPoints`).
    pub fn distort(&self, ideal: DVec2) -> DVec2 {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        DVec2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Distorted normalised coordinates back to ideal ones, by Newton's method
    /// on [`Distortion::distort`]. Converges to 1e-12 where the model is
    /// one-to-one; beyond that the best iterate is returned.
    pub fn undistort(&self, distorted: DVec2) -> DVec2 {
        if self.is_none() {
            return distorted;
        }
        let mut ideal = distorted;
        for _ in 0..50 {
            let error = self.distort(ideal) - distorted;
            if error.length_squared() < 1e-26 {
                break;
            }
            // A numeric Jacobian: five coefficients' analytic one is easy to get
            // wrong, and this runs once per pixel, outside training.
            let h = 1e-7;
            let dx = (self.distort(ideal + DVec2::new(h, 0.0)) - self.distort(ideal - DVec2::new(h, 0.0))) / (2.0 * h);
            let dy = (self.distort(ideal + DVec2::new(0.0, h)) - self.distort(ideal - DVec2::new(0.0, h))) / (2.0 * h);
            let det = dx.x * dy.y - dy.x * dx.y;
            if det.abs() < 1e-9 {
                break;
            }
            ideal -= DVec2::new(dy.y * error.x - dy.x * error.y, dx.x * error.y - dx.y * error.x) / det;
        }
        ideal
    }
}

/// What a camera does to directions: size, focal lengths, principal point, lens.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Focal length across, px.
    pub fx: f64,
    /// Focal length down, px.
    pub fy: f64,
    /// Principal point from the left edge, px (a centred one is `width / 2`).
    pub cx: f64,
    /// Principal point from the top edge, px.
    pub cy: f64,
    /// The lens.
    pub distortion: Distortion,
}

impl Intrinsics {
    /// Whether the lens folds within the frame: going outwards from the principal point, distorted points turn back
    /// before they reach the farthest corner, so that rays beyond have no direction of their own. Radial terms only,
    /// as tangential ones are small.
    pub fn folds(&self) -> bool {
        let d = &self.distortion;
        let across = self.cx.abs().max((self.width as f64 - self.cx).abs()) / self.fx;
        let down = self.cy.abs().max((self.height as f64 - self.cy).abs()) / self.fy;
        let corner = across.hypot(down);
        let distorted = |r: f64| {
            let r2 = r * r;
            r * (1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3)))
        };
        // Steps of a thousandth of the corner's radius, to four times as far: a lens that shrinks more is none.
        let steps = (0..=4000).map(|i| distorted(corner * f64::from(i) / 1000.0));
        let mut farthest = f64::NEG_INFINITY;
        for at in steps {
            if at >= corner {
                return false;
            }
            if at < farthest {
                return true;
            }
            farthest = at;
        }
        true
    }

    /// The same camera at another resolution; pixels may become non-square.
    ///
    /// # Panics
    /// When a new side is zero.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "a camera needs at least one pixel");
        let sx = width as f64 / self.width as f64;
        let sy = height as f64 / self.height as f64;
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            distortion: self.distortion,
        }
    }
}

/// Where a camera stands and looks: camera-to-world, OpenCV axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation, camera to world; its columns are the camera's right, down and
    /// forward directions in the world. Orthonormal, determinant +1.
    pub rotation: DMat3,
    /// The camera's centre in the world, in the capture's unit.
    pub position: DVec3,
}

/// Why a matrix and a vector are not a pose.
#[derive(Debug, Error, PartialEq)]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("the pose holds a number that is not finite; re-export the cameras or drop this view")]
    NotFinite,
    /// The matrix does not rotate.
    #[error(
        "the rotation is not one (it departs from orthonormal by {error:.3e}, determinant {determinant:.6}; allowed is {allowed:.0e} and +1); re-export the cameras or drop this view"
    )]
    NotARotation {
        /// Largest absolute entry of `R^T R - 1`.
        error: f64,
        /// Determinant of `R`.
        determinant: f64,
        /// The most that `error` may be.
        allowed: f64,
    },
}

/// How far from orthonormal a rotation may be that Cairn itself wrote or is sent.
const OFF: f64 = 1e-3;
/// How far in a camera file: two decimals an entry are up to `2 * sqrt(3) * 0.005` off.
const OFF_IN_A_FILE: f64 = 2e-2;

/// Largest absolute entry of `R^T R - 1`.
fn off_orthonormal(rotation: &DMat3) -> f64 {
    let gram = rotation.transpose() * *rotation - DMat3::IDENTITY;
    gram.to_cols_array().iter().fold(0.0f64, |m, v| m.max(v.abs()))
}

impl Pose {
    /// A pose from a camera file: as [`Pose::new`], but a uniform scale is divided
    /// out of the matrix, and one with two decimals becomes the rotation nearest to it.
    ///
    /// # Errors
    /// [`PoseError`] as there, for a matrix that is farther from any scaled rotation.
    pub(crate) fn from_file(matrix: DMat3, position: DVec3) -> Result<Self, PoseError> {
        let exact = Self::new(matrix, position);
        let Err(PoseError::NotARotation { determinant, .. }) = exact else { return exact };
        if determinant.is_nan() || determinant <= 0.0 {
            return exact;
        }
        let mut rotation = matrix * determinant.cbrt().recip();
        let error = off_orthonormal(&rotation);
        if error.is_nan() || error > OFF_IN_A_FILE {
            return Err(PoseError::NotARotation { error, determinant, allowed: OFF_IN_A_FILE });
        }
        // Newton's iteration for the orthogonal factor of a matrix (Higham 1986): four steps take 2e-2 below rounding.
        for _ in 0..4 {
            rotation = (rotation + rotation.transpose().inverse()) * 0.5;
        }
        Self::new(rotation, position)
    }

    /// Checks and wraps a camera-to-world rotation and position.
    /// A rotation rounded to 1e-3 is accepted and made exactly orthonormal.
    ///
    /// # Errors
    /// [`PoseError`] for a number that is not finite or a matrix that is no rotation.
    pub fn new(rotation: DMat3, position: DVec3) -> Result<Self, PoseError> {
        if !position.is_finite() || !rotation.is_finite() {
            return Err(PoseError::NotFinite);
        }
        let error = off_orthonormal(&rotation);
        let determinant = rotation.determinant();
        if error > OFF || determinant < 0.0 {
            return Err(PoseError::NotARotation { error, determinant, allowed: OFF });
        }
        let z = rotation.z_axis.normalize();
        let x = (rotation.x_axis - z * z.dot(rotation.x_axis)).normalize();
        Ok(Self { rotation: DMat3::from_cols(x, z.cross(x), z), position })
    }

    /// A camera at `position` that looks at `target`, its top towards `up`.
    ///
    /// # Errors
    /// [`PoseError::NotFinite`] when the view direction is zero or along `up`.
    pub fn look_at(position: DVec3, target: DVec3, up: DVec3) -> Result<Self, PoseError> {
        let forward = (target - position).try_normalize().ok_or(PoseError::NotFinite)?;
        let right = forward.cross(up).try_normalize().ok_or(PoseError::NotFinite)?;
        Self::new(DMat3::from_cols(right, forward.cross(right), forward), position)
    }

    /// The viewing direction in the world, unit length.
    pub fn forward(&self) -> DVec3 {
        self.rotation.z_axis
    }
}

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

    /// The direction through image point (`x`, `y`) in the camera's own axes,
    /// scaled so that its depth (z) is 1.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        let i = &self.intrinsics;
        let ideal = i.distortion.undistort(DVec2::new((x - i.cx) / i.fx, (y - i.cy) / i.fy));
        DVec3::new(ideal.x, ideal.y, 1.0)
    }

    /// Where a world point lands, in pixels; `None` behind the camera. The
    /// point may lie outside the image.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let local = self.pose.rotation.transpose() * (point - self.pose.position);
        if local.z <= 0.0 {
            return None;
        }
        let i = &self.intrinsics;
        let at = i.distortion.distort(DVec2::new(local.x / local.z, local.y / local.z));
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

    fn camera(distortion: Distortion) -> Camera {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, -3.0), DVec3::new(0.1, 0.2, 0.3), DVec3::Y).unwrap();
        let intrinsics = Intrinsics { width: 400, height: 300, fx: 380.0, fy: 390.0, cx: 201.0, cy: 149.0, distortion };
        Camera { intrinsics, pose }
    }

    #[test]
    fn ray_and_projection_are_inverse_under_every_distortion() {
        for distortion in [
            Distortion::default(),
            Distortion { k1: -0.2, ..Default::default() },
            Distortion { k1: 0.1, k2: -0.05, k3: 0.01, p1: 1e-3, p2: -2e-3 },
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
            assert_eq!(camera(Distortion { k1, ..Default::default() }).intrinsics.folds(), folds, "k1 {k1}");
        }
        assert!(
            !camera(Distortion { k1: -0.4, k2: 0.5, ..Default::default() }).intrinsics.folds(),
            "turned back in time"
        );
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
