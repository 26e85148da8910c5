//! The sparse voxel grid: density and spherical harmonics at the vertices that
//! matter, nothing at the others.
//!
//! A dense index maps a vertex to a row (0 = empty); rows are compact. Two bit
//! sets over cells and over blocks of cells let rays pass empty space.

use crate::real::{Real, softplus};
use crate::sh::SH;
use rayon::prelude::*;

/// Numbers a row of colour coefficients takes: 3 channels x 9 and one of padding
/// (in gradients that one holds the density's).
pub const ROW: usize = 28;
/// Density is `DENSITY_SCALE * softplus(raw)` per unit-cube length, so that raw
/// values of a few units make a voxel opaque at the resolutions used here.
pub const DENSITY_SCALE: f64 = 100.0;
/// Raw density of the empty row: softplus(-20) is 2e-9.
pub const EMPTY_RAW: f64 = -20.0;
/// Cells along a block's side.
const BLOCK: usize = 8;

/// A sparse voxel grid over the unit cube; see the module's text.
#[derive(Clone, Debug)]
pub struct Grid<T> {
    /// Vertices along x, y, z; at least 2 each.
    pub dims: [usize; 3],
    /// Row of each vertex, x fastest; 0 is the empty row. `dims` product long.
    pub index: Vec<u32>,
    /// Vertex of each row (row 0's is unused).
    pub vertex: Vec<u32>,
    /// Raw density a row.
    pub raw: Vec<T>,
    /// Colour coefficients, `rows x ROW`: channel-major, 9 a channel.
    pub colour: Vec<T>,
    cells: Vec<u64>,
    blocks: Vec<u64>,
    block_dims: [usize; 3],
}

/// Most vertices a grid may have: its dense index is then 2 GiB.
const MOST_VERTICES: usize = 1 << 29;

/// Whether a file's `dims` and `vertex` make a grid: two vertices a side at
/// least, not absurdly many, rows in ascending order and within.
pub(crate) fn fits(dims: [usize; 3], vertex: &[u32]) -> bool {
    let all = dims.iter().try_fold(1usize, |a, d| a.checked_mul(*d)).filter(|all| *all <= MOST_VERTICES);
    let ordered = vertex.windows(2).all(|w| w[0] < w[1]);
    all.is_some_and(|all| dims.iter().all(|d| *d >= 2) && ordered && vertex.last().is_none_or(|v| (*v as usize) < all))
}

impl<T: Real> Grid<T> {
    /// A grid whose every vertex has a row with raw density `raw` and grey `level`.
    pub fn full(dims: [usize; 3], raw: f64, level: f64) -> Self {
        let vertices = dims.iter().product::<usize>();
        let keep = (0..vertices as u32).collect();
        let mut grid = Self::with_vertices(dims, keep);
        grid.raw[1..].fill(T::of(raw));
        for row in grid.colour[ROW..].chunks_exact_mut(ROW) {
            for c in 0..3 {
                row[c * SH] = T::of(level / crate::sh::SH_DC);
            }
        }
        grid.refresh_occupancy(0.0);
        grid
    }

    /// A grid with rows for `vertex` (ascending linear indices), all values empty.
    pub fn with_vertices(dims: [usize; 3], mut vertex: Vec<u32>) -> Self {
        let mut index = vec![0u32; dims.iter().product()];
        for (row, &v) in vertex.iter().enumerate() {
            index[v as usize] = row as u32 + 1;
        }
        vertex.insert(0, u32::MAX);
        let rows = vertex.len();
        let block_dims = dims.map(|d| (d - 1).div_ceil(BLOCK));
        Self {
            dims,
            index,
            vertex,
            raw: vec![T::of(EMPTY_RAW); rows],
            colour: vec![T::zero(); rows * ROW],
            cells: vec![0; dims.iter().product::<usize>().div_ceil(64)],
            blocks: vec![0; block_dims.iter().product::<usize>().div_ceil(64)],
            block_dims,
        }
    }

