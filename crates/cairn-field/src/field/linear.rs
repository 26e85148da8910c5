//! What stage 2 needs of a field: each view as a fixed linear map from colour
//! changes to picture changes.
//!
//! With density frozen, sample positions, ray weights and interpolation weights
//! of a view never change, so a pixel is `sum_v w_v c_v` with constant `w`. The
//! weights are worked out once a view and kept as one sparse matrix; applying it
//! and its transpose is all the rendering that stage 2 does.

use super::basis::{CarrierBasis, Tints, lit};
use super::model::Field;
use super::weights::{FAR, ViewWeights};
use crate::appearance::code::Appearance;
use crate::grid::lattice::{ROW, prefetch};
use crate::grid::real::Real;
use crate::grid::sh::{SH, SH_DC};
use crate::rays::lens::{Eye, Lens};
use crate::render::composite::Thresholds;
use crate::render::picture::Tiling;
use cairn_scene::Camera;
use rayon::prelude::*;

/// Shares of rows that gradients go to at the same time, at most: each goes through all entries.
const MAX_SHARES: usize = 8;
/// Entries looked at to make shares even.
const SAMPLES: usize = 4096;
/// Entries from one whose row is used to one whose row is asked for.
const AHEAD: usize = 64;

/// A field that stage 2 can mark: colours may move, geometry may not (for that see `marched.rs`).
pub trait MarkableField: Sync {
    /// Rows of colour coefficients, the unused row 0 included.
    fn rows(&self) -> usize;
    /// Lattice coordinates of each row's vertex, `rows` long (row 0's are zero).
    fn lattice(&self) -> Vec<[u32; 3]>;
    /// Mean magnitude of each row's colour, `rows` long, for the gradient mask.
    fn row_magnitudes(&self) -> Vec<f32>;
    /// The magnitudes of single coefficients, `rows x 3 x 9`, channel-major.
    fn coefficient_magnitudes(&self) -> Vec<f32>;
    /// Density of each row's vertex relative to the raw unit (softplus of the raw density),
    /// `rows` long, for the mask of densities.
    fn densities(&self) -> Vec<f32>;
    /// The linear map of `camera`, whose pixels are means over `rays x rays` rays each, as if
    /// a picture `rays` times larger had been made smaller; entries weighing less than
    /// `cutoff` of a ray are left out.
    ///
    /// # Panics
    /// When `rays` is 0.
    fn view(&self, camera: &Camera, cutoff: f32, rays: usize) -> LinearView;
}

/// One view as a linear map; see the module's text.
#[derive(Clone, Debug)]
pub struct LinearView {
    width: usize,
    height: usize,
    /// What its pixels see of which vertices.
    weights: ViewWeights,
}

impl MarkableField for Field {
    fn rows(&self) -> usize {
        self.grid.rows()
    }

    fn lattice(&self) -> Vec<[u32; 3]> {
        let [nx, ny, _] = self.grid.dims.map(|d| d as u32);
        let place = |v: &u32| if *v == u32::MAX { [0; 3] } else { [v % nx, v / nx % ny, v / (nx * ny)] };
        self.grid.vertex.iter().map(place).collect()
    }

    fn row_magnitudes(&self) -> Vec<f32> {
        self.grid
            .colour
            .par_chunks_exact(ROW)
            .map(|row| (row[0].abs() + row[1].abs() + row[2].abs()) / 3.0 * SH_DC as f32)
            .collect()
    }

    fn coefficient_magnitudes(&self) -> Vec<f32> {
        let channel_major = |row: &[f32]| -> [f32; 3 * SH] { std::array::from_fn(|i| row[i % SH * 3 + i / SH].abs()) };
        self.grid.colour.chunks_exact(ROW).flat_map(channel_major).collect()
    }

    fn densities(&self) -> Vec<f32> {
        // Row 0 is nobody's.
        std::iter::once(0.0).chain(self.grid.raw_rows().map(|raw| raw.softplus_and_slope().0)).collect()
    }

