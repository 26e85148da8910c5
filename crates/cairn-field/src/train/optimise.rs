//! How the rows that a batch touched move; the others are not even read.
//!
//! Debts are sorted into shares of rows; each share is one thread's alone, and within
//! it debts keep their order, so that any number of threads gives the same bytes. A
//! share's gradients are summed and used up while they are at hand: there is no
//! gradient of the whole grid.
//!
//! Densities move by Adam (Kingma and Ba 2015). A row's 27 colour coefficients share
//! one second moment, that of the constant ones, and have no first (RMSprop, Hinton
//! 2012): a twelfth of Adam's state, and the harmonics keep their proportions, for
//! the same quality a step. The pull of neighbours is added to the touched rows' gradients first.

use crate::grid::lattice::{Grid, ROW};
use crate::grid::memory::zeros;
use crate::grid::sh::SH;
use crate::render::patch::{Debt, Debts};
use rayon::prelude::*;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
const EPSILON: f32 = 1e-8;
/// RMSprop's forgetting, by touches of a row.
const MEMORY: f32 = 0.95;
/// Smoothing reads six neighbours a row and pulls gently: one step in eight, eight
/// times as hard, does the same for an eighth of the time.
const SMOOTH_EVERY: u64 = 8;
/// Rows a share has: their gradients (229 kB) stay in a core's own cache.
const SHARE: usize = 2048;

/// Adam's state: first and second moments and how many steps were taken.
pub(crate) struct Adam {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    pub(crate) steps: u64,
}

impl Adam {
    pub(crate) fn zero(len: usize) -> Self {
        Self { first: zeros(len), second: zeros(len), steps: 0 }
    }

    /// Counts a step, before the [`Adam::update`]s that belong to it.
    pub(crate) fn tick(&mut self) {
        self.steps += 1;
    }

    fn corrections(&self) -> Corrections {
        let n = self.steps.clamp(1, 1 << 20) as i32;
        Corrections { first: 1.0 / (1.0 - BETA_1.powi(n)), second: 1.0 / (1.0 - BETA_2.powi(n)) }
    }

    /// Moves `values` (whose moments start at `at`) along `gradient`.
    pub(crate) fn update(&mut self, at: usize, gradient: &[f32], values: &mut [f32], rate: f32) {
        let fix = self.corrections();
        let first = &mut self.first[at..at + values.len()];
        let second = &mut self.second[at..at + values.len()];
        for i in 0..values.len() {
            values[i] -= rate * moment(gradient[i], &mut first[i], &mut second[i], fix);
        }
    }
}

/// What the moments are multiplied by: they begin at zero.
#[derive(Clone, Copy)]
struct Corrections {
    first: f32,
    second: f32,
}

/// Adam's direction for one number.
#[inline(always)]
fn moment(g: f32, first: &mut f32, second: &mut f32, fix: Corrections) -> f32 {
    *first = BETA_1 * *first + (1.0 - BETA_1) * g;
    *second = BETA_2 * *second + (1.0 - BETA_2) * g * g;
    *first * fix.first / ((*second * fix.second).sqrt() + EPSILON)
}

/// What moving a grid's rows needs to remember of each: Adam's state of its density,
/// the mean square of its constant colour coefficients' gradient, and its largest
/// weight in any picture since that was last cleared.
pub(crate) struct RowState {
    pub(crate) adam: Adam,
    pub(crate) square: Vec<f32>,
    pub(crate) seen: Vec<f32>,
    sorted: Sorted,
}

/// Learning rates and smoothness of one step.
pub(crate) struct Rates {
    pub(crate) density: f32,
    /// Rate of the constant coefficients.
    pub(crate) colour: f32,
    /// Rate of the others, a share of that.
    pub(crate) view_dependence: f32,
    pub(crate) smooth_density: f32,
    pub(crate) smooth_colour: f32,
}

impl RowState {
    pub(crate) fn zero(rows: usize) -> Self {
        Self::from_parts(Adam::zero(rows), zeros(rows), zeros(rows))
    }

    pub(crate) fn from_parts(adam: Adam, square: Vec<f32>, seen: Vec<f32>) -> Self {
        Self { adam, square, seen, sorted: Sorted::default() }
    }

