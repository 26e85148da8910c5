//! Rendering a change of colours alone: what a carrier adds to a view, through
//! the exact traversal of the field and without a copy of its grid.

use crate::appearance::Appearance;
use crate::composite::{Kept, Thresholds, corner_shares, runs, see};
use crate::field::Field;
use crate::operator::CarrierBasis;
use crate::rays::Lens;
use crate::sh::SH;
use cairn_capture::{Camera, Picture};
use rayon::prelude::*;

impl Field {
    /// The picture of `camera` with `carrier` (`rows x basis.width()`) added to
    /// the field's colours, not clamped: `theta(P)` for `theta = theta_0 + carrier`.
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
        let lens = Lens::new(camera);
        let corners = self.grid.corners();
        let (near, far) = (appearance.near_matrix(), appearance.far_matrix());
        let rgb: Vec<[f32; 3]> = (0..lens.pixels())
            .into_par_iter()
            .with_min_len(64)
            .map_init(Vec::new, |tape: &mut Vec<Kept<f32>>, at| {
                let (path, angles) = lens.ray(camera, &self.frame, at);
                let gathered = see(&self.grid, &path, &angles, Thresholds::SHOWN, tape);
                let mut sums = [[0.0f32; 3]; 2];
                for run in runs(tape) {
                    let sum = &mut sums[usize::from(run[0].far)];
                    for (corner, share) in corners.iter().zip(corner_shares(run)) {
                        let row = self.grid.index[run[0].cell as usize + corner] as usize;
                        let colour = carrier_colour(carrier, row, basis, &angles);
                        for k in 0..3 {
                            sum[k] += share * colour[k];
                        }
                    }
                }
                let mut pixel = appearance.shade(&crate::appearance::features(&gathered, &angles));
                for (c, v) in pixel.iter_mut().enumerate() {
                    for k in 0..3 {
                        *v += near[c][k] * sums[0][k] + far[c][k] * sums[1][k];
                    }
                }
                pixel
            })
            .collect();
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        Picture::new(w, h, rgb.into_iter().flatten().collect()).expect("one colour a pixel")
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