    /// Rows in use, the empty one included.
    pub fn rows(&self) -> usize {
        self.raw.len()
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
        let [nx, ny, nz] = self.dims;
        let occupied: Vec<bool> = self.raw.par_iter().map(|r| DENSITY_SCALE * softplus(r.wide()) > threshold).collect();
        self.cells.fill(0);
        self.blocks.fill(0);
        for row in 1..self.rows() {
            if !occupied[row] {
                continue;
            }
            let v = self.vertex[row] as usize;
            let (x, y, z) = (v % nx, v / nx % ny, v / (nx * ny));
            for cz in z.saturating_sub(1)..(z + 1).min(nz - 1) {
                for cy in y.saturating_sub(1)..(y + 1).min(ny - 1) {
                    for cx in x.saturating_sub(1)..(x + 1).min(nx - 1) {
                        let cell = (cz * ny + cy) * nx + cx;
                        self.cells[cell / 64] |= 1 << (cell % 64);
                        let block = self.block_of(cx, cy, cz);
                        self.blocks[block / 64] |= 1 << (block % 64);
                    }
                }
            }
        }
    }

    /// The cells' occupancy as stored in checkpoints: it lags behind the
    /// densities between refreshes, so it is part of the state.
    pub(crate) fn occupancy(&self) -> &[u64] {
        &self.cells
    }