    /// One step of the whole grid by what a batch owes it, `debts` by task. Returns
    /// false, with grid and state unchanged, when smoothing has no finite gradient.
    pub(crate) fn step(&mut self, grid: &mut Grid<f32>, debts: &[&Debts<f32>], rates: &Rates) -> bool {
        self.sorted.sort(debts, grid.rows().div_ceil(SHARE));
        let sorted = &self.sorted;
        let mut pulls = Vec::new();
        if self.adam.steps.is_multiple_of(SMOOTH_EVERY) {
            let of = |share| pulls_on(grid, share, sorted.share(share, debts), rates);
            pulls = (0..sorted.shares()).into_par_iter().map(of).collect();
            if pulls.iter().any(Option::is_none) {
                return false;
            }
        }
        self.adam.tick();
        let fix = self.adam.corrections();
        let raw = by_share(&mut grid.raw, &grid.vertex);
        let shares: Vec<Share<'_>> = raw
            .into_iter()
            .zip(grid.vertex.chunks(SHARE).zip(grid.colour.chunks_mut(SHARE * ROW)))
            .zip(self.adam.first.chunks_mut(SHARE).zip(self.adam.second.chunks_mut(SHARE)))
            .zip(self.square.chunks_mut(SHARE).zip(self.seen.chunks_mut(SHARE)))
            .map(|((((from, raw), (vertex, colour)), (first, second)), (square, seen))| Share {
                from,
                raw,
                vertex,
                colour,
                first,
                second,
                square,
                seen,
            })
            .collect();
        let few = (sorted.shares() / 64).max(1);
        shares.into_par_iter().enumerate().with_min_len(few).for_each_init(Sums::new, |sums, (n, mut share)| {
            for debt in sorted.share(n, debts) {
                sums.add(debt.0, debt.1, n);
            }
            for (row, pull) in pulls.get(n).into_iter().flatten().flatten() {
                sums.pull(*row, pull);
            }
            sums.spend(|row, gradient, max_weight| share.step(row, gradient, max_weight, rates, fix));
        });
        true
    }
}

/// A share of the rows, and all that belongs to them.
struct Share<'a> {
    /// The first vertex in `raw`.
    from: usize,
    raw: &'a mut [f32],
    vertex: &'a [u32],
    colour: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    square: &'a mut [f32],
    seen: &'a mut [f32],
}

impl Share<'_> {
    /// Moves `row` (counted from the share's first) along its gradient.
    #[inline(always)]
    fn step(&mut self, row: usize, g: &[f32; ROW], max_weight: f32, rates: &Rates, fix: Corrections) {
        self.seen[row] = self.seen[row].max(max_weight);
        let raw = &mut self.raw[self.vertex[row] as usize - self.from];
        *raw -= rates.density * moment(g[ROW - 1], &mut self.first[row], &mut self.second[row], fix);
        let now = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) / 3.0;
        let square = &mut self.square[row];
        // The first touch is all that is known.
        *square = if *square == 0.0 { now } else { MEMORY * *square + (1.0 - MEMORY) * now };
        let step = rates.colour / (square.sqrt() + EPSILON);
        let colour: &mut [f32; ROW] = (&mut self.colour[row * ROW..(row + 1) * ROW]).try_into().expect("ROW numbers");
        for k in 0..3 {
            colour[k] -= step * g[k];
        }
        let harmonics = step * rates.view_dependence;
        for k in 3..ROW - 1 {
            colour[k] -= harmonics * g[k];
        }
    }
}

/// The gradients of one share's rows: coefficients, and the raw density's in the last column.
struct Sums {
    gradient: Vec<[f32; ROW]>,
    /// Largest weight in a pixel; below zero where the row was not touched.
    max_weight: Vec<f32>,
    /// Rows touched, in that order.
    touched: Vec<u16>,
}

impl Sums {
    fn new() -> Self {
        Self { gradient: vec![[0.0; ROW]; SHARE], max_weight: vec![-1.0; SHARE], touched: Vec::with_capacity(SHARE) }
    }

    #[inline(always)]
    fn add(&mut self, debt: &Debt<f32>, basis: &[f32; SH], share: usize) {
        let row = debt.row as usize - share * SHARE;
        let sum = &mut self.gradient[row];
        if self.max_weight[row] < 0.0 {
            *sum = [0.0; ROW];
            self.touched.push(row as u16);
        }
        self.max_weight[row] = self.max_weight[row].max(debt.max_weight);
        for (three, b) in sum.chunks_exact_mut(3).zip(basis) {
            for (s, light) in three.iter_mut().zip(debt.light) {
                *s += light * b;
            }
        }
        sum[ROW - 1] += debt.raw;
    }

    /// Adds smoothing's pull on a row that was touched.
    fn pull(&mut self, row: u16, pull: &[f32; ROW]) {
        for (s, p) in self.gradient[row as usize].iter_mut().zip(pull) {
            *s += p;
        }
    }

    /// Hands each touched row to `each`, then knows of none.
    #[inline(always)]
    fn spend(&mut self, mut each: impl FnMut(usize, &[f32; ROW], f32)) {
        for row in self.touched.drain(..) {
            let row = row as usize;
            each(row, &self.gradient[row], std::mem::replace(&mut self.max_weight[row], -1.0));
        }
    }
}

/// Which debts go to which share of rows.
#[derive(Default)]
struct Sorted {
    /// Task and place of each debt, by share.
    order: Vec<(u32, u32)>,
    /// Where each share begins in `order`, and the end.
    bounds: Vec<u32>,
}

/// A pointer that several threads may use on disjoint places.
struct Shared<T>(*mut T);
// SAFETY: used only by `Sorted::sort`, which gives each place to one thread.
unsafe impl<T> Sync for Shared<T> {}

