//! Where a camera stands and looks.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

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
pub(crate) fn off_orthonormal(rotation: &DMat3) -> f64 {
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
