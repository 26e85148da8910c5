//! Blur: by a lens, by motion, or on a picture's way. What the field shows is blurred as much before the two are compared,
//! as a round Gaussian does. Compared sharp, edges of a blurred picture are outliers on either side, and pictures settle
//! beside their places.

use cairn_field::appearance::code::FEATURES;
use std::ops::Range;

/// The widest blur that is looked for, standard deviation, px.
pub(crate) const MAX_BLUR_PX: f64 = 3.0;
/// A kernel reaches so many standard deviations: 1.2 % of a Gaussian lie beyond.
const REACH: f64 = 2.5;
/// At less, a neighbour's share is below what eight bits can show.
const MIN_BLUR_PX: f64 = 0.3;

/// Of a wider one less than 6 % of what it lets pass is finer than half the size can show: exp(-2 (pi sigma f)^2) at f of a
/// quarter a pixel.
const HALVED_PX: f64 = 1.5;

/// A round Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Blur {
    /// Its standard deviation, px.
    sigma_px: f64,
    /// Weights from the middle out, px by px; none where nothing is blurred.
    kernel: Vec<f32>,
}

impl Blur {
    /// No blur.
    pub(crate) const NONE: Self = Self { sigma_px: 0.0, kernel: Vec::new() };

    /// Of a standard deviation of `sigma_px`.
    pub(crate) fn of(sigma_px: f64) -> Self {
        if sigma_px < MIN_BLUR_PX {
            return Self::NONE;
        }
        let margin = (REACH * sigma_px).ceil() as usize;
        let weight = |k: usize| (-0.5 * (k as f64 / sigma_px).powi(2)).exp();
        let sum = 1.0 + 2.0 * (1..=margin).map(weight).sum::<f64>();
        Self { sigma_px, kernel: (0..=margin).map(|k| (weight(k) / sum) as f32).collect() }
    }

    /// The blur at half the size, where as much is to be seen there; its pixels are means over two by two.
    pub(crate) fn halved(&self) -> Option<Self> {
        let half = || Self::of((self.sigma_px.powi(2) / 4.0 + 1.0 / 12.0).sqrt());
        (self.sigma_px > HALVED_PX).then(half)
    }

    /// How far beyond a pixel what it mixes reaches, px.
    pub(crate) fn margin(&self) -> usize {
        self.kernel.len().saturating_sub(1)
    }

    /// What the pixels of square windows, `side` px each, show: `features` has those of each window with `margin` px about
    /// it, which is at least the blur's own.
    pub(crate) fn of_windows(&self, features: &[[f32; FEATURES]], side: usize, margin: usize) -> Vec<[f32; FEATURES]> {
        let across = side + 2 * margin;
        let of = |window: &[[f32; FEATURES]]| {
            // Rows first: of each only what the window's columns need.
            let rows: Vec<[f32; FEATURES]> =
                (0..across * side).map(|at| self.at(window, at / side * across + margin + at % side, 1)).collect();
            (0..side * side).map(|at| self.at(&rows, (margin + at / side) * side + at % side, side)).collect::<Vec<_>>()
        };
        features.chunks_exact(across * across).flat_map(of).collect()
    }

    /// The mean about `at` along a line of numbers that are `stride` apart.
    fn at(&self, of: &[[f32; FEATURES]], at: usize, stride: usize) -> [f32; FEATURES] {
        let Some((middle, beside)) = self.kernel.split_first() else { return of[at] };
        let mut sum = of[at].map(|v| middle * v);
        for (k, weight) in beside.iter().enumerate() {
            let (before, after) = (&of[at - (k + 1) * stride], &of[at + (k + 1) * stride]);
            sum.iter_mut().zip(before).zip(after).for_each(|((s, a), b)| *s += weight * (a + b));
        }
        sum
    }
}

/// The place in `range` where `cost` is least, to `within`, by the golden section (Kiefer 1953): right where the cost
/// falls up to one place and rises from there.
pub(crate) fn least(range: Range<f64>, within: f64, mut cost: impl FnMut(f64) -> f64) -> f64 {
    let share = (5f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (range.start, range.end);
    let (mut a, mut b) = (high - share * (high - low), low + share * (high - low));
    let (mut of_a, mut of_b) = (cost(a), cost(b));
    while high - low > within {
        if of_a < of_b {
            (high, b, of_b) = (b, a, of_a);
            a = high - share * (high - low);
            of_a = cost(a);
        } else {
            (low, a, of_a) = (a, b, of_b);
            b = low + share * (high - low);
            of_b = cost(b);
        }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_keeps_sums_and_spreads_by_its_width() {
        let spread = |sigma: f64| {
            let blur = Blur::of(sigma);
            let of = |k: usize| f64::from(blur.kernel[k]);
            let sum = of(0) + 2.0 * (1..blur.kernel.len()).map(of).sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-6, "{sum}");
            (2.0 * (1..blur.kernel.len()).map(|k| of(k) * (k * k) as f64).sum::<f64>()).sqrt()
        };
        for sigma in [0.6, 1.0, 2.0, 3.0] {
            // What is cut off makes it a little narrower.
            assert!((spread(sigma) / sigma - 1.0).abs() < 0.06, "{sigma}: {}", spread(sigma));
        }
        assert_eq!((Blur::of(0.2), Blur::of(0.2).margin(), Blur::of(2.0).margin()), (Blur::NONE, 0, 5));
        let half = Blur::of(2.0).halved().unwrap();
        assert!((half.sigma_px - 1.04).abs() < 0.01 && Blur::of(1.4).halved().is_none());
    }

    #[test]
    fn windows_are_blurred_one_by_one_within_their_margins() {
        let (blur, margin, side, windows) = (Blur::of(0.8), 4, 8, 3);
        let across = side + 2 * margin;
        // Rises along both sides, each window from another level: blurred it is what it was.
        let level = |n: usize, x: usize, y: usize| 10.0 * n as f32 + x as f32 + 2.0 * y as f32;
        let features: Vec<[f32; FEATURES]> = (0..windows * across * across)
            .map(|i| [level(i / (across * across), i % across, i % (across * across) / across); FEATURES])
            .collect();
        let blurred = blur.of_windows(&features, side, margin);
        assert_eq!(blurred.len(), windows * side * side);
        for (i, pixel) in blurred.iter().enumerate() {
            let (n, at) = (i / (side * side), i % (side * side));
            let expected = level(n, margin + at % side, margin + at / side);
            assert!((pixel[0] - expected).abs() < 1e-3, "{i}: {} for {expected}", pixel[0]);
        }
        // One bright pixel among dark ones spreads as the kernel says.
        let mut bright = vec![[0.0; FEATURES]; across * across];
        bright[(margin + 3) * across + margin + 2] = [1.0; FEATURES];
        let spread = blur.of_windows(&bright, side, margin);
        for (x, y, k) in [(2, 3, [0, 0]), (4, 3, [2, 0]), (1, 2, [1, 1])] {
            assert!((spread[y * side + x][0] - blur.kernel[k[0]] * blur.kernel[k[1]]).abs() < 1e-6);
        }
        assert_eq!(Blur::NONE.of_windows(&features, side, margin)[1][0], level(0, margin + 1, margin));
    }

    #[test]
    fn the_least_cost_is_found() {
        for truth in [0.0, 0.4, 1.7, 3.0] {
            let found = least(0.0..3.0, 0.02, |at| (at - truth).abs().sqrt());
            assert!((found - truth).abs() < 0.02, "{found} for {truth}");
        }
    }
}
