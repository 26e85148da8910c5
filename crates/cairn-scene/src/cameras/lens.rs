//! Lenses: the one list of camera models that are read, and the distortion that they state.
//!
//! A pinhole with Brown-Conrady distortion covers all of them. Another model is one variant of [`LensModel`] and one
//! arm in [`LensModel::lens`].

use glam::DVec2;
use serde::{Deserialize, Serialize};

/// COLMAP's camera models by number, read or not (src/colmap/sensor/models.h).
const COLMAP_NAMES: [&str; 12] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
];

/// A camera model that is read, under COLMAP's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensModel {
    /// f, cx, cy.
    SimplePinhole,
    /// fx, fy, cx, cy.
    Pinhole,
    /// f, cx, cy, k1.
    SimpleRadial,
    /// f, cx, cy, k1, k2.
    Radial,
    /// fx, fy, cx, cy, k1, k2, p1, p2.
    OpenCv,
}

/// What a model's parameters say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length across, px.
    pub fx: f64,
    /// Focal length down, px.
    pub fy: f64,
    /// Principal point from the left edge, px.
    pub cx: f64,
    /// Principal point from the top edge, px.
    pub cy: f64,
    /// The distortion.
    pub distortion: Distortion,
}

impl LensModel {
    /// All that are read.
    pub const ALL: [Self; 5] = [Self::SimplePinhole, Self::Pinhole, Self::SimpleRadial, Self::Radial, Self::OpenCv];
    /// The most parameters that a model has.
    pub const MAX_PARAMETERS: usize = 8;

    /// COLMAP's name first, then those that other programs use.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::SimplePinhole => &["SIMPLE_PINHOLE"],
            Self::Pinhole => &["PINHOLE", "PERSPECTIVE"],
            Self::SimpleRadial => &["SIMPLE_RADIAL"],
            Self::Radial => &["RADIAL"],
            Self::OpenCv => &["OPENCV"],
        }
    }

    /// The model of this name, in any case.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.names().iter().any(|known| known.eq_ignore_ascii_case(name)))
    }

    /// The model that COLMAP numbers so.
    ///
    /// # Errors
    /// The number's name, or the number itself where COLMAP knows none.
    pub fn from_colmap_number(number: u32) -> Result<Self, String> {
        let Some(name) = COLMAP_NAMES.get(number as usize) else {
            return Err(format!("number {}", number as i32));
        };
        Self::from_name(name).ok_or_else(|| (*name).to_owned())
    }

    /// How many parameters it has.
    pub fn parameters(self) -> usize {
        match self {
            Self::SimplePinhole => 3,
            Self::Pinhole | Self::SimpleRadial => 4,
            Self::Radial => 5,
            Self::OpenCv => 8,
        }
    }

    /// What `parameters`, in COLMAP's order, say; `None` for another number of them.
    pub fn lens(self, parameters: &[f64]) -> Option<Lens> {
        let none = Distortion::default();
        let (fx, fy, cx, cy, distortion) = match (self, parameters) {
            (Self::SimplePinhole, &[f, cx, cy]) => (f, f, cx, cy, none),
            (Self::Pinhole, &[fx, fy, cx, cy]) => (fx, fy, cx, cy, none),
            (Self::SimpleRadial, &[f, cx, cy, k1]) => (f, f, cx, cy, Distortion { k1, ..none }),
            (Self::Radial, &[f, cx, cy, k1, k2]) => (f, f, cx, cy, Distortion { k1, k2, ..none }),
            (Self::OpenCv, &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                (fx, fy, cx, cy, Distortion { k1, k2, k3: 0.0, p1, p2 })
            }
            _ => return None,
        };
        Some(Lens { fx, fy, cx, cy, distortion })
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_found_by_its_names_and_takes_its_parameters() {
        for (number, model) in (0..).zip(LensModel::ALL) {
            assert_eq!(LensModel::from_colmap_number(number), Ok(model));
            assert!(model.names().iter().all(|name| LensModel::from_name(name) == Some(model)), "{model:?}");
            assert!(model.parameters() <= LensModel::MAX_PARAMETERS);
            let parameters: Vec<f64> = (1..=model.parameters()).map(|v| v as f64).collect();
            assert_eq!(model.lens(&parameters).map(|lens| lens.fx), Some(1.0), "{model:?}");
            assert_eq!(model.lens(&parameters[1..]), None, "{model:?}");
        }
        assert_eq!(LensModel::from_name("perspective"), Some(LensModel::Pinhole));
        assert_eq!(LensModel::from_colmap_number(7), Err("FOV".to_owned()));
        assert_eq!(LensModel::from_colmap_number(u32::MAX), Err("number -1".to_owned()));
    }
}
