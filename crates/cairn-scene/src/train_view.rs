//! A view as trainings use it: decoded once, kept for a whole job.

use crate::cameras::camera::Camera;
use crate::images::mask::Mask;
use crate::images::picture::Picture8;

/// A view's camera, photograph and mask, all of one size. A quarter of the memory of a photograph in f32.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainView {
    /// The camera, at the photograph's size.
    pub camera: Camera,
    /// The photograph, display-referred (sRGB-encoded), composited on the capture's background.
    pub rgb8: Picture8,
    /// Which of its pixels teach; `None` means all.
    pub mask: Option<Mask>,
}

impl TrainView {
    /// Whether the pixel in column `x` and row `y`, both from 0, is to be used.
    ///
    /// # Panics
    /// When there is a mask and the pixel lies outside.
    pub fn uses(&self, x: usize, y: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.uses(x, y))
    }

    /// The same view at `width x height`: the picture by means of areas, rounded to 8 bits; the mask as
    /// [`Mask::resized`].
    ///
    /// # Panics
    /// When a new side is zero.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self {
            camera: self.camera.resized(width, height),
            rgb8: Picture8::from(&self.rgb8.to_picture().resized(width, height)),
            mask: self.mask.as_ref().map(|mask| mask.resized(width, height)),
        }
    }
}