    fn view(&self, camera: &Camera, cutoff: f32, rays: usize) -> LinearView {
        assert!(rays > 0, "a pixel needs a ray");
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let fine = if rays == 1 { *camera } else { camera.resized(width * rays, height * rays) };
        let lens = Lens::new(&fine);
        let eye = Eye { camera: &fine, lens: &lens };
        let tiling = Tiling::of(&self.grid, &self.frame, eye, Thresholds::SHOWN, rays);
        LinearView { width, height, weights: ViewWeights::of(&tiling, rays, cutoff) }
    }
}

impl LinearView {
    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Mean entries a pixel.
    pub fn density(&self) -> f64 {
        self.weights.entries.len() as f64 / (self.width * self.height) as f64
    }

    /// The base field's picture of this view, `height x width x 3`, not clamped.
    pub fn base(&self, appearance: &Appearance) -> Vec<f32> {
        let shades = appearance.shades();
        let features = &self.weights.features;
        let mut picture = vec![0.0; 3 * features.len()];
        let pixels = picture.as_chunks_mut().0.par_iter_mut().zip(features).with_min_len(1024);
        pixels.for_each(|(out, features): (&mut [f32; 3], _)| *out = shades.of(features));
        picture
    }

    /// By how much each pixel changes where each row's colour changes by its strength, in a direction that is drawn at random
    /// for each cell of rows: root mean square over draws and channels, seen with `appearance`. `cell_of` has each row's cell.
    ///
    /// # Panics
    /// When there is not a strength and a cell for each row that is seen.
    pub fn spreads(&self, strengths: &[f32], cell_of: &[u32], appearance: &Appearance) -> Vec<f32> {
        let gains = lit(appearance).map(|tint| tint.as_flattened().iter().map(|v| v * v).sum::<f32>() / 3.0);
        let square = |entries: &[(u32, f32)]| {
            let of = |(row, weight): &(u32, f32)| {
                let row = (row & !FAR) as usize;
                (cell_of[row], weight * strengths[row])
            };
            let mut cells: Vec<(u32, f32)> = entries.iter().map(of).collect();
            // Rows of one cell change together.
            cells.sort_unstable_by_key(|(cell, _)| *cell);
            let sums = cells.chunk_by(|a, b| a.0 == b.0).map(|cell| cell.iter().map(|(_, v)| v).sum::<f32>());
            sums.map(|sum| sum * sum).sum::<f32>()
        };
        let of = |pixel: usize| {
            let [near, far] = self.seen_by(pixel).map(square);
            (gains[0] * near + gains[1] * far).sqrt()
        };
        (0..self.width * self.height).into_par_iter().map(of).collect()
    }

    /// Adds to `picture` (`height x width x 3`) what `carrier` (`rows x width`
    /// of `basis`) changes, seen with `appearance`.
    ///
    /// # Panics
    /// When `picture` is of another size.
    pub fn apply(&self, carrier: &[f32], basis: CarrierBasis, appearance: &Appearance, picture: &mut [f32]) {
        self.tinted(carrier, basis, basis.tints(appearance), picture);
    }

    /// Adds to `picture` (`height x width x 3`) what a change of the field's own colours by `colours` (`rows x 3`, the same
    /// from everywhere) changes, seen with `appearance`.
    ///
    /// # Panics
    /// When `picture` is of another size.
    pub fn apply_lit(&self, colours: &[f32], appearance: &Appearance, picture: &mut [f32]) {
        self.tinted(colours, CarrierBasis::Constant, lit(appearance), picture);
    }

