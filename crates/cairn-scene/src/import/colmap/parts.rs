//! What COLMAP's binary and text files have in common.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use crate::cameras::intrinsics::{Intrinsics, MAX_CAMERA_SIDE_PX, check_intrinsics};
use crate::cameras::lens::{Lens, LensModel};
use crate::capture::Support;
use crate::error::CaptureError;

/// What to do about a file that is cut short or garbled.
pub(super) const REMEDY: &str = "export the model again with COLMAP (`colmap model_converter`)";

/// One image as either kind of file states it.
pub(super) struct Image {
    pub id: u32,
    /// Quaternion w, x, y, z, world to camera.
    pub rotation: [f64; 4],
    pub translation: DVec3,
    pub camera: u32,
    pub name: String,
    /// What its observations come to; `None` where there is no file of points.
    pub support: Option<Support>,
}

/// Cameras by their number.
pub(super) type Cameras = HashMap<u32, Intrinsics>;

/// A model that is not read.
pub(super) fn unsupported(file: &Path, id: u32, model: String) -> CaptureError {
    CaptureError::UnsupportedCamera { file: file.to_path_buf(), entry: format!("camera {id}"), model }
}

/// A camera's size as its file states it, px.
pub(super) struct Size {
    pub width: u64,
    pub height: u64,
}

/// The camera that `model` and its parameters describe.
pub(super) fn intrinsics(
    file: &Path,
    id: u32,
    model: LensModel,
    size: &Size,
    parameters: &[f64],
) -> Result<Intrinsics, CaptureError> {
    let Some(Lens { fx, fy, cx, cy, distortion }) = model.lens(parameters) else {
        let expected = format!("{} parameters of {}", model.parameters(), model.names()[0]);
        let got = parameters.len().to_string();
        return Err(CaptureError::malformed(file, format!("camera {id}"), expected, got, REMEDY));
    };
    // A side over the bound saturates and is refused with the rest of the checks.
    let side = |v: u64| usize::try_from(v).unwrap_or(usize::MAX).min(MAX_CAMERA_SIDE_PX + 1);
    let (width, height) = (side(size.width), side(size.height));
    let intrinsics = Intrinsics { width, height, fx, fy, cx, cy, distortion };
    check_intrinsics(file, &format!("camera {id}"), &intrinsics)?;
    Ok(intrinsics)
}

/// The sparse points, and how far each is from where its images saw it.
#[derive(Default)]
pub(super) struct Points {
    /// In the file's order.
    pub positions: Vec<DVec3>,
    /// Number and mean reprojection error, px, of each; ascending by number after [`Points::sort`]. Negative where
    /// COLMAP did not work it out.
    errors: Vec<(u64, f64)>,
}

impl Points {
    /// Takes in the point numbered `id`.
    ///
    /// # Errors
    /// For a coordinate or an error that is not finite.
    pub(super) fn push(&mut self, file: &Path, id: u64, position: DVec3, error_px: f64) -> Result<(), CaptureError> {
        let wrong = |expected: &str, got: String| {
            Err(CaptureError::malformed(file, format!("point {id}"), expected, got, REMEDY))
        };
        if !position.is_finite() {
            return wrong("finite coordinates", position.to_string());
        }
        if !error_px.is_finite() {
            return wrong("a finite reprojection error", error_px.to_string());
        }
        self.positions.push(position);
        self.errors.push((id, error_px));
        Ok(())
    }

    /// All are there: from now on they can be looked up.
    pub(super) fn sort(mut self) -> Self {
        self.errors.sort_by_key(|(id, _)| *id);
        self
    }

    /// The error of the point numbered `id`, px.
    fn error_px(&self, id: u64) -> Option<f64> {
        let at = self.errors.binary_search_by_key(&id, |(id, _)| *id).ok()?;
        Some(self.errors[at].1)
    }
}

/// Counts an image's observations of reconstructed points.
#[derive(Default)]
pub(super) struct Seen {
    points: u32,
    known: u32,
    sum_px: f64,
}

impl Seen {
    /// An observation of the point numbered `id`; a number that `points` does not have counts for nothing.
    pub(super) fn observe(&mut self, points: &Points, id: u64) {
        let Some(error_px) = points.error_px(id) else { return };
        self.points = self.points.saturating_add(1);
        if error_px >= 0.0 {
            self.known += 1;
            self.sum_px += error_px;
        }
    }

    /// What they come to; `None` where there are points and COLMAP worked out no error of any.
    pub(super) fn support(self) -> Option<Support> {
        let mean = if self.known > 0 { self.sum_px / f64::from(self.known) } else { 0.0 };
        // The sum of finite numbers may overflow.
        let is_known = (self.known > 0 || self.points == 0) && mean.is_finite();
        is_known.then_some(Support { points: self.points, reprojection_error_px: mean })
    }
}

/// Keeps `camera` under its number, once.
pub(super) fn insert(file: &Path, cameras: &mut Cameras, id: u32, camera: Intrinsics) -> Result<(), CaptureError> {
    if cameras.insert(id, camera).is_some() {
        let expected = "a camera number used only once";
        return Err(CaptureError::malformed(file, format!("camera {id}"), expected, "it twice", REMEDY));
    }
    Ok(())
}
