//! Adding a batch's gradients into the grid, in parallel and always in the same
//! order: samples are sorted into slabs of cells; slabs of one parity share no
//! vertex, so each is one thread's alone, and within a slab samples keep their
//! order. Any number of threads gives the same bytes.

use crate::composite::{Debts, Owed};
use crate::grid::{Grid, ROW};
use crate::memory::zeros;
use rayon::prelude::*;

/// Gradients, and what the last batches touched.
pub struct Gradient {
    /// `rows x ROW`, the raw density's in the last column.
    pub values: Vec<f32>,
    /// What each row weighs in the batch's pixels, all together; 0 in rows without a gradient.
    pub weight: Vec<f32>,
    /// Largest weight each row had in any picture since the last clearing.
    pub seen: Vec<f32>,
    /// The same for this batch alone, which may yet be refused.
    pub seen_now: Vec<f32>,
    /// Room to sort a batch in: task and place of each of its debts.
    order: Vec<(u32, u32)>,
}

/// Cells of z in a slab; two slabs' vertices overlap by one plane only.
const SLAB: usize = 4;

/// A pointer that several threads may use on disjoint rows.
struct Shared<T>(*mut T);
// SAFETY: used only by `Gradient::add`, which gives each row to one thread.
unsafe impl<T> Sync for Shared<T> {}

impl Gradient {
    /// All zero, for a grid of `rows` rows.
    pub fn zero(rows: usize) -> Self {
        Self {
            values: zeros(rows * ROW),
            weight: zeros(rows),
            seen: zeros(rows),
            seen_now: zeros(rows),
            order: Vec::new(),
        }
    }

    /// Forgets the gradient, not what was seen.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.weight.fill(0.0);
        self.seen_now.fill(0.0);
    }

    /// Adds a batch, `debts` by task, into the gradient.
    pub fn add(&mut self, grid: &Grid<f32>, debts: &[&Debts<f32>]) {
        let plane = grid.dims[0] * grid.dims[1];
        let slabs = (grid.dims[2] - 1).div_ceil(SLAB);
        let slab_of = |o: &Owed<f32>| o.cell as usize / plane / SLAB;
        // Counting sort: how many of each chunk go to each slab, then where.
        let mut offsets: Vec<Vec<u32>> = debts
            .par_iter()
            .map(|debts| {
                let mut count = vec![0u32; slabs];
                debts.owed.iter().for_each(|o| count[slab_of(o)] += 1);
                count
            })
            .collect();
        let mut bounds = vec![0u32; slabs + 1];
        let mut next = 0;
        for slab in 0..slabs {
            bounds[slab] = next;
            for offset in &mut offsets {
                let count = std::mem::replace(&mut offset[slab], next);
                next += count;
            }
        }
        bounds[slabs] = next;
        self.order.resize(next as usize, (0, 0));
        let slots = Shared(self.order.as_mut_ptr());
        debts.par_iter().zip(offsets).enumerate().for_each(|(c, (debts, mut offset))| {
            let slots = &slots;
            for (i, o) in debts.owed.iter().enumerate() {
                let slot = &mut offset[slab_of(o)];
                // SAFETY: the offsets give every (chunk, sample) a slot of its own below `next`.
                unsafe { *slots.0.add(*slot as usize) = (c as u32, i as u32) };
                *slot += 1;
            }
        });
        let order = &self.order;
        let corners = grid.corners();
        let values = Shared(self.values.as_mut_ptr());
        let weight = Shared(self.weight.as_mut_ptr());
        let seen = Shared(self.seen_now.as_mut_ptr());
        for parity in 0..2 {
            (0..slabs).into_par_iter().filter(|s| s % 2 == parity).for_each(|slab| {
                let (values, weight, seen) = (&values, &weight, &seen);
                for &(c, i) in &order[bounds[slab] as usize..bounds[slab + 1] as usize] {
                    let debts = debts[c as usize];
                    let o = &debts.owed[i as usize];
                    let add = o.row(&debts.bases[o.ray as usize]);
                    for (k, row) in grid.corner_rows(o.cell as usize, &corners).into_iter().enumerate() {
                        if row == 0 {
                            continue;
                        }
                        let row = row as usize;
                        // SAFETY: `row` is a row of the grid (index < rows, ROW numbers each), and
                        // its vertex lies in this slab's planes, which no other slab of this parity has.
                        unsafe {
                            let out = &mut *values.0.add(row * ROW).cast::<[f32; ROW]>();
                            for (g, a) in out.iter_mut().zip(&add) {
                                *g += o.shares[k] * a;
                            }
                            out[ROW - 1] += o.boost * o.raw[k];
                            *weight.0.add(row) += o.shares[k];
                            let most = &mut *seen.0.add(row);
                            *most = most.max(o.shares[k]);
                        }
                    }
                }
            });
        }
    }
}