    fn tinted(&self, carrier: &[f32], basis: CarrierBasis, [near, far]: Tints, picture: &mut [f32]) {
        assert_eq!(picture.len(), self.width * self.height * 3, "a picture of this view's size");
        picture.par_chunks_exact_mut(3).with_min_len(512).enumerate().for_each(|(pixel, out)| {
            self.ask_ahead(pixel, carrier, basis.width(), 0);
            let sums = match basis {
                CarrierBasis::Constant => {
                    let rows = carrier.as_chunks::<3>().0;
                    self.seen_by(pixel).map(|entries| weighed(entries, |at| rows[at]))
                }
                CarrierBasis::Harmonics => {
                    let rows = carrier.as_chunks::<SH>().0;
                    let along = &self.weights.harmonics[pixel];
                    let dot = |row: &[f32; SH]| row.iter().zip(along).map(|(a, b)| a * b).sum();
                    let colour = |at: usize| std::array::from_fn(|k| dot(&rows[3 * at + k]));
                    self.seen_by(pixel).map(|entries| weighed(entries, colour))
                }
            };
            for (c, v) in out.iter_mut().enumerate() {
                for k in 0..3 {
                    *v += near[c][k] * sums[0][k] + far[c][k] * sums[1][k];
                }
            }
        });
    }

    /// Asks for those of `values` (rows of `width`, from the row `first` on) that pixels a little on from `pixel` see:
    /// rows lie far apart, and to wait for them was a third of what a picture took.
    #[inline(always)]
    fn ask_ahead(&self, pixel: usize, values: &[f32], width: usize, first: usize) {
        let count = values.len() / width;
        let [from, to] =
            [pixel, pixel + 1].map(|at| (self.weights.starts[at] as usize + AHEAD).min(self.weights.entries.len()));
        for at in self.weights.entries[from..to].iter().map(|(row, _)| place(*row, first)).filter(|at| *at < count) {
            prefetch(values.as_ptr().wrapping_add(at * width));
        }
    }

    /// A pixel's entries, those near and those in contracted space.
    fn seen_by(&self, pixel: usize) -> [&[(u32, f32)]; 2] {
        let entries =
            &self.weights.entries[self.weights.starts[pixel] as usize..self.weights.starts[pixel + 1] as usize];
        // Rows ascend, and the far ones' mark is their highest bit.
        let near = match entries.last() {
            Some((row, _)) if row & FAR != 0 => entries.partition_point(|(row, _)| row & FAR == 0),
            _ => entries.len(),
        };
        let (near, far) = entries.split_at(near);
        [near, far]
    }

    /// The transpose of [`LinearView::apply`]: adds to `gradient` (as `carrier`)
    /// what d(loss)/d(picture) owes the coefficients; `touched` hears each row. Each row's sum is taken by one
    /// thread in pixel order, so that it comes out the same with any number of them.
    ///
    /// # Panics
    /// When `slope` is of another size, or `touched` has not a place for each of the gradient's rows.
    pub fn push_back(
        &self,
        slope: &[f32],
        basis: CarrierBasis,
        appearance: &Appearance,
        gradient: &mut [f32],
        touched: &mut [bool],
    ) {
        self.push_tinted(slope, basis, basis.tints(appearance), Owed { first: 0, gradient, touched });
    }

    /// The transpose of [`LinearView::apply_lit`], as [`LinearView::push_back`] is that of [`LinearView::apply`].
    ///
    /// # Panics
    /// When `slope` is of another size.
    pub fn push_back_lit(&self, slope: &[f32], appearance: &Appearance, colours: &mut [f32]) {
        let mut touched = vec![false; colours.len() / 3];
        let owed = Owed { first: 0, gradient: colours, touched: &mut touched };
        self.push_tinted(slope, CarrierBasis::Constant, lit(appearance), owed);
    }

    fn push_tinted(&self, slope: &[f32], basis: CarrierBasis, tints: Tints, owed: Owed<'_>) {
        let (gradient, touched) = (&*owed.gradient, &*owed.touched);
        assert_eq!(slope.len(), self.width * self.height * 3, "a picture of this view's size");
        assert_eq!(gradient.len(), touched.len() * basis.width(), "a place for each row");
        rayon::scope(|scope| {
            let mut rest = owed;
            for end in self.shares(rayon::current_num_threads().min(MAX_SHARES)) {
                let (part, behind) = rest.split_at(end, basis.width());
                rest = behind;
                scope.spawn(move |_| self.push_rows(slope, basis, tints, part));
            }
            self.push_rows(slope, basis, tints, rest);
        });
    }

