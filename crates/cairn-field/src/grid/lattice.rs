//! The sparse voxel grid: density and spherical harmonics at the vertices that
//! matter, nothing at the others.
//!
//! Densities lie densely, one a vertex: a ray asks for many more of them than for
//! colours. A dense index maps a vertex to its row of colours (0 = none, and then
//! no density); rows are compact.

use super::memory::{zero_rows, zeros};
use super::occupancy::Occupancy;
use super::real::{LANES, Real};
use super::sh::{SH, SH_DC};
use rayon::prelude::*;

/// Numbers a row of colour coefficients takes: 9 coefficients x 3 channels, channel
/// fastest, and one of padding (in gradients that one holds the density's).
pub const ROW: usize = 28;
/// Density is `DENSITY_SCALE * softplus(raw)` per unit-cube length, so that raw
/// values of a few units make a voxel opaque at the resolutions used here.
pub const DENSITY_SCALE: f64 = 100.0;
/// Raw density of a vertex without a row: softplus(-20) is 2e-9.
pub const EMPTY_RAW: f64 = -20.0;

/// A sparse voxel grid over the unit cube; see the module's text.
#[derive(Clone, Debug)]
pub struct Grid<T> {
    /// Vertices along x, y, z; at least 2 each.
    pub dims: [usize; 3],
    /// Row of each vertex, x fastest; 0 is the empty row. `dims` product long.
    pub index: Vec<u32>,
    /// Vertex of each row (row 0's is unused).
    pub vertex: Vec<u32>,
    /// Raw density of each vertex, x fastest. `dims` product long.
    pub raw: Vec<T>,
    /// Colour coefficients, `rows x ROW`.
    pub colour: Vec<T>,
    /// What rays may pass.
    pub occupancy: Occupancy,
}

/// Largest number of vertices of a grid: its dense index is then 2 GiB.
const MAX_VERTICES: usize = 1 << 29;

/// Whether a file's `dims` and `vertex` make a grid: two vertices a side at
/// least, not absurdly many, rows in ascending order and within.
pub(crate) fn fits(dims: [usize; 3], vertex: &[u32]) -> bool {
    let all = dims.iter().try_fold(1usize, |a, d| a.checked_mul(*d)).filter(|all| *all <= MAX_VERTICES);
    let ordered = vertex.windows(2).all(|w| w[0] < w[1]);
    all.is_some_and(|all| dims.iter().all(|d| *d >= 2) && ordered && vertex.last().is_none_or(|v| (*v as usize) < all))
}

/// A part of the unit cube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Its corner with the smallest coordinates.
    pub low: [f64; 3],
    /// Its corner with the largest.
    pub high: [f64; 3],
}

impl Part {
    /// All of it.
    pub const WHOLE: Self = Self { low: [0.0; 3], high: [1.0; 3] };
}

impl<T: Real> Grid<T> {
    /// A grid whose every vertex has a row with raw density `raw` and grey `level`.
    pub fn full(dims: [usize; 3], raw: f64, level: f64) -> Self {
        let vertices = dims.iter().product::<usize>();
        let keep = (0..vertices as u32).collect();
        let mut grid = Self::with_vertices(dims, keep);
        grid.raw.fill(T::of(raw));
        for row in grid.colour[ROW..].chunks_exact_mut(ROW) {
            row[..3].fill(T::of(level / SH_DC));
        }
        grid.refresh_occupancy(0.0);
        grid
    }

    /// A grid with rows for `vertex` (ascending linear indices), all values empty.
    pub fn with_vertices(dims: [usize; 3], mut vertex: Vec<u32>) -> Self {
        let mut index = zero_rows(dims.iter().product());
        for (row, &v) in vertex.iter().enumerate() {
            index[v as usize] = row as u32 + 1;
        }
        vertex.insert(0, u32::MAX);
        let rows = vertex.len();
        let mut raw = zeros(index.len());
        raw.fill(T::of(EMPTY_RAW));
        Self { dims, raw, index, vertex, colour: zeros(rows * ROW), occupancy: Occupancy::none(dims) }
    }

    /// Rows in use, the empty one included.
    pub fn rows(&self) -> usize {
        self.vertex.len()
    }

    /// Raw densities by row, the empty one left out.
    pub fn raw_rows(&self) -> impl Iterator<Item = T> {
        self.vertex[1..].iter().map(|v| self.raw[*v as usize])
    }

