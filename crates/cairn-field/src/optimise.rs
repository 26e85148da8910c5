//! Adam (Kingma and Ba 2015) on the rows a batch touched; the others are not
//! even read. Total variation is added to those rows' gradients first.

use crate::grid::{Grid, ROW};
use crate::scatter::Gradient;
use crate::sh::SH;
use rayon::prelude::*;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
const EPSILON: f32 = 1e-8;
/// Smoothing reads six neighbours a row and pulls gently: one step in four, four
/// times as hard, does the same for a quarter of the time.
const SMOOTH_EVERY: u64 = 4;
/// Rows a task handles.
const TASK: usize = 2048;

/// Adam's state: first and second moments and how many steps were taken.
pub(crate) struct Adam {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    pub(crate) steps: u64,
}

/// Learning rates and smoothness of one step.
pub(crate) struct Rates {
    pub(crate) density: f32,
    pub(crate) colour: f32,
    pub(crate) view_dependence: f32,
    pub(crate) smooth_density: f32,
    pub(crate) smooth_colour: f32,
}

impl Adam {
    pub(crate) fn zero(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len], steps: 0 }
    }

    /// Counts a step, before the [`Adam::update`]s that belong to it.
    pub(crate) fn tick(&mut self) {
        self.steps += 1;
    }

    fn corrections(&self) -> (f32, f32) {
        let n = self.steps.max(1) as i32;
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

    /// One step of the whole grid; clears the gradient. Returns false, with grid
    /// and moments unchanged, when a gradient is not finite.
    pub(crate) fn step_grid(&mut self, grid: &mut Grid<f32>, gradient: &mut Gradient, rates: &Rates) -> bool {
        if !smooth(grid, gradient, rates, self.steps.is_multiple_of(SMOOTH_EVERY)) {
            return false;
        }
        self.steps += 1;
        let fix = self.corrections();
        let mut scale = [rates.colour * rates.view_dependence; ROW];
        for c in 0..3 {
            scale[c * SH] = rates.colour;
        }
        scale[ROW - 1] = rates.density;
        let tasks = gradient
            .values
            .par_chunks_mut(TASK * ROW)
            .zip(gradient.touched.par_chunks_mut(TASK))
            .zip(grid.raw.par_chunks_mut(TASK))
            .zip(grid.colour.par_chunks_mut(TASK * ROW))
            .zip(self.first.par_chunks_mut(TASK * ROW))
            .zip(self.second.par_chunks_mut(TASK * ROW));
        tasks.for_each(|(((((gradient, touched), raw), colour), first), second)| {
            for row in 0..touched.len() {
                if !std::mem::take(&mut touched[row]) {
                    continue;
                }
                let at = row * ROW..(row + 1) * ROW;
                let g = &mut gradient[at.clone()];
                let (m, v) = (&mut first[at.clone()], &mut second[at.clone()]);
                let c = &mut colour[at];
                c[ROW - 1] = raw[row];
                for k in 0..ROW {
                    c[k] -= scale[k] * moment(g[k], &mut m[k], &mut v[k], fix);
                }
                raw[row] = c[ROW - 1];
                c[ROW - 1] = 0.0;
                g.fill(0.0);
            }
        });
        true
    }
}

/// Adam's direction for one number.
#[inline(always)]
fn moment(g: f32, first: &mut f32, second: &mut f32, fix: (f32, f32)) -> f32 {
    *first = BETA_1 * *first + (1.0 - BETA_1) * g;
    *second = BETA_2 * *second + (1.0 - BETA_2) * g * g;
    *first * fix.0 / ((*second * fix.1).sqrt() + EPSILON)
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
        .zip(gradient.touched.par_chunks(TASK))
        .enumerate()
        .map(|(task, (values, touched))| {
            let mut fine = true;
            for (i, _) in touched.iter().enumerate().filter(|(_, t)| **t) {
                let row = task * TASK + i;
                let v = grid.vertex[row] as usize;
                let at = [v % nx, v / nx % ny, v / (nx * ny)];
                let out = &mut values[i * ROW..(i + 1) * ROW];
                let mine = &grid.colour[row * ROW..(row + 1) * ROW];
                for axis in 0..if now { 3 } else { 0 } {
                    for up in [false, true] {
                        if (up && at[axis] + 1 >= [nx, ny, nz][axis]) || (!up && at[axis] == 0) {
                            continue;
                        }
                        let other = grid.index[if up { v + strides[axis] } else { v - strides[axis] }] as usize;
                        if other == 0 {
                            continue;
                        }
                        let theirs = &grid.colour[other * ROW..(other + 1) * ROW];
                        for k in 0..3 * SH {
                            out[k] += for_colour * (mine[k] - theirs[k]);
                        }
                        out[ROW - 1] += for_density * (grid.raw[row] - grid.raw[other]);
                    }
                }
                fine &= out.iter().all(|g| g.is_finite());
            }
            fine
        })
        .reduce(|| true, |a, b| a && b)
}
