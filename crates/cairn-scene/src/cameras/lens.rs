//! Lenses: the one list of camera models that are read, and the distortion that they state.
//!
//! Two families cover all of them: a pinhole with Brown-Conrady distortion, and a fisheye. Another model of one of these
//! is one variant of [`LensModel`] and one arm in [`LensModel::lens`]. Another family is a variant of [`Distortion`]:
//! the compiler then names every place that has to know it.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::cameras::fisheye::Fisheye;

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
    /// fx, fy, cx, cy, k1, k2, k3, k4 of a [`Fisheye`].
    OpenCvFisheye,
    /// f, cx, cy, k1 of a [`Fisheye`].
    SimpleRadialFisheye,
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
    pub const ALL: [Self; 7] = [
        Self::SimplePinhole,
        Self::Pinhole,
        Self::SimpleRadial,
        Self::Radial,
        Self::OpenCv,
        Self::OpenCvFisheye,
        Self::SimpleRadialFisheye,
    ];
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
            Self::OpenCvFisheye => &["OPENCV_FISHEYE"],
            Self::SimpleRadialFisheye => &["SIMPLE_RADIAL_FISHEYE"],
        }
    }

    /// COLMAP's names of all that are read, for messages.
    pub fn list() -> String {
        let names = Self::ALL.map(|model| model.names()[0]);
        let (last, others) = names.split_last().expect("there are some");
        format!("{} or {last}", others.join(", "))
    }

    /// Whether its coefficients are a [`Fisheye`]'s.
    pub fn is_fisheye(self) -> bool {
        matches!(self, Self::OpenCvFisheye | Self::SimpleRadialFisheye)
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
            Self::Pinhole | Self::SimpleRadial | Self::SimpleRadialFisheye => 4,
            Self::Radial => 5,
            Self::OpenCv | Self::OpenCvFisheye => 8,
        }
    }

    /// What `parameters`, in COLMAP's order, say; `None` for another number of them.
    pub fn lens(self, parameters: &[f64]) -> Option<Lens> {
        let none = BrownConrady::default();
        let (fx, fy, cx, cy, distortion) = match (self, parameters) {
            (Self::SimplePinhole, &[f, cx, cy]) => (f, f, cx, cy, none.into()),
            (Self::Pinhole, &[fx, fy, cx, cy]) => (fx, fy, cx, cy, none.into()),
            (Self::SimpleRadial, &[f, cx, cy, k1]) => (f, f, cx, cy, BrownConrady { k1, ..none }.into()),
            (Self::Radial, &[f, cx, cy, k1, k2]) => (f, f, cx, cy, BrownConrady { k1, k2, ..none }.into()),
            (Self::OpenCv, &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                (fx, fy, cx, cy, BrownConrady { k1, k2, k3: 0.0, p1, p2 }.into())
            }
            (Self::OpenCvFisheye, &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
                (fx, fy, cx, cy, Fisheye::new([k1, k2, k3, k4]).into())
            }
            (Self::SimpleRadialFisheye, &[f, cx, cy, k1]) => (f, f, cx, cy, Fisheye::new([k1, 0.0, 0.0, 0.0]).into()),
            _ => return None,
        };
        Some(Lens { fx, fy, cx, cy, distortion })
    }
}

/// What a lens makes of directions, before its focal lengths and principal point make pixels of that.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// A pinhole's picture, bent: straight ahead is all that it sees.
    Pinhole(BrownConrady),
    /// A fisheye's, which may show what is beside the camera and behind it.
    Fisheye(Fisheye),
}

impl Default for Distortion {
    /// An ideal pinhole.
    fn default() -> Self {
        Self::Pinhole(BrownConrady::default())
    }
}

impl From<BrownConrady> for Distortion {
    fn from(bent: BrownConrady) -> Self {
        Self::Pinhole(bent)
    }
}

impl From<Fisheye> for Distortion {
    fn from(fisheye: Fisheye) -> Self {
        Self::Fisheye(fisheye)
    }
}

impl Distortion {
    /// Whether it is an ideal pinhole's.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// The first radial coefficient, k1, dimensionless.
    pub fn first_radial(&self) -> f64 {
        match self {
            Self::Pinhole(bent) => bent.k1,
            Self::Fisheye(fisheye) => fisheye.k()[0],
        }
    }