    /// Sets the raw densities of all rows but the empty one.
    ///
    /// # Panics
    /// When there are not as many as rows.
    pub fn set_raw_rows(&mut self, raw: &[T]) {
        assert_eq!(raw.len() + 1, self.rows(), "a raw density a row");
        for (v, raw) in self.vertex[1..].iter().zip(raw) {
            self.raw[*v as usize] = *raw;
        }
    }

    /// Offsets from a cell's first vertex to its eight corners, x fastest.
    pub fn corners(&self) -> [usize; 8] {
        let (dx, dy) = (1, self.dims[0]);
        let dz = self.dims[0] * self.dims[1];
        [0, dx, dy, dx + dy, dz, dz + dx, dz + dy, dz + dx + dy]
    }

    /// Marks the cells with a corner whose density exceeds `threshold` (per
    /// unit-cube length); all others are skipped by rays.
    pub fn refresh_occupancy(&mut self, threshold: f64) {
        let empty = raw_of(threshold / DENSITY_SCALE);
        let raw = &self.raw;
        self.occupancy.refresh(&self.vertex[1..], |v| raw[v as usize].wide() > empty);
    }

    /// Raw density at a point of cell `cell`, trilinear.
    #[inline(always)]
    pub(crate) fn raw_at(&self, cell: usize, frac: [T; 3]) -> T {
        let (dy, dz) = (self.dims[0], self.dims[0] * self.dims[1]);
        let edge = |at: usize| {
            let pair: &[T; 2] = self.raw[at..at + 2].try_into().expect("two vertices");
            pair[0] + (pair[1] - pair[0]) * frac[0]
        };
        let side = |at: usize| {
            let low = edge(at);
            low + (edge(at + dy) - low) * frac[1]
        };
        let low = side(cell);
        low + (side(cell + dz) - low) * frac[2]
    }

    /// Raw densities at places (by axis, a lane each) in cells, trilinear: [`Grid::raw_at`] a lane.
    #[inline(always)]
    pub(crate) fn raw_at_lanes(&self, cells: &[u32; LANES], frac: &[[T; LANES]; 3]) -> [T; LANES] {
        let (dy, dz) = (self.dims[0], self.dims[0] * self.dims[1]);
        let mut edges = [[[T::zero(); LANES]; 2]; 4];
        for k in 0..LANES {
            let cell = cells[k] as usize;
            for (edge, at) in edges.iter_mut().zip([cell, cell + dy, cell + dz, cell + dz + dy]) {
                let pair: &[T; 2] = self.raw[at..at + 2].try_into().expect("two vertices");
                (edge[0][k], edge[1][k]) = (pair[0], pair[1]);
            }
        }
        let [x, y, z] = frac;
        std::array::from_fn(|k| {
            let [a, b, c, d] = std::array::from_fn(|e| edges[e][0][k] + (edges[e][1][k] - edges[e][0][k]) * x[k]);
            let (low, high) = (a + (b - a) * y[k], c + (d - c) * y[k]);
            low + (high - low) * z[k]
        })
    }

    /// Rows of a cell's corners.
    #[inline(always)]
    pub(crate) fn corner_rows(&self, cell: usize, corners: &[usize; 8]) -> [u32; 8] {
        let mut rows = [0; 8];
        for (row, corner) in rows.iter_mut().zip(corners) {
            *row = self.index[cell + corner];
        }
        rows
    }

    /// Asks for the colours of a cell's corners ahead of their use: they lie far
    /// apart, and waiting for them was a fifth of a training step.
    #[inline(always)]
    pub(crate) fn prefetch_colour(&self, cell: usize, corners: &[usize; 8]) {
        for row in self.corner_rows(cell, corners) {
            self.prefetch_row(row);
        }
    }

    /// Asks for the colours of `row` ahead of their use.
    #[inline(always)]
    pub(crate) fn prefetch_row(&self, row: u32) {
        let row: *const T = &raw const self.colour[row as usize * ROW];
        prefetch(row);
        prefetch(row.wrapping_byte_add(64));
    }

    /// Asks for the rows of the corners of `cell` ahead of their use.
    #[inline(always)]
    pub(crate) fn prefetch_index(&self, cell: u32) {
        let at: *const u32 = &raw const self.index[cell as usize];
        let (dy, dz) = (self.dims[0], self.dims[0] * self.dims[1]);
        for corner in [0, dy, dz, dz + dy] {
            prefetch(at.wrapping_add(corner));
        }
    }

