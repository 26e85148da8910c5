//! A carrier: the colour coefficients that hold a mark, and how they move.

use crate::error::MarkError;
use cairn_field::Appearance;
use cairn_field::operator::{CarrierBasis, LinearView, MarkableField};
use rayon::prelude::*;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
/// Vertices along a block of equal sign in the first pattern: coarse enough to
/// survive being made smaller, fine enough to be texture and not shade.
const BLOCK: u32 = 3;
/// Rows a task handles.
const TASK: usize = 8192;

/// The coefficients of one mark, `rows x basis.width()`, with Adam's moments.
#[derive(Clone, Debug)]
pub struct Carrier {
    pub(crate) basis: CarrierBasis,
    pub(crate) values: Vec<f32>,
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    pub(crate) steps: u64,
    gradient: Vec<f32>,
    touched: Vec<bool>,
}

/// How a carrier moves in one step.
pub(crate) struct Move<'a> {
    pub(crate) mask: &'a [f32],
    pub(crate) rate: f32,
    pub(crate) pull: f32,
}

impl Carrier {
    /// A seeded pattern of blocks, amplitude `amplitude` in colour units: a
    /// start at zero is a saddle that training does not leave by itself.
    pub fn pattern(field: &dyn MarkableField, basis: CarrierBasis, seed: u64, amplitude: f32) -> Self {
        let width = basis.width();
        let mut values = vec![0.0f32; field.rows() * width];
        for (row, at) in field.lattice().iter().enumerate().skip(1) {
            let block = at.map(|v| u64::from(v / BLOCK));
            let key = (block[0] << 42) ^ (block[1] << 21) ^ block[2];
            for k in 0..width {
                let bits = scramble(key ^ scramble(seed ^ (k as u64) << 56));
                values[row * width + k] = if bits & 1 == 1 { amplitude } else { -amplitude };
            }
        }
        Self::from_values(basis, values)
    }

    /// A carrier at rest with given coefficients.
    pub(crate) fn from_values(basis: CarrierBasis, values: Vec<f32>) -> Self {
        let (n, rows) = (values.len(), values.len() / basis.width());
        Self {
            basis,
            values,
            first: vec![0.0; n],
            second: vec![0.0; n],
            steps: 0,
            gradient: vec![0.0; n],
            touched: vec![false; rows],
        }
    }

    /// The coefficients, `rows x basis.width()`.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Adds d(loss)/d(picture) of one view to the gradient.
    pub(crate) fn owe(&mut self, view: &LinearView, slope: &[f32], appearance: &Appearance) {
        view.push_back(slope, self.basis, appearance, &mut self.gradient, &mut self.touched);
    }

    /// One step: Adam's direction times the mask, then the pull. Clears the
    /// gradient. Errors with the values unchanged when the gradient is not finite.
    pub(crate) fn step(&mut self, how: &Move<'_>) -> Result<(), MarkError> {
        let width = self.basis.width();
        if !self.gradient.par_iter().with_min_len(TASK).all(|g| g.is_finite()) {
            self.gradient.fill(0.0);
            self.touched.fill(false);
            return Err(MarkError::NotFinite { step: self.steps, place: "a carrier's gradient".into() });
        }
        self.steps += 1;
        let n = self.steps as i32;
        let (fix_1, fix_2) = (1.0 / (1.0 - BETA_1.powi(n)), 1.0 / (1.0 - BETA_2.powi(n)));
        self.touched
            .par_chunks_mut(TASK)
            .zip(self.values.par_chunks_mut(TASK * width))
            .zip(self.gradient.par_chunks_mut(TASK * width))
            .zip(self.first.par_chunks_mut(TASK * width))
            .zip(self.second.par_chunks_mut(TASK * width))
            .zip(how.mask.par_chunks(TASK * width))
            .for_each(|(((((touched, values), gradient), first), second), mask)| {
                for row in 0..touched.len() {
                    if !std::mem::take(&mut touched[row]) {
                        continue;
                    }
                    for i in row * width..(row + 1) * width {
                        let g = std::mem::take(&mut gradient[i]);
                        first[i] = BETA_1 * first[i] + (1.0 - BETA_1) * g;
                        second[i] = BETA_2 * second[i] + (1.0 - BETA_2) * g * g;
                        let direction = first[i] * fix_1 / ((second[i] * fix_2).sqrt() + 1e-12);
                        values[i] -= how.rate * mask[i] * direction + how.pull * values[i];
                    }
                }
            });
        Ok(())
    }

    /// Makes the mark weaker or stronger by `factor`.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.values.par_iter_mut().with_min_len(TASK).for_each(|v| *v *= factor);
    }
}

/// SplitMix64's finaliser (Steele, Lea and Flood 2014): a hash of lattice places.
pub(crate) fn scramble(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
