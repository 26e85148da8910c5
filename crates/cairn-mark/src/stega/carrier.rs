//! A carrier: the coefficients that hold a mark, how they show, and how they move.

use crate::attack::Attack;
use crate::error::MarkError;
use crate::stega::bank::BankView;
use crate::stega::shape::CarrierShape;
use cairn_field::MarkableField;
use cairn_field::{Appearance, Field, mixed};
use half::f16;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
/// Rows a task handles.
const TASK: usize = 8192;

/// The coefficients of one mark, `rows x shape.width()`, with its momentum.
#[derive(Clone, Debug)]
pub(crate) struct Carrier {
    pub(crate) shape: CarrierShape,
    pub(crate) values: Vec<f32>,
    pub(crate) first: Vec<f32>,
    /// Mean square of the gradient, one number for the whole carrier: Adam's own,
    /// one a coefficient, would blow up the noise of coefficients that hardly matter.
    pub(crate) second: f32,
    pub(crate) steps: u64,
    gradient: Vec<f32>,
    touched: Vec<bool>,
    /// theta at these values, where densities are free and it was looked at.
    theta: OnceLock<Arc<Field>>,
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
    /// design, not only by chance: each has a colour direction of its own (`hue`, radians),
    /// so that what tells them apart is the same from every view.
    pub(crate) fn pattern(
        field: &dyn MarkableField,
        shape: CarrierShape,
        seed: u64,
        which: usize,
        hue: f32,
        amplitude: f32,
    ) -> Self {
        let (width, colours) = (shape.width(), shape.colours());
        let colour = colour_direction(hue);
        let mut values = vec![0.0f32; field.rows() * width];
        for (row, at) in field.lattice().iter().enumerate().skip(1) {
            let at = at.map(u64::from);
            let key = (at[0] << 42) ^ (at[1] << 21) ^ at[2];
            // Densities start as they are.
            for k in 0..colours {
                // One sign a coefficient of a channel's kind, shared by the channels.
                let harmonic = (k % (colours / 3)) as u64;
                let bits = mixed(key ^ mixed(seed ^ (which as u64) << 48 ^ harmonic << 56));
                let sign = if bits & 1 == 1 { amplitude } else { -amplitude };
                values[row * width + k] = sign * colour[k / (colours / 3)];
            }
        }
        Self::from_values(shape, values)
    }

    /// A carrier at rest with given coefficients.
    pub(crate) fn from_values(shape: CarrierShape, values: Vec<f32>) -> Self {
        let (n, rows) = (values.len(), values.len() / shape.width());
        Self {
            shape,
            values,
            first: vec![0.0; n],
            second: 0.0,
            steps: 0,
            gradient: vec![0.0; n],
            touched: vec![false; rows],
            theta: OnceLock::new(),
        }
    }

    /// The carrier as `attack` has it, in half precision or as it is. It is for showing only: the gradient of what it shows is
    /// owed by the carrier itself, as if nothing had been rounded (the straight-through estimate).
    pub(crate) fn after(&self, attack: &Attack) -> Cow<'_, Self> {
        if !attack.rounds_weights() {
            return Cow::Borrowed(self);
        }
        let mut values = vec![0.0f32; self.values.len()];
        let rounded = values.par_iter_mut().with_min_len(TASK).zip(&self.values);
        rounded.for_each(|(to, from)| *to = f16::from_f32(*from).to_f32());
        Cow::Owned(Self {
            shape: self.shape,
            values,
            first: Vec::new(),
            second: 0.0,
            steps: 0,
            gradient: Vec::new(),
            touched: Vec::new(),
            theta: OnceLock::new(),
        })
    }

    /// Adds d(loss)/d(picture) of one view to the gradient.
    pub(crate) fn owe(&mut self, field: &Field, view: &BankView, slope: &[f32], appearance: &Appearance) {
        match self.shape {
            CarrierShape::Colours(basis) => {
                view.linear.push_back(slope, basis, appearance, &mut self.gradient, &mut self.touched);
            }
            CarrierShape::Free => {
                let theta = self.theta(field).clone();
                view.marched().push_back(&theta, slope, appearance, &mut self.gradient, &mut self.touched);
            }
        }
    }

    /// Turns `picture`, theta_0's of `view`, into theta's, theta_0 being `field`.
    pub(crate) fn show(&self, field: &Field, view: &BankView, appearance: &Appearance, picture: &mut Vec<f32>) {
        match self.shape {
            CarrierShape::Colours(basis) => view.linear.apply(&self.values, basis, appearance, picture),
            CarrierShape::Free => *picture = view.marched().render(self.theta(field), appearance),
        }
    }

    fn theta(&self, field: &Field) -> &Arc<Field> {
        self.theta.get_or_init(|| Arc::new(field.changed_by(&self.values)))
    }

    /// The mean square that [`Carrier::apply`] is to go on with, from the gradient
    /// owed. Changes nothing, so that all carriers can be checked before one moves.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when the gradient, or its mean square as f32, is not
    /// finite; `step` is the trainer's.
    pub(crate) fn check(&self, step: u64) -> Result<f32, MarkError> {
        let width = self.shape.width();
        // Sums in fixed pieces, so that threads do not change them.
        let squares: Vec<f64> =
            self.gradient.par_chunks(TASK).map(|c| c.iter().map(|g| f64::from(*g).powi(2)).sum()).collect();
        let touched = self.touched.iter().filter(|t| **t).count().max(1) * width;
        let square = squares.iter().sum::<f64>() / touched as f64;
        let second = BETA_2 * self.second + (1.0 - BETA_2) * square as f32;
        if !second.is_finite() {
            return Err(MarkError::NotFinite { step: Some(step), place: "a carrier's gradient".into() });
        }
        Ok(second)
    }

    /// Forgets the gradient owed: the step is not taken.
    pub(crate) fn forget(&mut self) {
        self.gradient.fill(0.0);
        self.touched.fill(false);
    }

    /// One step: the gradient's running mean over its size, times the mask, then the
    /// pull. Clears the gradient. `second` is what [`Carrier::check`] gave.
    pub(crate) fn apply(&mut self, second: f32, how: &Move<'_>) {
        let width = self.shape.width();
        self.theta.take();
        self.steps += 1;
        let n = self.steps as i32;
        self.second = second;
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
    }

    /// Makes the mark weaker or stronger by `factor`.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.theta.take();
        self.values.par_iter_mut().with_min_len(TASK).for_each(|v| *v *= factor);
    }
}

