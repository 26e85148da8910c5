//! How the rows that a batch touched move; the others are not even read.
//!
//! Densities move by Adam (Kingma and Ba 2015). A row's 27 colour coefficients share
//! one second moment, that of the constant ones, and have no first (RMSprop, Hinton
//! 2012): a twelfth of Adam's state, and the harmonics keep their proportions, for
//! the same quality a step. Total variation is added to the touched rows' gradients first.

use crate::grid::{Grid, ROW};
use crate::memory::zeros;
use crate::scatter::Gradient;
use rayon::prelude::*;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
const EPSILON: f32 = 1e-8;
/// RMSprop's forgetting, by touches of a row.
const MEMORY: f32 = 0.95;
/// Smoothing reads six neighbours a row and pulls gently: one step in eight, eight
/// times as hard, does the same for an eighth of the time.
const SMOOTH_EVERY: u64 = 8;
/// Rows a task handles.
const TASK: usize = 2048;

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

    fn corrections(&self) -> (f32, f32) {
        let n = self.steps.clamp(1, 1 << 20) as i32;
        (1.0 / (1.0 - BETA_1.powi(n)), 1.0 / (1.0 - BETA_2.powi(n)))
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

/// Adam's direction for one number.
#[inline(always)]
fn moment(g: f32, first: &mut f32, second: &mut f32, fix: (f32, f32)) -> f32 {
    *first = BETA_1 * *first + (1.0 - BETA_1) * g;
    *second = BETA_2 * *second + (1.0 - BETA_2) * g * g;
    *first * fix.0 / ((*second * fix.1).sqrt() + EPSILON)
}

/// What moving a grid's rows needs to remember of each: Adam's state of its density,
/// and the mean square of its constant colour coefficients' gradient.
pub(crate) struct RowState {
    pub(crate) adam: Adam,
    pub(crate) square: Vec<f32>,
}

/// Learning rates and smoothness of one step.
pub(crate) struct Rates {
    pub(crate) density: f32,
    pub(crate) colour: f32,
    pub(crate) view_dependence: f32,
    pub(crate) smooth_density: f32,
    pub(crate) smooth_colour: f32,
}

impl RowState {
    pub(crate) fn zero(rows: usize) -> Self {
        Self { adam: Adam::zero(rows), square: zeros(rows) }
    }

    /// One step of the whole grid; clears the gradient. Returns false, with grid
    /// and state unchanged, when a gradient is not finite.
    pub(crate) fn step(&mut self, grid: &mut Grid<f32>, gradient: &mut Gradient, rates: &Rates) -> bool {
        let smooth_now = self.adam.steps.is_multiple_of(SMOOTH_EVERY);
        if !smooth(grid, gradient, rates, smooth_now) {
            return false;
        }
        self.adam.tick();
        let fix = self.adam.corrections();
        let mut raw = by_task(&mut grid.raw, &grid.vertex);
        let tasks = gradient
            .values
            .par_chunks_mut(TASK * ROW)
            .zip(gradient.weight.par_chunks_mut(TASK))
            .zip(raw.par_iter_mut().zip(grid.vertex.par_chunks(TASK)))
            .zip(grid.colour.par_chunks_mut(TASK * ROW))
            .zip(self.adam.first.par_chunks_mut(TASK).zip(self.adam.second.par_chunks_mut(TASK)))
            .zip(self.square.par_chunks_mut(TASK))
            .zip(gradient.seen.par_chunks_mut(TASK).zip(gradient.seen_now.par_chunks_mut(TASK)));
        tasks.for_each(
            |((((((gradient, weight), ((from, raw), vertex)), colour), (first, second)), square), (seen, seen_now))| {
                for row in 0..weight.len() {
                    let weight = std::mem::take(&mut weight[row]);
                    if weight == 0.0 {
                        continue;
                    }
                    seen[row] = seen[row].max(std::mem::take(&mut seen_now[row]));
                    let at = row * ROW..(row + 1) * ROW;
                    let (g, c): (&mut [f32; ROW], &mut [f32; ROW]) = (
                        (&mut gradient[at.clone()]).try_into().expect("ROW numbers"),
                        (&mut colour[at]).try_into().expect("ROW numbers"),
                    );
                    let raw = &mut raw[vertex[row] as usize - *from];
                    *raw -= rates.density * moment(g[ROW - 1], &mut first[row], &mut second[row], fix);
                    g[ROW - 1] = 0.0;
                    let now = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) / 3.0;
                    // The first touch is all that is known.
                    square[row] = if square[row] == 0.0 { now } else { MEMORY * square[row] + (1.0 - MEMORY) * now };
                    let step = rates.colour / (square[row].sqrt() + EPSILON);
                    for k in 0..3 {
                        c[k] -= step * g[k];
                    }
                    let step = step * rates.view_dependence;
                    for k in 3..ROW {
                        c[k] -= step * g[k];
                    }
                    *g = [0.0; ROW];
                }
            },
        );
        true
    }
}