    /// The rows where `parts` about equally many entries end, but for the last part.
    fn shares(&self, parts: usize) -> Vec<usize> {
        let mut rows: Vec<u32> = self
            .weights
            .entries
            .iter()
            .step_by(1 + self.weights.entries.len() / SAMPLES)
            .map(|(row, _)| row & !FAR)
            .collect();
        rows.sort_unstable();
        (1..parts).filter_map(|part| rows.get(rows.len() * part / parts)).map(|row| *row as usize).collect()
    }

    /// Goes back to some of the rows.
    fn push_rows(&self, slope: &[f32], basis: CarrierBasis, tints: Tints, owed: Owed<'_>) {
        let Owed { first, gradient, touched } = owed;
        for (pixel, g) in slope.chunks_exact(3).enumerate() {
            self.ask_ahead(pixel, gradient, basis.width(), first);
            for (entries, tint) in self.seen_by(pixel).into_iter().zip(&tints) {
                let pulled: [f32; 3] = std::array::from_fn(|k| (0..3).map(|c| tint[c][k] * g[c]).sum());
                match basis {
                    CarrierBasis::Constant => {
                        let rows = gradient.as_chunks_mut::<3>().0;
                        within(entries, first, touched, |at, weight| {
                            rows[at].iter_mut().zip(pulled).for_each(|(o, p)| *o += weight * p);
                        });
                    }
                    CarrierBasis::Harmonics => {
                        let rows = gradient.as_chunks_mut::<SH>().0;
                        let along = &self.weights.harmonics[pixel];
                        within(entries, first, touched, |at, weight| {
                            for (row, p) in rows[3 * at..3 * at + 3].iter_mut().zip(pulled) {
                                row.iter_mut().zip(along).for_each(|(o, b)| *o += weight * p * b);
                            }
                        });
                    }
                }
            }
        }
    }
}

/// The weighted sum of rows' colours.
#[inline]
fn weighed(entries: &[(u32, f32)], colour: impl Fn(usize) -> [f32; 3]) -> [f32; 3] {
    entries.iter().fold([0.0; 3], |sum, (row, weight)| {
        let colour = colour((row & !FAR) as usize);
        std::array::from_fn(|k| sum[k] + weight * colour[k])
    })
}

/// Calls `each` with those entries that are among the rows from `first` on, counted from there, and marks
/// them as touched.
#[inline]
fn within(entries: &[(u32, f32)], first: usize, touched: &mut [bool], mut each: impl FnMut(usize, f32)) {
    for (row, weight) in entries {
        let at = place(*row, first);
        if let Some(touched) = touched.get_mut(at) {
            *touched = true;
            each(at, *weight);
        }
    }
}

/// An entry's row, counted from `first`; of one before, past every last.
#[inline(always)]
fn place(row: u32, first: usize) -> usize {
    ((row & !FAR) as usize).wrapping_sub(first)
}

/// What a run of rows, from the `first` on, is owed.
struct Owed<'a> {
    first: usize,
    gradient: &'a mut [f32],
    touched: &'a mut [bool],
}

impl<'a> Owed<'a> {
    /// The rows before `end` and those from it on, `width` coefficients each.
    fn split_at(self, end: usize, width: usize) -> (Self, Self) {
        let Self { first, gradient, touched } = self;
        let (gradient, gradient_behind) = gradient.split_at_mut((end - first) * width);
        let (touched, touched_behind) = touched.split_at_mut(end - first);
        (Self { first, gradient, touched }, Self { first: end, gradient: gradient_behind, touched: touched_behind })
    }
}