    /// Sum of `shares` times the colours of cell `cell`'s corners, seen along the
    /// direction of `basis`.
    #[inline(always)]
    pub(crate) fn light(&self, cell: usize, shares: &[T; 8], corners: &[usize; 8], basis: &[T; SH]) -> [T; 3] {
        let mut sum = [T::zero(); ROW];
        for (row, share) in self.corner_rows(cell, corners).into_iter().zip(shares) {
            for (s, v) in sum.iter_mut().zip(self.row(row)) {
                *s += *share * *v;
            }
        }
        seen_along(&sum, basis)
    }

    /// Colour of `row`, seen along the direction of `basis`.
    #[inline(always)]
    pub(crate) fn colour_along(&self, row: u32, basis: &[T; SH]) -> [T; 3] {
        seen_along(self.row(row), basis)
    }

    #[inline(always)]
    pub(crate) fn row(&self, row: u32) -> &[T; ROW] {
        let at = row as usize * ROW;
        self.colour[at..at + ROW].try_into().expect("ROW numbers")
    }

    /// By row, whether it or any of its 26 neighbours was `seen` (by row) with
    /// `min_weight` or more. The neighbours belong to it: raw density is interpolated
    /// before it is made positive, so that losing one thins the surface beside it.
    pub(crate) fn near_seen(&self, seen: &[f32], min_weight: f32) -> Vec<bool> {
        let [nx, ny, nz] = self.dims;
        let near = |a: usize, n: usize| a.saturating_sub(1)..(a + 2).min(n);
        (0..self.rows())
            .into_par_iter()
            .map(|row| {
                if row == 0 || seen[row] >= min_weight {
                    return row != 0;
                }
                let [x, y, z] = self.place(self.vertex[row]);
                near(z, nz).any(|z| {
                    near(y, ny).any(|y| {
                        near(x, nx).any(|x| {
                            let other = self.index[(z * ny + y) * nx + x] as usize;
                            other != 0 && seen[other] >= min_weight
                        })
                    })
                })
            })
            .collect()
    }

