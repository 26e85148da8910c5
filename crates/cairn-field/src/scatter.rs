//! Adding a batch's gradients into the grid, in parallel and always in the same
//! order: samples are sorted into slabs of cells; slabs of one parity share no
//! vertex, so each is one thread's alone, and within a slab samples keep their
//! order. Any number of threads gives the same bytes.

use crate::composite::{Owed, spread};
use crate::grid::{Grid, ROW};
use crate::sh::SH;
use rayon::prelude::*;

/// Gradients, and what the last batches touched.
pub struct Gradient {
    /// `rows x ROW`, the raw density's in the last column.
    pub values: Vec<f32>,
    /// Rows with a gradient in this batch.
    pub touched: Vec<bool>,
    /// Largest weight each row had in any picture since the last clearing.
    pub seen: Vec<f32>,
}

/// Cells of z in a slab; two slabs' vertices overlap by one plane only.
const SLAB: usize = 2;

/// Cells of y in a lane. Lanes only order the samples within a slab, so that
/// neighbours in memory follow one another.
const LANE: usize = 4;

/// A pointer that several threads may use on disjoint rows.
struct Shared<T>(*mut T);
// SAFETY: used only by `Gradient::add`, which gives each row to one thread.
unsafe impl<T> Sync for Shared<T> {}

impl Gradient {
    /// All zero, for a grid of `rows` rows.
    pub fn zero(rows: usize) -> Self {
        Self { values: vec![0.0; rows * ROW], touched: vec![false; rows], seen: vec![0.0; rows] }
    }

    /// Forgets the gradient, not what was seen.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.touched.fill(false);
    }

    /// Adds `owed` (chunks in batch order) into the gradient; `bases` by ray.
    pub fn add(&mut self, grid: &Grid<f32>, owed: &[Vec<Owed<f32>>], bases: &[[f32; SH]]) {
        let (nx, plane) = (grid.dims[0], grid.dims[0] * grid.dims[1]);
        let slabs = (grid.dims[2] - 1).div_ceil(SLAB);
        let lanes = (grid.dims[1] - 1).div_ceil(LANE);
        let buckets = slabs * lanes;
        let bucket_of = |o: &Owed<f32>| {
            let cell = o.cell as usize;
            cell / plane / SLAB * lanes + cell % plane / nx / LANE
        };
        // Counting sort: how many of each chunk go to each bucket, then where.
        let mut offsets: Vec<Vec<u32>> = owed
            .par_iter()
            .map(|chunk| {
                let mut count = vec![0u32; buckets];
                chunk.iter().for_each(|o| count[bucket_of(o)] += 1);
                count
            })
            .collect();
        let mut bounds = vec![0u32; slabs + 1];
        let mut next = 0;
        for bucket in 0..buckets {
            if bucket % lanes == 0 {
                bounds[bucket / lanes] = next;
            }
            for offset in &mut offsets {
                let count = std::mem::replace(&mut offset[bucket], next);
                next += count;
            }
        }
        bounds[slabs] = next;
        let mut order = vec![(0u32, 0u32); next as usize];
        let slots = Shared(order.as_mut_ptr());
        owed.par_iter().zip(offsets).enumerate().for_each(|(c, (chunk, mut offset))| {
            let slots = &slots;
            for (i, o) in chunk.iter().enumerate() {
                let slot = &mut offset[bucket_of(o)];
                // SAFETY: the offsets give every (chunk, sample) a slot of its own below `next`.
                unsafe { *slots.0.add(*slot as usize) = (c as u32, i as u32) };
                *slot += 1;
            }
        });
        let corners = grid.corners();
        let values = Shared(self.values.as_mut_ptr());
        let touched = Shared(self.touched.as_mut_ptr());
        let seen = Shared(self.seen.as_mut_ptr());
        for parity in 0..2 {
            (0..slabs).into_par_iter().filter(|s| s % 2 == parity).for_each(|slab| {
                let (values, touched, seen) = (&values, &touched, &seen);
                for &(c, i) in &order[bounds[slab] as usize..bounds[slab + 1] as usize] {
                    let o = &owed[c as usize][i as usize];
                    spread(grid, &corners, o, &bases[o.ray as usize], |row, share, add| {
                        // SAFETY: `row` is a row of the grid (index < rows, ROW numbers each), and
                        // its vertex lies in this slab's planes, which no other slab of this parity has.
                        unsafe {
                            let out = std::slice::from_raw_parts_mut(values.0.add(row * ROW), ROW);
                            for (g, a) in out.iter_mut().zip(add) {
                                *g += share * a;
                            }
                            *touched.0.add(row) = true;
                            let most = &mut *seen.0.add(row);
                            *most = most.max(share * o.weight);
                        }
                    });
                }
            });
        }
    }
}
