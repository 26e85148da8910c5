//! The mean of a training's last states, which is the field that it ends with.
//!
//! A step moves rows by what a few thousand rays say, and a colour's step (RMSprop) is as long when little is left
//! to learn as before. So the last state lies somewhere about a good place; the mean of the states of the last steps
//! is nearer to it (Polyak and Juditsky 1992; stochastic weight averaging, Izmailov et al. 2018), for seconds.

use crate::appearance::Appearance;
use crate::grid::{Grid, ROW};
use crate::memory::zeros;
use rayon::prelude::*;

/// States that are averaged: neighbours among them are too much alike to be worth the memory traffic.
const STATES: u64 = 32;

/// Numbers that one task averages.
const CHUNK: usize = 1 << 16;

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
        let every = (steps.saturating_sub(from) / STATES).max(1);
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

    /// Puts the mean (of one state at least) in the state's place.
    pub(crate) fn replace(self, grid: &mut Grid<f32>, appearances: &mut [Appearance]) {
        grid.set_raw_rows(&self.raw);
        grid.colour = self.colour;
        let mut codes = self.codes.into_iter();
        for appearance in appearances {
            appearance.code_mut().iter_mut().zip(codes.by_ref()).for_each(|(code, mean)| *code = mean);
        }
    }
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
        let mut grid = Grid::full([2, 2, 2], value, 0.0);
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
        mean.replace(&mut last, std::slice::from_mut(&mut look));
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
        mean.replace(&mut last, &mut []);
        assert!(last.raw_rows().all(|v| v == 3.0));
    }

    #[test]
    fn few_states_are_taken_and_the_last_is_one() {
        for (from, steps) in [(0, 1), (40, 50), (800, 1000), (3_501, 5_000), (7_000, 10_000)] {
            let due: Vec<u64> = (1..=steps).filter(|step| Mean::is_due(*step, from, steps)).collect();
            assert!(due[0] > from && *due.last().expect("one at least") == steps, "{from} of {steps}");
            assert!((1..=2 * STATES).contains(&(due.len() as u64)), "{} of {steps}", due.len());
        }
    }
}
