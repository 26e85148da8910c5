//! A carrier: the colour coefficients that hold a mark, and how they move.

use crate::error::MarkError;
use cairn_field::Appearance;
use cairn_field::operator::{CarrierBasis, LinearView, MarkableField};
use rayon::prelude::*;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
/// Rows a task handles.
const TASK: usize = 8192;

/// The coefficients of one mark, `rows x basis.width()`, with its momentum.
#[derive(Clone, Debug)]
pub struct Carrier {
    pub(crate) basis: CarrierBasis,
    pub(crate) values: Vec<f32>,
    pub(crate) first: Vec<f32>,
    /// Mean square of the gradient, one number for the whole carrier: Adam's own,
    /// one a coefficient, would blow up the noise of coefficients that hardly matter.
    pub(crate) second: f32,
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
    /// The first pattern of carrier `which` of `count`, amplitude `amplitude` in
    /// colour units: a random sign a vertex (a start at zero is a saddle that
    /// training does not leave by itself; anything coarser than a vertex falls
    /// below what the networks' high-pass lets through). Carriers differ by
    /// design, not only by chance: each has a colour direction of its own, so
    /// that what tells them apart is the same from every view.
    pub fn pattern(
        field: &dyn MarkableField,
        basis: CarrierBasis,
        seed: u64,
        (which, count): (usize, usize),
        amplitude: f32,
    ) -> Self {
        let width = basis.width();
        let colour = colour_direction(which, count);
        let mut values = vec![0.0f32; field.rows() * width];
        for (row, at) in field.lattice().iter().enumerate().skip(1) {
            let at = at.map(u64::from);
            let key = (at[0] << 42) ^ (at[1] << 21) ^ at[2];
            for k in 0..width {
                // One sign a coefficient of a channel's kind, shared by the channels.
                let harmonic = (k % (width / 3)) as u64;
                let bits = scramble(key ^ scramble(seed ^ (which as u64) << 48 ^ harmonic << 56));
                let sign = if bits & 1 == 1 { amplitude } else { -amplitude };
                values[row * width + k] = sign * colour[k / (width / 3)];
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
            second: 0.0,
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

    /// One step: the gradient's running mean over its size, times the mask, then the pull. Clears the
    /// gradient. Errors with the values unchanged when the gradient is not finite.
    pub(crate) fn step(&mut self, how: &Move<'_>) -> Result<(), MarkError> {
        let width = self.basis.width();
        // Sums in fixed pieces, so that threads do not change them.
        let squares: Vec<f64> =
            self.gradient.par_chunks(TASK).map(|c| c.iter().map(|g| f64::from(*g).powi(2)).sum()).collect();
        let touched = self.touched.iter().filter(|t| **t).count().max(1) * width;
        let square = squares.iter().sum::<f64>() / touched as f64;
        if !square.is_finite() {
            self.gradient.fill(0.0);
            self.touched.fill(false);
            return Err(MarkError::NotFinite { step: self.steps, place: "a carrier's gradient".into() });
        }
        self.steps += 1;
        let n = self.steps as i32;
        self.second = BETA_2 * self.second + (1.0 - BETA_2) * square as f32;
        let root = (self.second / (1.0 - BETA_2.powi(n))).sqrt().max(1e-12);
        let rate = how.rate / (1.0 - BETA_1.powi(n)) / root;
        self.touched
            .par_chunks_mut(TASK)
            .zip(self.values.par_chunks_mut(TASK * width))
            .zip(self.gradient.par_chunks_mut(TASK * width))
            .zip(self.first.par_chunks_mut(TASK * width))
            .zip(how.mask.par_chunks(TASK * width))
            .for_each(|((((touched, values), gradient), first), mask)| {
                for row in 0..touched.len() {
                    if !std::mem::take(&mut touched[row]) {
                        continue;
                    }
                    for i in row * width..(row + 1) * width {
                        let g = std::mem::take(&mut gradient[i]);
                        first[i] = BETA_1 * first[i] + (1.0 - BETA_1) * g;
                        values[i] -= rate * mask[i] * first[i] + how.pull * values[i];
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

/// Directions in colour space, unit length, as far apart as `count` lines through
/// the origin can be in the plane of hues, tilted towards grey so that something
/// is left where a file format thins out colour.
fn colour_direction(which: usize, count: usize) -> [f32; 3] {
    let angle = std::f32::consts::PI * which as f32 / count.max(1) as f32;
    let (sin, cos) = angle.sin_cos();
    let (red_green, yellow_blue, grey) = (0.5f32.sqrt(), (1.0f32 / 6.0).sqrt(), (1.0f32 / 3.0).sqrt());
    let hue = [cos * red_green + sin * yellow_blue, sin * yellow_blue - cos * red_green, -2.0 * sin * yellow_blue];
    hue.map(|h| 0.9 * h + 0.19f32.sqrt() * grey)
}

/// SplitMix64's finaliser (Steele, Lea and Flood 2014): a hash of lattice places.
pub(crate) fn scramble(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