    /// The smallest box of whole cells, in unit-cube places, with `margin` cells around
    /// every row that `keep` holds for; the whole cube where there is none.
    pub(crate) fn bounds(&self, keep: &[bool], margin: usize) -> Part {
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for (v, _) in self.vertex.iter().zip(keep).skip(1).filter(|(_, keep)| **keep) {
            let at = self.place(*v);
            for k in 0..3 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k]);
            }
        }
        if low[0] > high[0] {
            return Part::WHOLE;
        }
        let unit = |v: usize, k: usize| v as f64 / (self.dims[k] - 1) as f64;
        Part {
            low: std::array::from_fn(|k| unit(low[k].saturating_sub(margin), k)),
            high: std::array::from_fn(|k| unit((high[k] + margin).min(self.dims[k] - 1), k)),
        }
    }

    /// Lattice coordinates of vertex `v`.
    fn place(&self, v: u32) -> [usize; 3] {
        let (v, [nx, ny, _]) = (v as usize, self.dims);
        [v % nx, v / nx % ny, v / (nx * ny)]
    }

    /// Multiplies every density by `factor`.
    pub(crate) fn scale_density(&mut self, factor: f64) {
        let Self { raw, vertex, .. } = self;
        for v in &vertex[1..] {
            let raw = &mut raw[*v as usize];
            let density = raw.wide().softplus_and_slope().0;
            *raw = T::of(raw_of(density * factor).max(EMPTY_RAW));
        }
    }

    /// Empties the rows that `keep` (by row) does not hold for.
    pub(crate) fn clear(&mut self, keep: &[bool]) {
        for (v, _) in self.vertex.iter().zip(keep).skip(1).filter(|(_, keep)| !**keep) {
            self.raw[*v as usize] = T::of(EMPTY_RAW);
        }
    }

    /// Allows no other cells than `words` has (a bit each, as its occupancy), and drops
    /// the rows that are then at no corner of an occupied one.
    pub(crate) fn keep_cells(&mut self, words: &[u64]) {
        let fits = self.occupancy.allow_only(words);
        debug_assert!(fits, "the words are this grid's");
        let [nx, ny, nz] = self.dims;
        let near = |a: usize, n: usize| a.saturating_sub(1)..(a + 1).min(n - 1);
        let needed = |v: u32| {
            let [x, y, z] = self.place(v);
            near(z, nz).any(|z| near(y, ny).any(|y| near(x, nx).any(|x| self.occupancy.holds([x, y, z]))))
        };
        let kept: Vec<u32> = self.vertex[1..].par_iter().copied().filter(|v| needed(*v)).collect();
        let mut grid = Self::with_vertices(self.dims, kept);
        for (v, colour) in grid.vertex[1..].iter().zip(grid.colour[ROW..].chunks_exact_mut(ROW)) {
            colour.copy_from_slice(self.row(self.index[*v as usize]));
            grid.raw[*v as usize] = self.raw[*v as usize];
        }
        std::mem::swap(&mut grid.occupancy, &mut self.occupancy);
        *self = grid;
    }

    /// A `part` of the field on a lattice
    /// that is finer (or coarser): a vertex of the result gets a row where `keep` (by old
    /// row, row 0 ignored) holds at a corner of the old cell it falls into. Values are
    /// interpolated.
    pub fn resampled(&self, dims: [usize; 3], part: Part, keep: &[bool]) -> Self {
        let Part { low, high } = part;
        let cells = self.dims.map(|d| (d - 1) as f64);
        let scale: [f64; 3] = std::array::from_fn(|k| cells[k] * (high[k] - low[k]) / (dims[k] - 1) as f64);
        let corners = self.corners();
        let locate = |v: usize| {
            let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
            let mut cell = [0usize; 3];
            let mut frac = [T::zero(); 3];
            for k in 0..3 {
                let p = (low[k] * cells[k] + at[k] as f64 * scale[k]).clamp(0.0, cells[k]);
                cell[k] = (p as usize).min(self.dims[k] - 2);
                frac[k] = T::of(p - cell[k] as f64);
            }
            ((cell[2] * self.dims[1] + cell[1]) * self.dims[0] + cell[0], frac)
        };
        let vertices: usize = dims.iter().product();
        let kept: Vec<u32> = (0..vertices)
            .into_par_iter()
            .filter(|&v| {
                let (cell, _) = locate(v);
                corners.iter().any(|&c| {
                    let row = self.index[cell + c] as usize;
                    row != 0 && keep[row]
                })
            })
            .map(|v| v as u32)
            .collect();
        let mut grid = Self::with_vertices(dims, kept);
        let Self { vertex, raw, colour, .. } = &mut grid;
        colour[ROW..].par_chunks_exact_mut(ROW).zip(&vertex[1..]).for_each(|(colour, v)| {
            let (cell, frac) = locate(*v as usize);
            let mut total = T::zero();
            for (row, weight) in self.corner_rows(cell, &corners).into_iter().zip(trilinear(frac)) {
                if row == 0 {
                    continue;
                }
                total += weight;
                for (out, v) in colour.iter_mut().zip(self.row(row)) {
                    *out += weight * *v;
                }
            }
            // An empty corner has no colour to mix in, only no density.
            if total > T::of(1e-6) {
                for out in colour.iter_mut() {
                    *out /= total;
                }
            }
        });
        let densities: Vec<T> = vertex[1..]
            .par_iter()
            .map(|v| {
                let (cell, frac) = locate(*v as usize);
                self.raw_at(cell, frac)
            })
            .collect();
        for (v, density) in vertex[1..].iter().zip(densities) {
            raw[*v as usize] = density;
        }
        grid
    }

    /// The same grid in another number type.
    pub fn cast<U: Real>(&self) -> Grid<U> {
        Grid {
            dims: self.dims,
            index: self.index.clone(),
            vertex: self.vertex.clone(),
            raw: self.raw.iter().map(|v| U::of(v.wide())).collect(),
            colour: self.colour.iter().map(|v| U::of(v.wide())).collect(),
            occupancy: self.occupancy.clone(),
        }
    }
}

/// Asks for what lies at `address`, which need not be anybody's.
#[inline(always)]
pub(crate) fn prefetch<V>(address: *const V) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing and may name any address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}

/// Trilinear weights of a cell's eight corners, x fastest.
#[inline(always)]
pub(crate) fn trilinear<T: Real>(frac: [T; 3]) -> [T; 8] {
    let one = T::one();
    let [x, y, z] = frac;
    let (x0, y0, z0) = (one - x, one - y, one - z);
    let (a, b, c, d) = (y0 * z0, y * z0, y0 * z, y * z);
    [x0 * a, x * a, x0 * b, x * b, x0 * c, x * c, x0 * d, x * d]
}

/// Colours of a row's coefficients seen along the direction of `basis`.
#[inline(always)]
pub(crate) fn seen_along<T: Real>(row: &[T; ROW], basis: &[T; SH]) -> [T; 3] {
    // Four lanes, the last one waste: then a coefficient is one vector instruction.
    let mut sum = [T::zero(); 4];
    for k in 0..SH {
        for c in 0..4 {
            sum[c] += basis[k] * row[3 * k + c];
        }
    }
    [sum[0], sum[1], sum[2]]
}