    /// The lens with another first radial coefficient, k1.
    pub fn with_first_radial(self, k1: f64) -> Self {
        match self {
            Self::Pinhole(bent) => Self::Pinhole(BrownConrady { k1, ..bent }),
            Self::Fisheye(fisheye) => {
                let [_, k2, k3, k4] = fisheye.k();
                Self::Fisheye(Fisheye::new([k1, k2, k3, k4]))
            }
        }
    }

    /// Every coefficient.
    pub(crate) fn coefficients(&self) -> Vec<f64> {
        match self {
            Self::Pinhole(BrownConrady { k1, k2, k3, p1, p2 }) => vec![*k1, *k2, *k3, *p1, *p2],
            Self::Fisheye(fisheye) => fisheye.k().to_vec(),
        }
    }

    /// A lens at `share` (0 to 1) of the way from this one to `other`, coefficient by coefficient; `None` between a
    /// pinhole and a fisheye, whose coefficients mean other things.
    pub fn mixed(&self, other: &Self, share: f64) -> Option<Self> {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        match (self, other) {
            (Self::Pinhole(a), Self::Pinhole(b)) => Some(Self::Pinhole(BrownConrady {
                k1: mix(a.k1, b.k1),
                k2: mix(a.k2, b.k2),
                k3: mix(a.k3, b.k3),
                p1: mix(a.p1, b.p1),
                p2: mix(a.p2, b.p2),
            })),
            (Self::Fisheye(a), Self::Fisheye(b)) => {
                let (a, b) = (a.k(), b.k());
                Some(Self::Fisheye(Fisheye::new(std::array::from_fn(|n| mix(a[n], b[n])))))
            }
            (Self::Pinhole(_), Self::Fisheye(_)) | (Self::Fisheye(_), Self::Pinhole(_)) => None,
        }
    }

    /// Where a direction in the camera's axes (any length) lands, focal lengths from the principal point; `None` for
    /// one that the lens does not see.
    pub(crate) fn project(&self, direction: DVec3) -> Option<DVec2> {
        match self {
            Self::Pinhole(_) if direction.z <= 0.0 => None,
            Self::Pinhole(bent) => Some(bent.distort(DVec2::new(direction.x / direction.z, direction.y / direction.z))),
            Self::Fisheye(fisheye) => fisheye.project(direction),
        }
    }

    /// The direction in the camera's axes of what lands `at` (focal lengths from the principal point): a pinhole's of
    /// depth (z) 1, a fisheye's of length 1.
    pub(crate) fn direction(&self, at: DVec2) -> DVec3 {
        match self {
            Self::Pinhole(bent) => bent.undistort(at).extend(1.0),
            Self::Fisheye(fisheye) => fisheye.direction(at),
        }
    }
}

/// Brown-Conrady lens distortion (OpenCV's model without k4..k6), dimensionless,
/// applied to normalised image coordinates `x = X/Z, y = Y/Z`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BrownConrady {
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

impl BrownConrady {
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
    /// on [`BrownConrady::distort`]. Converges to 1e-12 where the model is
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
        for (number, model) in [0, 1, 2, 3, 4, 5, 8].into_iter().zip(LensModel::ALL) {
            assert_eq!(LensModel::from_colmap_number(number), Ok(model));
            assert!(LensModel::list().contains(model.names()[0]));
            assert!(model.names().iter().all(|name| LensModel::from_name(name) == Some(model)), "{model:?}");
            assert!(model.parameters() <= LensModel::MAX_PARAMETERS);
            let parameters: Vec<f64> = (1..=model.parameters()).map(|v| v as f64).collect();
            let lens = model.lens(&parameters).unwrap();
            assert_eq!(
                (lens.fx, model.is_fisheye()),
                (1.0, matches!(lens.distortion, Distortion::Fisheye(_))),
                "{model:?}"
            );
            assert_eq!(model.lens(&parameters[1..]), None, "{model:?}");
        }
        assert_eq!(LensModel::from_name("perspective"), Some(LensModel::Pinhole));
        assert_eq!(LensModel::from_colmap_number(7), Err("FOV".to_owned()));
        assert_eq!(LensModel::from_colmap_number(u32::MAX), Err("number -1".to_owned()));
    }
}
