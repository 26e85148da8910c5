//! The mean of a training's last states, which is the field that it ends with.
//!
//! A step moves rows by what a few thousand rays say, and a colour's step (RMSprop) is as long when little
//! is left to learn as before. So the last state lies somewhere about a good place; the mean of the states
//! of the last steps is nearer to it (Polyak and Juditsky 1992; stochastic weight averaging, Izmailov et
//! al. 2018). It holds 116 bytes a row.
//!
//! Where training ends while it still learns fast, the mean lags behind. So the photographs are asked how well either
//! explains them.

use super::shown::Shown;
use crate::appearance::code::{Appearance, features};
use crate::chance::spread;
use crate::grid::lattice::{Grid, ROW};
use crate::grid::memory::zeros;
use crate::rays::march::empty_density;
use crate::render::composite::{Thresholds, see};
use rayon::prelude::*;

/// States that are averaged, at most: neighbours among them are too much alike to be worth the memory traffic.
const STATES: u64 = 32;

/// Numbers that one task averages.
const CHUNK: usize = 1 << 16;

/// Pixels of a photograph that are asked, and of all together, at most.
const PIXELS: usize = 4096;
const MAX_PIXELS: usize = 1 << 18;

/// The mean may explain photographs by so much worse (squared error) than the last state, which has the latest steps'
/// pixels by heart: 1.01 where they are grainy and the mean is better on others; where it lagged it was 1.04 and more.
pub(super) const WORSE: f64 = 1.02;

/// The running mean of some states of a training; see the module's text.
#[derive(Default)]
pub(crate) struct Mean {
    /// States taken in.
    pub(crate) states: u64,
    /// Raw densities of the grid's rows, but the empty one's.
    pub(crate) raw: Vec<f32>,
    /// The rows' colour coefficients.
    pub(crate) colour: Vec<f32>,
    /// The views' appearance codes, one after another.
    pub(crate) codes: Vec<f32>,
}

impl Mean {
    /// Whether the state after `step` of `steps` is one of those from step `from` on that are averaged; the last is.
    pub(crate) fn is_due(step: u64, from: u64, steps: u64) -> bool {
        let every = steps.saturating_sub(from).div_ceil(STATES).max(1);
        step > from && steps.saturating_sub(step).is_multiple_of(every)
    }

    /// Takes in a state. Where the scene was found to need other rows or codes meanwhile, the mean begins anew.
    pub(crate) fn take_in(&mut self, grid: &Grid<f32>, appearances: &[Appearance]) {
        let codes = codes_of(appearances);
        let alike = (self.raw.len() + 1, self.codes.len()) == (grid.rows(), codes.len());
        if self.states == 0 || !alike {
            let (raw, colour) = (zeros(grid.rows() - 1), zeros(grid.rows() * ROW));
            *self = Self { states: 0, raw, colour, codes: vec![0.0; codes.len()] };
        }
        self.states += 1;
        let share = 1.0 / self.states as f32;
        let towards = |mean: &mut f32, now: f32| *mean += share * (now - *mean);
        let vertices = grid.vertex[1..].par_chunks(CHUNK);
        self.raw.par_chunks_mut(CHUNK).zip(vertices).for_each(|(mean, vertices)| {
            mean.iter_mut().zip(vertices).for_each(|(mean, v)| towards(mean, grid.raw[*v as usize]));
        });
        self.colour.par_chunks_mut(CHUNK).zip(grid.colour.par_chunks(CHUNK)).for_each(|(mean, now)| {
            mean.iter_mut().zip(now).for_each(|(mean, now)| towards(mean, *now));
        });
        self.codes.iter_mut().zip(codes).for_each(|(mean, now)| towards(mean, now));
    }