/// The raw value whose softplus is `density` (of [`DENSITY_SCALE`]); minus infinity for 0.
pub(crate) fn raw_of(density: f64) -> f64 {
    // ln(e^d - 1) without overflow.
    if density > 30.0 { density } else { density.exp_m1().ln() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::frame::RayPath;
    use crate::render::composite::{Thresholds, see};

    /// A ray along which `s` in [0, 1] runs from `a` to `b`, unit-cube places.
    fn ray(a: [f64; 3], b: [f64; 3]) -> RayPath {
        RayPath::Straight { origin: a, direction: std::array::from_fn(|k| b[k] - a[k]), start: 0.0, end: 1.0 }
    }

    #[test]
    fn a_box_drawn_in_to_what_is_there_shows_the_same() {
        // Cubic cells; something in the middle, off the walls of the whole.
        let dims = [21usize, 17, 33];
        let mut grid = Grid::<f64>::full(dims, EMPTY_RAW, 0.5);
        let held = |p: [usize; 3]| (6..12).contains(&p[0]) && (5..9).contains(&p[1]) && (9..17).contains(&p[2]);
        let mut keep = vec![false; grid.rows()];
        for row in 1..grid.rows() {
            let p = grid.place(grid.vertex[row]);
            keep[row] = held(p);
            if keep[row] {
                let n = (p[0] * 7 + p[1] * 3 + p[2]) as f64;
                grid.raw[grid.vertex[row] as usize] = -2.0 + n.sin();
                grid.colour[row * ROW] = n.cos();
            }
        }
        grid.refresh_occupancy(0.0);
        let part = grid.bounds(&keep, 1);
        let Part { low, high } = part;
        let cells: [f64; 3] = dims.map(|d| (d - 1) as f64);
        assert_eq!(low, [5.0 / cells[0], 4.0 / cells[1], 8.0 / cells[2]]);
        assert_eq!(high, [12.0 / cells[0], 9.0 / cells[1], 17.0 / cells[2]]);
        let small: [usize; 3] = std::array::from_fn(|k| ((high[k] - low[k]) * cells[k]).round() as usize + 1);
        let mut cut = grid.clone();
        // The longest side has 32 cells before and 9 after: what was a unit is longer now.
        cut.scale_density(9.0 / 32.0);
        for (v, _) in grid.vertex.iter().zip(&keep).filter(|(_, keep)| **keep) {
            let density = |grid: &Grid<f64>| grid.raw[*v as usize].softplus_and_slope().0;
            assert!((density(&cut) / density(&grid) - 9.0 / 32.0).abs() < 1e-12, "density scales at vertex {v}");
        }
        let mut cut = cut.resampled(small, part, &vec![true; grid.rows()]);
        cut.refresh_occupancy(0.0);
        let basis = crate::grid::sh::basis([0.0, 0.6, 0.8]);
        let mut tape = Vec::new();
        for (a, b) in [([0.0, 0.31, 0.2], [1.0, 0.4, 0.6]), ([0.5, 0.1, 0.9], [0.4, 0.5, 0.4])] {
            let mut seen = |grid: &Grid<f64>, a, b| {
                let limits = Thresholds { step: 0.01, ..Thresholds::EXACT };
                see(grid, &ray(a, b), &basis, limits, &mut tape)
            };
            // Only the part of the ray that lies in the smaller box: outside, nothing is there.
            let inside = |s: f64| {
                (0..3).all(|k| {
                    let p: f64 = a[k] + s * (b[k] - a[k]);
                    (low[k]..=high[k]).contains(&p)
                })
            };
            let steps: Vec<f64> = (0..=100_000).map(|i| f64::from(i) * 1e-5).filter(|s| inside(*s)).collect();
            let at = |s: f64| -> [f64; 3] { std::array::from_fn(|k| a[k] + s * (b[k] - a[k])) };
            let (from, to) = (at(steps[0]), at(steps[steps.len() - 1]));
            let moved = |p: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| (p[k] - low[k]) / (high[k] - low[k])) };
            let (whole, part) = (seen(&grid, from, to), seen(&cut, moved(from), moved(to)));
            assert!(whole.end < 0.9, "the ray is to meet something: {}", whole.end);
            // Vertices are exact; between them raw values are interpolated, and scaling is not
            // linear in those. Without it, `end` would be below 1e-3 on the first ray.
            assert!((whole.end - part.end).abs() < 0.01, "{} for {}", part.end, whole.end);
            for c in 0..3 {
                assert!((whole.near[c] - part.near[c]).abs() < 0.01, "{:?} for {:?}", part.near, whole.near);
            }
        }
    }
}