/// Hues of `count` carriers, radians in [0, pi): as far apart as lines through the origin
/// can be in the plane of hues, or in the middle of the widest gaps that those `taken` leave.
pub(crate) fn hues(count: usize, taken: &[f32]) -> Vec<f32> {
    use std::f32::consts::PI;
    if taken.is_empty() {
        return (0..count).map(|i| PI * i as f32 / count as f32).collect();
    }
    let mut all: Vec<f32> = taken.iter().map(|hue| hue.rem_euclid(PI)).collect();
    let mut new = Vec::with_capacity(count);
    for _ in 0..count {
        all.sort_by(f32::total_cmp);
        // Lines go round: behind the last comes the first, half a turn on.
        let next = all.iter().skip(1).copied().chain([all[0] + PI]);
        let gaps = all.iter().zip(next).map(|(from, to)| (to - from, 0.5 * (from + to)));
        let widest = gaps.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, middle)| middle.rem_euclid(PI));
        all.push(widest);
        new.push(widest);
    }
    new
}

/// The direction of colour at `hue`, radians, unit length, tilted towards grey so that
/// something is left where a file format thins out colour.
fn colour_direction(hue: f32) -> [f32; 3] {
    let (sin, cos) = hue.sin_cos();
    let grey = (1.0f32 / 3.0).sqrt();
    [0, 1, 2].map(|c| 0.9 * (cos * HUE_PLANE[0][c] + sin * HUE_PLANE[1][c]) + 0.19f32.sqrt() * grey)
}

/// The plane of hues: unit vectors from green to red and from blue to yellow.
const HUE_PLANE: [[f32; 3]; 2] = [
    [std::f32::consts::FRAC_1_SQRT_2, -std::f32::consts::FRAC_1_SQRT_2, 0.0],
    [0.408_248_3, 0.408_248_3, -0.816_496_6],
];

