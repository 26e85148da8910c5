//! What light to expect of a photograph, and the appearance that then explains its
//! pixels best. A code of [`CODE`] numbers fitted to half of a photograph says
//! something about the other half only as far as its numbers go together, and how they
//! go together at a place is in the codes of the views that the field was trained with:
//! their mean and covariance are the prior of a linear regression (Bishop 2006,
//! section 3.3), whose maximum a posteriori is one small linear system.
//!
//! The codes seen are taken at their word: that training pulled them to neutral, and how
//! sure each of their numbers is, is not made up for.

use super::cholesky::{factor, solve};
use super::code::{Appearance, CODE, FEATURES};

/// A normal distribution of appearance codes.
#[derive(Clone, Debug)]
pub struct Prior {
    pub(crate) mean: Appearance,
    /// `CODE x CODE`, symmetric: [`NOISE`] times the inverse covariance.
    pub(crate) precision: Vec<f64>,
}

/// Variance of a pixel about its shade, 0.07^2 (colours in [0, 1]), by the number of
/// pixels that a photograph amounts to: neighbours err together, so that all of them
/// say what 245 would that do not.
const NOISE: f64 = 2e-5;
/// Where no view was seen, every number of a code has this variance.
const VARIANCE: f64 = 0.02;
/// So many views' worth is that believed against the codes of those that were.
const VIEWS: f64 = 4.0;

impl Prior {
    /// Anything near `mean`, in no direction rather than another.
    pub fn around(mean: Appearance) -> Self {
        let mut precision = vec![0.0; CODE * CODE];
        for k in 0..CODE {
            precision[k * CODE + k] = NOISE / VARIANCE;
        }
        Self { mean, precision }
    }

    /// Codes like `seen`: their mean and their covariance, shrunk towards what is
    /// believed where there are none. `None` where there are none, or their numbers are so
    /// large that rounding leaves their covariance no inverse.
    pub fn of(seen: &[&Appearance]) -> Option<Self> {
        let mean = Appearance::mean(seen)?;
        let mut covariance = vec![0.0; CODE * CODE];
        for code in seen {
            let pairs = code.code().iter().zip(mean.code());
            let off: Vec<f64> = pairs.map(|(a, b)| f64::from(*a) - f64::from(*b)).collect();
            for (row, a) in covariance.chunks_exact_mut(CODE).zip(&off) {
                row.iter_mut().zip(&off).for_each(|(sum, b)| *sum += a * b);
            }
        }
        for k in 0..CODE {
            covariance[k * CODE + k] += VIEWS * VARIANCE;
        }
        // The mean took one view's worth of the spread about it.
        let scale = NOISE * ((seen.len() - 1) as f64 + VIEWS);
        factor(&mut covariance, CODE)?;
        let mut precision = vec![0.0; CODE * CODE];
        for (k, column) in precision.chunks_exact_mut(CODE).enumerate() {
            column[k] = scale;
            solve(&covariance, column);
        }
        Some(Self { mean, precision })
    }

    /// How unlikely `light` is before any pixel was seen: the second of the two parts that [`Prior::fit`] makes small.
    pub fn penalty(&self, light: &Appearance) -> f64 {
        let off: Vec<f64> =
            light.code().iter().zip(self.mean.code()).map(|(a, b)| f64::from(*a) - f64::from(*b)).collect();
        let row = |row: &[f64]| -> f64 { row.iter().zip(&off).map(|(p, b)| p * b).sum() };
        self.precision.chunks_exact(CODE).zip(&off).map(|(p, a)| a * row(p)).sum()
    }

