//! Limits of a figure over views by Efron's bootstrap (1979): the figure of many draws of as many views, each view as often
//! as it is drawn. 95 % of the draws lie between the limits.

use cairn_service::query::report::Right;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of an interval.
const DRAWS: usize = 1000;
/// The shares of the draws that lie below the lower and the upper limit.
pub const LIMITS: [f64; 2] = [0.025, 0.975];

/// Draws of `count` of the numbers below `count`, with repetition.
pub fn draws(count: usize, seed: u64) -> impl Iterator<Item = Vec<usize>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..DRAWS).map(move |_| (0..count).map(|_| rng.random_range(0..count)).collect())
}

/// The value that `share` of the values lie below, by the nearest rank; NaN of none.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

/// A share and its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Over all.
    pub whole: f64,
    /// The lower limit.
    pub low: f64,
    /// The upper limit.
    pub high: f64,
}

/// The share of right answers over all places, of each of which there may be several; `None` where none was asked for.
pub fn share(of_places: &[Right], seed: u64) -> Option<Interval> {
    let share = |places: &mut dyn Iterator<Item = usize>| {
        let (right, asked) = places.fold((0, 0), |(r, a), at| (r + of_places[at].right, a + of_places[at].asked));
        (asked > 0).then(|| right as f64 / asked as f64)
    };
    let whole = share(&mut (0..of_places.len()))?;
    // A draw of places without a question has no share.
    let drawn: Vec<f64> = draws(of_places.len(), seed).filter_map(|places| share(&mut places.into_iter())).collect();
    let [low, high] = LIMITS.map(|limit| quantile(drawn.clone(), limit));
    Some(Interval { whole, low, high })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_is_a_value_by_its_rank() {
        let values: Vec<f64> = (0..=100).rev().map(f64::from).collect();
        assert_eq!([0.025, 0.5, 0.975, 1.0].map(|share| quantile(values.clone(), share)), [3.0, 50.0, 98.0, 100.0]);
        assert!(quantile(Vec::new(), 0.5).is_nan());
    }

    #[test]
    fn places_are_drawn_and_not_answers() {
        let of = |right, asked| Right { right, asked };
        assert_eq!(share(&[of(0, 0); 3], 1), None);
        assert_eq!(share(&[of(5, 5); 3], 1), Some(Interval { whole: 1.0, low: 1.0, high: 1.0 }));
        // A hundred places of ten answers each, half of them all right. The limits are those of a hundred coins,
        // 0.5 -+ 1.96 * 0.05. A thousand coins would give a third of that.
        let halves: Vec<Right> = (0..100).map(|at| of(at % 2 * 10, 10)).collect();
        let found = share(&halves, 1).unwrap();
        assert_eq!(found.whole, 0.5);
        assert!((found.low - 0.402).abs() < 0.021 && (found.high - 0.598).abs() < 0.021, "{found:?}");
        // Places with more answers count more.
        assert_eq!(share(&[of(1, 1), of(0, 3)], 1).unwrap().whole, 0.25);
    }
}