    /// Takes over a stored occupancy; false when it is of another grid.
    pub(crate) fn restore_occupancy(&mut self, cells: Vec<u64>) -> bool {
        if cells.len() != self.cells.len() {
            return false;
        }
        let [nx, ny, nz] = self.dims;
        self.cells = cells;
        self.blocks.fill(0);
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                for x in 0..nx - 1 {
                    if self.cell_occupied((z * ny + y) * nx + x) {
                        let block = self.block_of(x, y, z);
                        self.blocks[block / 64] |= 1 << (block % 64);
                    }
                }
            }
        }
        true
    }

    #[inline(always)]
    fn block_of(&self, x: usize, y: usize, z: usize) -> usize {
        ((z / BLOCK) * self.block_dims[1] + y / BLOCK) * self.block_dims[0] + x / BLOCK
    }

    /// Whether the cell with first vertex `cell` may hold anything.
    #[inline(always)]
    pub(crate) fn cell_occupied(&self, cell: usize) -> bool {
        self.cells[cell / 64] >> (cell % 64) & 1 == 1
    }

    /// Whether the block of cells around cell (x, y, z) may hold anything.
    #[inline(always)]
    pub(crate) fn block_occupied(&self, x: usize, y: usize, z: usize) -> bool {
        let block = self.block_of(x, y, z);
        self.blocks[block / 64] >> (block % 64) & 1 == 1
    }

    /// Cells along a block's side, for the traversal.
    pub(crate) const fn block_side() -> usize {
        BLOCK
    }

    /// Raw density at a point of cell `cell`, trilinear.
    #[inline(always)]
    pub(crate) fn raw_at(&self, cell: usize, weights: &[T; 8], corners: &[usize; 8]) -> T {
        let mut raw = T::zero();
        for k in 0..8 {
            raw += weights[k] * self.raw[self.index[cell + corners[k]] as usize];
        }
        raw
    }

    /// Asks for the colours of a cell's corners ahead of [`Grid::colour_at`]:
    /// rows lie far apart, and waiting for them was a fifth of a training step.
    #[inline(always)]
    pub(crate) fn prefetch_colour(&self, cell: usize, corners: &[usize; 8]) {
        #[cfg(target_arch = "x86_64")]
        for corner in corners {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let row: *const T = &raw const self.colour[self.index[cell + corner] as usize * ROW];
            // SAFETY: a prefetch reads nothing and may name any address.
            unsafe {
                _mm_prefetch::<_MM_HINT_T0>(row.cast());
                _mm_prefetch::<_MM_HINT_T0>(row.wrapping_byte_add(64).cast());
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = (cell, corners);
    }

    /// Colour at a point of cell `cell` seen along the direction of `basis`.
    #[inline(always)]
    pub(crate) fn colour_at(&self, cell: usize, weights: &[T; 8], corners: &[usize; 8], basis: &[T; SH]) -> [T; 3] {
        let mut sum = [T::zero(); ROW];
        for k in 0..8 {
            let row = self.index[cell + corners[k]] as usize * ROW;
            let row: &[T; ROW] = self.colour[row..row + ROW].try_into().expect("ROW numbers");
            for (s, v) in sum.iter_mut().zip(row) {
                *s += weights[k] * *v;
            }
        }
        let dot = |c: usize| {
            let mut v = T::zero();
            for k in 0..SH {
                v += sum[c * SH + k] * basis[k];
            }
            v
        };
        [dot(0), dot(1), dot(2)]
    }

    /// By row, whether it or any of its 26 neighbours was `seen` (by row) with at
    /// least `least`. The neighbours belong to it: raw density is interpolated
    /// before it is made positive, so that losing one thins the surface beside it.
    pub(crate) fn near_seen(&self, seen: &[f32], least: f32) -> Vec<bool> {
        let [nx, ny, nz] = self.dims;
        let near = |a: usize, n: usize| a.saturating_sub(1)..(a + 2).min(n);
        (0..self.rows())
            .into_par_iter()
            .map(|row| {
                if row == 0 || seen[row] >= least {
                    return row != 0;
                }
                let v = self.vertex[row] as usize;
                let (x, y, z) = (v % nx, v / nx % ny, v / (nx * ny));
                near(z, nz).any(|z| {
                    near(y, ny).any(|y| {
                        near(x, nx).any(|x| {
                            let other = self.index[(z * ny + y) * nx + x] as usize;
                            other != 0 && seen[other] >= least
                        })
                    })
                })
            })
            .collect()
    }

    /// Empties the rows that `keep` (by row) does not hold for.
    pub(crate) fn clear(&mut self, keep: &[bool]) {
        for (raw, _) in self.raw.iter_mut().zip(keep).filter(|(_, keep)| !**keep) {
            *raw = T::of(EMPTY_RAW);
        }
    }

    /// The same field on a finer (or coarser) lattice: a vertex of the result
    /// gets a row where `keep` (by old row, row 0 ignored) holds at a corner of
    /// the old cell it falls into. Values are interpolated.
    pub fn resampled(&self, dims: [usize; 3], keep: &[bool]) -> Self {
        let scale: [f64; 3] = std::array::from_fn(|k| (self.dims[k] - 1) as f64 / (dims[k] - 1) as f64);
        let corners = self.corners();
        let locate = |v: usize| {
            let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
            let mut cell = [0usize; 3];
            let mut frac = [T::zero(); 3];
            for k in 0..3 {
                let p = at[k] as f64 * scale[k];
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
        let vertex = &grid.vertex;
        grid.raw[1..].par_iter_mut().zip(grid.colour[ROW..].par_chunks_exact_mut(ROW)).enumerate().for_each(
            |(i, (raw, colour))| {
                let (cell, frac) = locate(vertex[i + 1] as usize);
                let weights = trilinear(frac);
                *raw = self.raw_at(cell, &weights, &corners);
                let mut total = T::zero();
                for k in 0..8 {
                    let row = self.index[cell + corners[k]] as usize;
                    if row == 0 {
                        continue;
                    }
                    total += weights[k];
                    for (out, v) in colour.iter_mut().zip(&self.colour[row * ROW..(row + 1) * ROW]) {
                        *out += weights[k] * *v;
                    }
                }
                // An empty corner has no colour to mix in, only no density.
                if total > T::of(1e-6) {
                    for out in colour.iter_mut() {
                        *out /= total;
                    }
                }
            },
        );
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
            cells: self.cells.clone(),
            blocks: self.blocks.clone(),
            block_dims: self.block_dims,
        }
    }
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