    /// Exchanges the mean (of one state at least) and the state.
    pub(super) fn exchange(&mut self, grid: &mut Grid<f32>, appearances: &mut [Appearance]) {
        let raw: Vec<f32> = grid.raw_rows().collect();
        grid.set_raw_rows(&std::mem::replace(&mut self.raw, raw));
        std::mem::swap(&mut grid.colour, &mut self.colour);
        let codes = appearances.iter_mut().flat_map(|a| a.code_mut().iter_mut());
        codes.zip(&mut self.codes).for_each(|(code, mean)| std::mem::swap(code, mean));
        grid.refresh_occupancy(empty_density(grid.dims));
    }
}

/// Squared errors of pixels spread evenly over the photographs, summed.
pub(super) fn error_on_photographs(shown: &Shown<'_>, seed: u64) -> f64 {
    // Summed in their order: the same with any number of threads.
    let each: Vec<f64> = (0..shown.views.len()).into_par_iter().map(|n| error_on(shown, seed, n)).collect();
    each.iter().sum()
}

fn error_on(shown: &Shown<'_>, seed: u64, n: usize) -> f64 {
    let (view, look) = (&shown.views[n], shown.look(n));
    let wanted = (MAX_PIXELS / shown.views.len()).clamp(1, PIXELS);
    let (mut tape, mut error) = (Vec::new(), 0.0);
    let pixels = spread(seed, n, view.lens.pixels(), wanted);
    for (at, _) in pixels.filter(|(at, _)| view.uses(*at)) {
        let (path, basis) = view.eye().ray(shown.frame, at);
        let gathered = see(shown.grid, &path, &basis, Thresholds::SHOWN, &mut tape);
        for (c, v) in look.shade(&features(&gathered, &basis)).iter().enumerate() {
            error += (f64::from(*v) - f64::from(view.pixels()[at * 3 + c]) / 255.0).powi(2);
        }
    }
    error
}

/// The codes of `appearances`, one after another.
pub(crate) fn codes_of(appearances: &[Appearance]) -> Vec<f32> {
    appearances.iter().flat_map(|a| a.code().to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of eight rows that all hold `value`.
    fn grid(value: f32) -> Grid<f32> {
        let mut grid = Grid::full([2, 2, 2], value.into(), 0.0);
        grid.colour.fill(value);
        grid
    }

    #[test]
    fn the_mean_is_that_of_the_states_taken_in() {
        let mut mean = Mean::default();
        let mut look = Appearance::neutral([0.5; 3]);
        for value in [1.0, 4.0, -2.0, 5.0] {
            look.code_mut().fill(10.0 * value);
            mean.take_in(&grid(value), std::slice::from_ref(&look));
        }
        let mut last = grid(5.0);
        mean.exchange(&mut last, std::slice::from_mut(&mut look));
        assert!(last.raw_rows().chain(last.colour.iter().copied()).all(|v| (v - 2.0).abs() < 1e-6));
        assert!(look.code().iter().all(|v| (v - 20.0).abs() < 1e-5));
    }

    #[test]
    fn other_rows_or_codes_begin_it_anew() {
        let mut mean = Mean::default();
        let look = Appearance::neutral([0.5; 3]);
        mean.take_in(&grid(1.0), &[look]);
        mean.take_in(&grid(3.0), &[]);
        assert_eq!(mean.states, 1);
        let mut last = grid(0.0);
        mean.exchange(&mut last, &mut []);
        assert!(last.raw_rows().all(|v| v == 3.0));
        // And back.
        mean.exchange(&mut last, &mut []);
        assert!(last.raw_rows().all(|v| v == 0.0));
    }

    #[test]
    fn few_states_are_taken_and_the_last_is_one() {
        for (from, steps) in [(0, 1), (40, 50), (800, 1000), (3_501, 5_000), (7_000, 10_000)] {
            let due: Vec<u64> = (1..=steps).filter(|step| Mean::is_due(*step, from, steps)).collect();
            assert!(due[0] > from && *due.last().expect("one at least") == steps, "{from} of {steps}");
            assert!((1..=STATES).contains(&(due.len() as u64)), "{} of {steps}", due.len());
        }
    }
}