/// The hue along which `values`, `rows x 3`, vary most, radians.
pub(crate) fn hue_of(values: &[f32]) -> f32 {
    let [mut xx, mut xy, mut yy] = [0.0f64; 3];
    for rgb in values.chunks_exact(3) {
        let [x, y] = HUE_PLANE.map(|axis| f64::from((0..3).map(|c| axis[c] * rgb[c]).sum::<f32>()));
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
    }
    // The principal axis of a 2 x 2 covariance.
    (0.5 * (2.0 * xy).atan2(xx - yy)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_field::CarrierBasis;

    /// As if one view had been pushed back.
    fn owing(carrier: &mut Carrier, gradient: &[f32]) {
        carrier.gradient.copy_from_slice(gradient);
        carrier.touched.fill(true);
    }

    #[test]
    fn hues_keep_apart_and_those_that_come_later_go_between() {
        use std::f32::consts::PI;
        assert_eq!(hues(2, &[]), [0.0, PI / 2.0]);
        // Between 0 and 90 degrees and between 90 and 180 there is as much room; then the other half.
        let later = hues(2, &[0.0, PI / 2.0]);
        assert!((later[0] - 0.75 * PI).abs() < 1e-6 && (later[1] - 0.25 * PI).abs() < 1e-6, "{later:?}");
        // Half a turn is the same line.
        let one = hues(1, &[-PI + 0.5]);
        assert!((one[0] - (0.5 + PI / 2.0)).abs() < 1e-5, "{one:?}");
        for hue in [0.0, 0.4, 1.3, 2.6] {
            let colour = colour_direction(hue);
            assert!((colour.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-6);
            let values: Vec<f32> = [0.5, -2.0, 1.0].iter().flat_map(|k| colour.map(|c| k * c)).collect();
            let apart = (hue_of(&values) - hue).rem_euclid(PI);
            assert!(apart.min(PI - apart) < 1e-4, "{hue}: {}", hue_of(&values));
        }
    }

    #[test]
    fn half_precision_is_shown_where_it_is_drawn_and_moves_nothing() {
        let values = vec![0.1f32, -0.003, 1e-7, 0.5, 65_000.0, 0.0];
        let carrier = Carrier::from_values(CarrierShape::Colours(CarrierBasis::Constant), values.clone());
        assert!(matches!(carrier.after(&Attack::none()), Cow::Borrowed(_)));
        let half = carrier.after(&Attack::of_weights());
        // A tenth is 1638 / 2^14, three thousandths 1573 / 2^19, 1e-7 two of the smallest steps, 65000 a multiple of 32 at least.
        assert_eq!(half.values, [1638.0 / 16_384.0, -1573.0 / 524_288.0, 2.0f32.powi(-23), 0.5, 64_992.0, 0.0]);
        assert_eq!(carrier.values, values);
    }

    #[test]
    fn a_refused_gradient_leaves_no_trace() {
        let mut plain = Carrier::from_values(CarrierShape::Colours(CarrierBasis::Constant), vec![0.1; 6]);
        let mut refused = plain.clone();
        // The second is finite; its square is not, as f32.
        for bad in [f32::NAN, 1e25] {
            let mut gradient = [0.5; 6];
            gradient[4] = bad;
            owing(&mut refused, &gradient);
            assert!(matches!(refused.check(9), Err(MarkError::NotFinite { step: Some(9), .. })), "{bad}");
            refused.forget();
        }
        let how = Move { mask: &[1.0; 6], rate: 0.01, pull: 0.0 };
        for carrier in [&mut plain, &mut refused] {
            // One row only: what is left of the other would show.
            owing(carrier, &[1.0, -2.0, 3.0, 0.0, 0.0, 0.0]);
            carrier.touched[1] = false;
            let second = carrier.check(10).unwrap();
            carrier.apply(second, &how);
        }
        assert_eq!(plain.values, refused.values);
        assert_eq!(plain.second, refused.second);
        assert_ne!(plain.values[..3], [0.1; 3], "the step moved nothing");
        assert_eq!(plain.values[3..], [0.1; 3]);
    }

    #[test]
    fn an_update_is_the_mask_times_the_step() {
        let mut carrier = Carrier::from_values(CarrierShape::Colours(CarrierBasis::Constant), vec![1.0; 6]);
        let how = Move { mask: &[0.0, 0.25, 0.5, 1.0, 1.0, 0.125], rate: 0.01, pull: 0.0 };
        let mut take = |gradient: [f32; 6], how: &Move<'_>| {
            owing(&mut carrier, &gradient);
            let second = carrier.check(0).unwrap();
            carrier.apply(second, how);
            carrier.values.clone()
        };
        let near = |got: &[f32], expected: [f32; 6]| {
            let all = got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-6);
            assert!(all, "{got:?} for {expected:?}");
        };
        // All of size 2: the mean over the size is 1, so that each moves by 0.01 times its mask against its sign.
        near(&take([2.0, 2.0, -2.0, 2.0, -2.0, 2.0], &how), [1.0, 0.9975, 1.005, 0.99, 1.01, 0.99875]);
        // The next gradient is 0. First moments fall to 0.9 x 0.1 x 2 = 0.18, of which the start takes 1 - 0.9^2 = 0.19 out;
        // the mean square falls to 0.99 x 0.01 x 4 = 0.0396 of 1 - 0.99^2 = 0.0199: 0.18 / 0.19 / 1.4106556 = 0.6715801.
        let step = 0.006_715_801;
        let second = [1.0, 0.9975 - 0.25 * step, 1.005 + 0.5 * step, 0.99 - step, 1.01 + step, 0.99875 - 0.125 * step];
        near(&take([0.0; 6], &how), second);
        // The pull is nothing that a mask holds: a tenth of each value, with no rate to move it otherwise.
        let pulled = Move { rate: 0.0, pull: 0.1, ..how };
        near(&take([0.0; 6], &pulled), second.map(|v| 0.9 * v));
    }
}