/// The stretch of `raw` in which each task's rows lie, and where it begins.
fn by_task<'a>(raw: &'a mut [f32], vertex: &[u32]) -> Vec<(usize, &'a mut [f32])> {
    let mut rest = (0, raw);
    vertex
        .chunks(TASK)
        .map(|rows| {
            // Row 0 has no vertex, and as the only row of a task no stretch.
            let end = rows.last().filter(|v| **v != u32::MAX).map_or(rest.0, |v| *v as usize + 1);
            let (mine, others) = std::mem::take(&mut rest.1).split_at_mut(end - rest.0);
            let from = std::mem::replace(&mut rest.0, end);
            rest.1 = others;
            (from, mine)
        })
        .collect()
}

/// With `now`, adds the gradient of squared differences between touched vertices
/// and their six neighbours; false when any touched gradient is not finite.
fn smooth(grid: &Grid<f32>, gradient: &mut Gradient, rates: &Rates, now: bool) -> bool {
    let (for_colour, for_density) =
        (rates.smooth_colour * SMOOTH_EVERY as f32, rates.smooth_density * SMOOTH_EVERY as f32);
    let [nx, ny, nz] = grid.dims;
    let strides = [1usize, nx, nx * ny];
    gradient
        .values
        .par_chunks_mut(TASK * ROW)
        .zip(gradient.weight.par_chunks(TASK))
        .enumerate()
        .map(|(task, (values, weight))| {
            let mut fine = true;
            for (i, _) in weight.iter().enumerate().filter(|(_, w)| **w != 0.0) {
                let row = task * TASK + i;
                let v = grid.vertex[row] as usize;
                let at = [v % nx, v / nx % ny, v / (nx * ny)];
                let out: &mut [f32; ROW] = (&mut values[i * ROW..(i + 1) * ROW]).try_into().expect("ROW numbers");
                let mine: &[f32; ROW] = grid.colour[row * ROW..(row + 1) * ROW].try_into().expect("ROW numbers");
                for axis in 0..if now { 3 } else { 0 } {
                    for up in [false, true] {
                        if (up && at[axis] + 1 >= [nx, ny, nz][axis]) || (!up && at[axis] == 0) {
                            continue;
                        }
                        let neighbour = if up { v + strides[axis] } else { v - strides[axis] };
                        let other = grid.index[neighbour] as usize;
                        if other == 0 {
                            continue;
                        }
                        let theirs: &[f32; ROW] =
                            grid.colour[other * ROW..(other + 1) * ROW].try_into().expect("ROW numbers");
                        // The last column of both is zero.
                        for k in 0..ROW {
                            out[k] += for_colour * (mine[k] - theirs[k]);
                        }
                        out[ROW - 1] += for_density * (grid.raw[v] - grid.raw[neighbour]);
                    }
                }
                // The moments hold squares; one that is not finite makes the sum so.
                fine &= out.iter().map(|g| g * g).sum::<f32>().is_finite();
            }
            fine
        })
        .reduce(|| true, |a, b| a && b)
}
