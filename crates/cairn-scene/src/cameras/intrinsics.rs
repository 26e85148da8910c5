//! What a camera does to directions.

use std::f64::consts::FRAC_PI_4;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::cameras::fisheye::LensError;
use crate::cameras::lens::Distortion;
use crate::error::CaptureError;

/// Cameras wider than this are a broken file, not a camera, px.
pub(crate) const MAX_CAMERA_SIDE_PX: usize = 1 << 20;

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

/// How much farther than a fisheye reaches a corner may lie, as a share: a camera at another resolution is rounded.
const ROUNDING: f64 = 1e-9;

impl Intrinsics {
    /// How far from the principal point the farthest corner lies, focal lengths.
    fn corner(&self) -> f64 {
        let across = self.cx.abs().max((self.width as f64 - self.cx).abs()) / self.fx;
        let down = self.cy.abs().max((self.height as f64 - self.cy).abs()) / self.fy;
        across.hypot(down)
    }

    /// Refuses a fisheye that ends within the frame. Whatever brings cameras in asks for it once.
    ///
    /// # Errors
    /// [`LensError`]: where the lens ends, and where the frame does.
    pub fn check_lens(&self) -> Result<(), LensError> {
        let Distortion::Fisheye(lens) = &self.distortion else { return Ok(()) };
        let (widest, corner) = (lens.widest(), self.corner());
        let radius = lens.radius(widest);
        if corner > radius * (1.0 + ROUNDING) { Err(LensError { widest, radius, corner }) } else { Ok(()) }
    }

    /// Half of what the picture shows across or down, whichever is more, at depth 1, distortion left out. Of a fisheye
    /// at most 1, which is 45 degrees to either side: what it shows beside it has no width at a depth ahead.
    pub fn half_width(&self) -> f64 {
        let half = (self.width as f64 / self.fx).max(self.height as f64 / self.fy) / 2.0;
        match &self.distortion {
            Distortion::Pinhole(_) => half,
            Distortion::Fisheye(lens) => lens.angle(half).min(FRAC_PI_4).tan(),
        }
    }

    /// Whether a pinhole's distortion folds within the frame: going outwards from the principal point, distorted points
    /// turn back before they reach the farthest corner, so that rays beyond have no direction of their own. Radial terms
    /// only, as tangential ones are small. A fisheye that does so is refused ([`Intrinsics::check_lens`]).
    pub fn folds(&self) -> bool {
        let Distortion::Pinhole(d) = &self.distortion else { return false };
        let corner = self.corner();
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

/// Refuses a camera without pixels, with a focal length that is none, or with a fisheye that ends within the frame.
pub(crate) fn check_intrinsics(file: &Path, label: &str, i: &Intrinsics) -> Result<(), CaptureError> {
    let wrong = |expected: &str, got: String| {
        Err(CaptureError::malformed(file, label, expected, got, "re-export the cameras or drop this view"))
    };
    let side = 1..=MAX_CAMERA_SIDE_PX;
    if !side.contains(&i.width) || !side.contains(&i.height) {
        return wrong("a camera of 1 to 1048576 pixels a side", format!("{} x {}", i.width, i.height));
    }
    if !(i.fx.is_finite() && i.fy.is_finite() && i.fx > 0.0 && i.fy > 0.0) {
        return wrong("a focal length above 0", format!("{}, {}", i.fx, i.fy));
    }
    if !(i.cx.is_finite() && i.cy.is_finite()) {
        return wrong("a finite principal point", format!("{}, {}", i.cx, i.cy));
    }
    let coefficients = i.distortion.coefficients();
    if !coefficients.iter().all(|v| v.is_finite()) {
        return wrong("finite distortion", format!("{coefficients:?}"));
    }
    i.check_lens().map_err(|problem| CaptureError::Lens { file: file.to_path_buf(), entry: label.to_owned(), problem })
}
