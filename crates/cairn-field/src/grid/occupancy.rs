//! Which cells of the lattice may hold anything, in a form that lets rays pass
//! empty space in few strides: a bit a cell, gathered in blocks of 4 x 4 x 4, and
//! for every empty block how far off the nearest occupied one is.

use super::real::LANES;
use rayon::prelude::*;

/// Cells along a block's side: its 64 bits are one word.
pub(crate) const BLOCK: usize = 4;
/// Farthest distance that is told apart, blocks.
const FARTHEST: u8 = 64;

/// See the module's text. Cells are named by their first vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Occupancy {
    /// Vertices along each side.
    dims: [usize; 3],
    /// Blocks along each side.
    blocks: [usize; 3],
    /// A block's cells, x fastest.
    masks: Vec<u64>,
    /// Those that may be occupied at all: the others hold nothing, whatever the
    /// densities at their corners.
    allowed: Vec<u64>,
    /// Chebyshev distance to the nearest occupied block, 0 in those themselves.
    reach: Vec<u8>,
}

impl Occupancy {
    /// Nothing occupied, for a lattice of `dims` vertices.
    pub(crate) fn none(dims: [usize; 3]) -> Self {
        let blocks = dims.map(|d| (d - 1).div_ceil(BLOCK));
        let all = blocks.iter().product();
        Self { dims, blocks, masks: vec![0; all], allowed: vec![u64::MAX; all], reach: vec![FARTHEST; all] }
    }

    /// Marks the eight cells around each of `vertices` (ascending linear indices) that
    /// `holds`, as far as they are allowed.
    pub(crate) fn refresh(&mut self, vertices: &[u32], holds: impl Fn(u32) -> bool + Sync) {
        let [nx, ny, nz] = self.dims;
        let [bx, by, _] = self.blocks;
        let plane = nx * ny;
        let layers = self.masks.par_chunks_mut(bx * by).zip(self.allowed.par_chunks(bx * by));
        layers.enumerate().for_each(|(layer, (masks, allowed))| {
            masks.fill(0);
            // The cells of this layer touch one plane of vertices more than they are.
            let cells = layer * BLOCK..((layer + 1) * BLOCK).min(nz - 1);
            let first = vertices.partition_point(|v| (*v as usize) < cells.start * plane);
            let last = vertices.partition_point(|v| (*v as usize) < (cells.end + 1) * plane);
            for v in vertices[first..last].iter().filter(|v| holds(**v)) {
                let (x, y, z) = (*v as usize % nx, *v as usize / nx % ny, *v as usize / plane);
                for cz in z.saturating_sub(1).max(cells.start)..(z + 1).min(cells.end) {
                    for cy in y.saturating_sub(1)..(y + 1).min(ny - 1) {
                        for cx in x.saturating_sub(1)..(x + 1).min(nx - 1) {
                            masks[cy / BLOCK * bx + cx / BLOCK] |= 1 << bit([cx, cy, cz]);
                        }
                    }
                }
            }
            masks.iter_mut().zip(allowed).for_each(|(mask, allowed)| *mask &= allowed);
        });
        self.measure();
    }

    /// Allows no other cells than `words` has (and than were allowed); false, with
    /// nothing changed, when they are another lattice's.
    pub(crate) fn allow_only(&mut self, words: &[u64]) -> bool {
        let fits = words.len() == self.masks.len();
        if fits {
            let both = self.masks.iter_mut().zip(&mut self.allowed);
            for ((mask, allowed), word) in both.zip(words) {
                *mask &= word;
                *allowed &= word;
            }
            self.measure();
        }
        fits
    }

    /// The cells that may be occupied, a bit each, as [`Occupancy::words`].
    pub(crate) fn allowed(&self) -> &[u64] {
        &self.allowed
    }

    /// The distances, by one sweep each way over all neighbours (Rosenfeld and Pfaltz 1966).
    fn measure(&mut self) {
        let [bx, by, bz] = self.blocks;
        for (reach, mask) in self.reach.iter_mut().zip(&self.masks) {
            *reach = if *mask == 0 { FARTHEST } else { 0 };
        }
        let near = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
        let all = bx * by * bz;
        for at in (0..all).chain((0..all).rev()) {
            if self.reach[at] <= 1 {
                continue;
            }
            let (x, y, z) = (at % bx, at / bx % by, at / (bx * by));
            let mut least = self.reach[at];
            for z in near(z, bz) {
                for y in near(y, by) {
                    for x in near(x, bx) {
                        least = least.min(self.reach[(z * by + y) * bx + x] + 1);
                    }
                }
            }
            self.reach[at] = least;
        }
    }

