//! Rendering a change of colours alone: what a carrier adds to a view, through
//! the exact traversal of the field and without a copy of its grid.

use super::basis::CarrierBasis;
use super::model::{Field, picture};
use crate::appearance::code::{Appearance, features};
use crate::grid::sh::SH;
use crate::render::composite::Thresholds;
use cairn_scene::{Camera, Picture};

impl Field {
    /// The picture of `camera` with `carrier` (`rows x basis.width()`) added to
    /// the field's colours, not clamped: `theta(P)` for `theta = theta_0 + carrier`. `appearance`
    /// is the field's; of carriers it tints harmonics alone ([`CarrierBasis`]).
    ///
    /// # Panics
    /// When `carrier` is not of this field's size.
    pub fn render_with(
        &self,
        camera: &Camera,
        appearance: &Appearance,
        carrier: &[f32],
        basis: CarrierBasis,
    ) -> Picture {
        assert_eq!(carrier.len(), self.grid.rows() * basis.width(), "a carrier of this field's size");
        let [near, far] = basis.tints(appearance);
        let rgb = self.each_pixel(camera, Thresholds::SHOWN, |seen| {
            let mut sums = [[0.0f32; 3]; 2];
            seen.each_vertex(|row, weight, far| {
                let colour = carrier_colour(carrier, row, basis, &seen.harmonics);
                for (sum, v) in sums[usize::from(far)].iter_mut().zip(colour) {
                    *sum += weight * v;
                }
            });
            let mut pixel = appearance.shade(&features(&seen.gathered, &seen.harmonics));
            for (c, v) in pixel.iter_mut().enumerate() {
                for k in 0..3 {
                    *v += near[c][k] * sums[0][k] + far[c][k] * sums[1][k];
                }
            }
            pixel
        });
        picture(camera, rgb.into_flattened())
    }
}

/// A carrier's colour at one row, seen along the direction of `angles`.
#[inline(always)]
fn carrier_colour(carrier: &[f32], row: usize, basis: CarrierBasis, angles: &[f32; SH]) -> [f32; 3] {
    let width = basis.width();
    let c = &carrier[row * width..(row + 1) * width];
    match basis {
        CarrierBasis::Constant => [c[0], c[1], c[2]],
        CarrierBasis::Harmonics => {
            std::array::from_fn(|k| c[k * SH..(k + 1) * SH].iter().zip(angles).map(|(a, b)| a * b).sum())
        }
    }
}