    /// The likeliest code given `features` (n) and the RGB `pixels` (n, in [0, 1]) that show
    /// them: minimises the mean of `|code . f - pixel|^2` plus
    /// `(code - mean)^T precision (code - mean)`, exactly; the mean where n is 0.
    /// `None` when a number is not finite, or the code would not be.
    pub fn fit(&self, features: &[[f32; FEATURES]], pixels: &[[f32; 3]]) -> Option<Appearance> {
        debug_assert_eq!(features.len(), pixels.len());
        let mean: Vec<f64> = self.mean.code().iter().map(|v| f64::from(*v)).collect();
        let share = 1.0 / features.len().max(1) as f64;
        // The normal equations of the step from the mean. Sums of features times features are one for all channels.
        let mut gram = [[0.0; FEATURES]; FEATURES];
        let mut right = vec![0.0; CODE];
        for (f, pixel) in features.iter().zip(pixels) {
            let f = f.map(f64::from);
            for (a, row) in gram.iter_mut().enumerate() {
                for b in 0..=a {
                    row[b] += share * f[a] * f[b];
                }
            }
            for ((right, mean), pixel) in right.chunks_exact_mut(FEATURES).zip(mean.chunks_exact(FEATURES)).zip(pixel) {
                let shown: f64 = mean.iter().zip(&f).map(|(a, b)| a * b).sum();
                let residual = share * (f64::from(*pixel) - shown);
                right.iter_mut().zip(&f).for_each(|(sum, f)| *sum += residual * f);
            }
        }
        let mut matrix = self.precision.clone();
        for c in 0..3 {
            for (a, gram) in gram.iter().enumerate() {
                let row = &mut matrix[(c * FEATURES + a) * CODE + c * FEATURES..][..=a];
                row.iter_mut().zip(gram).for_each(|(sum, g)| *sum += g);
            }
        }
        factor(&mut matrix, CODE)?;
        solve(&matrix, &mut right);
        Appearance::from_code(mean.iter().zip(right).map(|(v, by)| (v + by) as f32).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels_of(truth: &Appearance, count: usize, active: usize) -> (Vec<[f32; FEATURES]>, Vec<[f32; 3]>) {
        let features: Vec<[f32; FEATURES]> = (0..count)
            // A frequency of its own for each feature makes them independent.
            .map(|i| {
                std::array::from_fn(|k| if k < active { (i as f32 * (0.31 + 0.17 * k as f32)).sin() } else { 0.0 })
            })
            .collect();
        let pixels = features.iter().map(|f| truth.shade(f)).collect();
        (features, pixels)
    }

    fn code(of: impl Fn(usize) -> f32) -> Appearance {
        Appearance::from_code((0..CODE).map(of).collect()).unwrap()
    }

    fn distance(a: &Appearance, b: &Appearance) -> f32 {
        a.code().iter().zip(b.code()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn a_fit_finds_the_code_that_made_the_pixels() {
        let truth = code(|i| 0.3 * (i as f32 * 0.7).sin());
        let (features, pixels) = pixels_of(&truth, 400, FEATURES);
        let found = Prior::around(Appearance::neutral([0.0; 3])).fit(&features, &pixels).unwrap();
        // A feature's mean square is a half, and the prior's share a thousandth.
        let off = |k: usize| (found.code()[k] - truth.code()[k]).abs();
        assert!((0..CODE).all(|k| off(k) < 5e-3), "{}", distance(&found, &truth));
        // And it is where the sum to be minimised has no slope.
        let slope = |k: usize| {
            let (c, a) = (k / FEATURES, k % FEATURES);
            let residual = |(f, p): (&[f32; FEATURES], &[f32; 3])| f64::from((found.shade(f)[c] - p[c]) * f[a]);
            let told = features.iter().zip(&pixels).map(residual).sum::<f64>() / features.len() as f64;
            let mean = Appearance::neutral([0.0; 3]);
            told + NOISE / VARIANCE * f64::from(found.code()[k] - mean.code()[k])
        };
        assert!((0..CODE).all(|k| slope(k).abs() < 1e-6));
        let (prior, neutral) = (Prior::around(Appearance::neutral([0.0; 3])), Appearance::neutral([0.0; 3]));
        let expected: f64 = truth.code().iter().zip(neutral.code()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        assert!((prior.penalty(&truth) / (NOISE / VARIANCE * expected) - 1.0).abs() < 1e-5);
        assert_eq!(prior.penalty(&neutral), 0.0);
    }

    #[test]
    fn without_pixels_the_fit_is_the_mean() {
        let mean = Appearance::neutral([0.2, 0.4, 0.6]);
        assert_eq!(Prior::around(mean.clone()).fit(&[], &[]), Some(mean));
    }

    #[test]
    fn what_the_pixels_leave_open_follows_what_they_tell_as_it_did_in_other_views() {
        // In every view seen all numbers of a code rise and fall together; of a new one
        // only the first four features show.
        let light = |by: f32| code(|_| by);
        let seen: Vec<Appearance> = (0..40).map(|n| light((n as f32 - 19.5) / 20.0)).collect();
        let (features, pixels) = pixels_of(&light(0.6), 400, 4);
        let prior = Prior::of(&seen.iter().collect::<Vec<_>>()).unwrap();
        let found = prior.fit(&features, &pixels).unwrap();
        assert!(distance(&found, &light(0.6)) < 0.02, "{:?}", found.code());
        // Who saw none does not know: there what does not show stays as it was.
        let found = Prior::around(light(0.0)).fit(&features, &pixels).unwrap();
        assert!(found.code()[FEATURES - 1].abs() < 1e-6 && (found.code()[0] - 0.6).abs() < 0.01);
    }

    #[test]
    fn views_that_are_all_alike_leave_room_for_another() {
        let same = Appearance::neutral([0.5; 3]);
        let truth = code(|i| same.code()[i] + if i == 0 { 0.4 } else { 0.0 });
        let (features, pixels) = pixels_of(&truth, 400, FEATURES);
        let found = Prior::of(&[&same; 100]).unwrap().fit(&features, &pixels).unwrap();
        assert!(distance(&found, &truth) < 0.05, "{}", distance(&found, &truth));
    }

    #[test]
    fn one_view_says_nothing_of_how_views_differ() {
        let only = Appearance::neutral([0.5; 3]);
        let (one, none) = (Prior::of(&[&only]).unwrap(), Prior::around(only));
        assert_eq!(one.mean, none.mean);
        for (a, b) in one.precision.iter().zip(&none.precision) {
            assert!((a - b).abs() < 1e-12, "{a} for {b}");
        }
        assert!(Prior::of(&[]).is_none());
    }

    #[test]
    fn numbers_that_no_light_has_are_refused() {
        let (vast, small) = (code(|k| if k % 2 == 0 { 3e38 } else { -3e38 }), code(|_| 0.1));
        assert!(Prior::of(&[&vast, &small, &small]).is_none());
        let around = Prior::around(small);
        for pixel in [f32::NAN, f32::INFINITY] {
            assert_eq!(around.fit(&[[1.0; FEATURES]], &[[pixel; 3]]), None);
            assert_eq!(around.fit(&[[pixel; FEATURES]], &[[1.0; 3]]), None);
        }
        // What is finite but cannot be held in a code.
        assert_eq!(around.fit(&[[1e-36; FEATURES]; 2], &[[f32::MAX; 3]; 2]).map(|_| ()), Some(()));
        assert_eq!(around.fit(&[[0.02; FEATURES]; 2], &[[f32::MAX; 3]; 2]), None);
    }
}