impl Sorted {
    fn shares(&self) -> usize {
        self.bounds.len() - 1
    }

    /// A counting sort: how many of each task go to each share, then where.
    fn sort(&mut self, debts: &[&Debts<f32>], shares: usize) {
        let mut offsets: Vec<Vec<u32>> = debts
            .par_iter()
            .map(|debts| {
                let mut count = vec![0u32; shares];
                debts.owed.iter().for_each(|o| count[o.row as usize / SHARE] += 1);
                count
            })
            .collect();
        self.bounds.clear();
        let mut next = 0;
        for share in 0..shares {
            self.bounds.push(next);
            for offset in &mut offsets {
                let count = std::mem::replace(&mut offset[share], next);
                next += count;
            }
        }
        self.bounds.push(next);
        self.order.resize(next as usize, (0, 0));
        let slots = Shared(self.order.as_mut_ptr());
        debts.par_iter().zip(offsets).enumerate().for_each(|(task, (debts, mut offset))| {
            let slots = &slots;
            for (i, o) in debts.owed.iter().enumerate() {
                let slot = &mut offset[o.row as usize / SHARE];
                // SAFETY: the offsets give every debt a slot of its own below `next`.
                unsafe { *slots.0.add(*slot as usize) = (task as u32, i as u32) };
                *slot += 1;
            }
        });
    }

    /// The debts of a share, each with the basis of its tile.
    #[inline(always)]
    fn share<'a>(
        &'a self,
        share: usize,
        debts: &'a [&Debts<f32>],
    ) -> impl Iterator<Item = (&'a Debt<f32>, &'a [f32; SH])> {
        self.order[self.bounds[share] as usize..self.bounds[share + 1] as usize].iter().map(|&(task, i)| {
            let debts = debts[task as usize];
            let debt = &debts.owed[i as usize];
            (debt, &debts.bases[debt.tile as usize])
        })
    }
}

/// The stretch of `raw` in which each share's rows lie, and where it begins.
fn by_share<'a>(raw: &'a mut [f32], vertex: &[u32]) -> Vec<(usize, &'a mut [f32])> {
    let mut rest = (0, raw);
    vertex
        .chunks(SHARE)
        .map(|rows| {
            // Row 0 has no vertex, and as the only row of a share no stretch.
            let end = rows.last().filter(|v| **v != u32::MAX).map_or(rest.0, |v| *v as usize + 1);
            let (mine, others) = std::mem::take(&mut rest.1).split_at_mut(end - rest.0);
            let from = std::mem::replace(&mut rest.0, end);
            rest.1 = others;
            (from, mine)
        })
        .collect()
}

/// The gradient of squared differences between the rows of share `share` that `debts`
/// touch (each once, counted from the share's first) and their six neighbours; `None`
/// when one is not finite.
fn pulls_on<'a>(
    grid: &Grid<f32>,
    share: usize,
    debts: impl Iterator<Item = (&'a Debt<f32>, &'a [f32; SH])>,
    rates: &Rates,
) -> Option<Vec<(u16, [f32; ROW])>> {
    let mut met = vec![false; SHARE];
    let mut pulls = Vec::new();
    for (debt, _) in debts {
        let row = debt.row as usize - share * SHARE;
        if !std::mem::replace(&mut met[row], true) {
            let pull = pull_on(grid, debt.row as usize, rates);
            // The moments hold squares; one that is not finite makes the sum so.
            if !pull.iter().map(|g| g * g).sum::<f32>().is_finite() {
                return None;
            }
            pulls.push((row as u16, pull));
        }
    }
    Some(pulls)
}

fn pull_on(grid: &Grid<f32>, row: usize, rates: &Rates) -> [f32; ROW] {
    let (for_colour, for_density) =
        (rates.smooth_colour * SMOOTH_EVERY as f32, rates.smooth_density * SMOOTH_EVERY as f32);
    let [nx, ny, nz] = grid.dims;
    let strides = [1usize, nx, nx * ny];
    let v = grid.vertex[row] as usize;
    let at = [v % nx, v / nx % ny, v / (nx * ny)];
    let numbers =
        |row: usize| -> &[f32; ROW] { grid.colour[row * ROW..(row + 1) * ROW].try_into().expect("ROW numbers") };
    let mine = numbers(row);
    let mut pull = [0.0; ROW];
    for axis in 0..3 {
        for up in [false, true] {
            if (up && at[axis] + 1 >= [nx, ny, nz][axis]) || (!up && at[axis] == 0) {
                continue;
            }
            let neighbour = if up { v + strides[axis] } else { v - strides[axis] };
            let other = grid.index[neighbour] as usize;
            if other == 0 {
                continue;
            }
            // The last column of both is zero.
            for ((p, mine), theirs) in pull.iter_mut().zip(mine).zip(numbers(other)) {
                *p += for_colour * (mine - theirs);
            }
            pull[ROW - 1] += for_density * (grid.raw[v] - grid.raw[neighbour]);
        }
    }
    pull
}