    /// The bits, for checkpoints: they lag behind the densities between refreshes,
    /// so they are part of the state.
    pub(crate) fn words(&self) -> &[u64] {
        &self.masks
    }

    /// Takes stored bits over; false when they are another lattice's.
    pub(crate) fn restore(&mut self, words: Vec<u64>) -> bool {
        let fits = words.len() == self.masks.len();
        if fits {
            self.masks = words;
            self.measure();
        }
        fits
    }

    /// Where cell `at`'s block is.
    #[inline(always)]
    pub(crate) fn block_of(&self, at: [usize; 3]) -> usize {
        ((at[2] / BLOCK) * self.blocks[1] + at[1] / BLOCK) * self.blocks[0] + at[0] / BLOCK
    }

    /// Of the cells `at` (by axis, a lane each), which may hold anything: a bit each.
    #[inline(always)]
    pub(crate) fn held(&self, at: [[u32; LANES]; 3]) -> u32 {
        let [x, y, z] = at;
        let (bx, by, side) = (self.blocks[0] as u32, self.blocks[1] as u32, BLOCK as u32);
        let block: [u32; LANES] = std::array::from_fn(|k| (z[k] / side * by + y[k] / side) * bx + x[k] / side);
        let bit: [u32; LANES] = std::array::from_fn(|k| (z[k] % side * side + y[k] % side) * side + x[k] % side);
        let mut held = 0;
        for k in 0..LANES {
            held |= ((self.masks[block[k] as usize] >> bit[k] & 1) as u32) << k;
        }
        held
    }

    /// Blocks to the nearest occupied one from each of `blocks` (by axis, a lane each).
    #[inline(always)]
    pub(crate) fn reaches<const N: usize>(&self, blocks: &[[i32; N]; 3]) -> [i32; N] {
        let [x, y, z] = blocks;
        let (bx, by) = (self.blocks[0] as i32, self.blocks[1] as i32);
        let at: [i32; N] = std::array::from_fn(|k| (z[k] * by + y[k]) * bx + x[k]);
        at.map(|at| i32::from(self.reach[at as usize]))
    }

    /// Cell `at`'s block and its bit therein.
    pub(crate) fn place(&self, at: [usize; 3]) -> (usize, usize) {
        (self.block_of(at), bit(at))
    }

    /// Whether cell `at` may hold anything.
    pub fn holds(&self, at: [usize; 3]) -> bool {
        self.masks[self.block_of(at)] >> bit(at) & 1 == 1
    }

    /// Occupied cells.
    pub fn cells(&self) -> usize {
        self.masks.iter().map(|m| m.count_ones() as usize).sum()
    }
}

/// A cell's bit in its block.
#[inline(always)]
pub(crate) fn bit(at: [usize; 3]) -> usize {
    (at[2] % BLOCK * BLOCK + at[1] % BLOCK) * BLOCK + at[0] % BLOCK
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_and_distances_are_those_of_the_definitions() {
        let dims = [30, 23, 41];
        let at = |x: usize, y: usize, z: usize| ((z * 23 + y) * 30 + x) as u32;
        let vertices = [at(0, 0, 0), at(7, 9, 3), at(8, 8, 8), at(29, 22, 40)];
        let mut found = Occupancy::none(dims);
        found.refresh(&vertices, |v| v != at(7, 9, 3));
        let near = |v: u32, c: [usize; 3]| {
            let p = [v as usize % 30, v as usize / 30 % 23, v as usize / (30 * 23)];
            (0..3).all(|k| c[k] == p[k] || c[k] + 1 == p[k])
        };
        let mut count = 0;
        for c in (0..29 * 22 * 40).map(|i| [i % 29, i / 29 % 22, i / (29 * 22)]) {
            let expected = [vertices[0], vertices[2], vertices[3]].iter().any(|v| near(*v, c));
            assert_eq!(found.holds(c), expected, "{c:?}");
            count += usize::from(expected);
        }
        assert_eq!(found.cells(), count);
        let [bx, by, bz] = found.blocks;
        let full: Vec<[usize; 3]> =
            (0..bx * by * bz).filter(|b| found.masks[*b] != 0).map(|b| [b % bx, b / bx % by, b / (bx * by)]).collect();
        for b in 0..bx * by * bz {
            let p = [b % bx, b / bx % by, b / (bx * by)];
            let far = |q: &[usize; 3]| (0..3).map(|k| p[k].abs_diff(q[k])).max().unwrap();
            assert_eq!(usize::from(found.reach[b]), full.iter().map(far).min().unwrap(), "block {p:?}");
        }
    }
}
