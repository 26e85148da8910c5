//! How well two tables agree on an order: Spearman's rank correlation, over all of their numbers, within rows and within
//! columns, with intervals over rows.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Numbers by view (row) and group of contributors (column).
pub type Table = Vec<Vec<f64>>;

/// Draws of an interval.
const DRAWS: usize = 1000;

/// Spearman's rank correlation, -1 to 1; equal numbers share their ranks' mean. `None` where one side has one value only.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    pearson(&ranks(a), &ranks(b))
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    for tied in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let mean = from as f64 + (tied.len() - 1) as f64 / 2.0;
        tied.iter().for_each(|at| ranks[*at] = mean);
        from += tied.len();
    }
    ranks
}

fn pearson(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (of_a, of_b) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(x, y)| f(x - of_a, y - of_b)).sum::<f64>();
    let (aa, bb, ab) = (sum(&|x, _| x * x), sum(&|_, y| y * y), sum(&|x, y| x * y));
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

/// Agreement of two tables.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Over all numbers.
    pub all: f64,
    /// Mean over views.
    pub within_views: f64,
    /// Mean over groups.
    pub within_groups: f64,
    /// Views on which `a` puts the group first that `b` does; where `a` puts several first, a part.
    pub same_first: f64,
}

/// How `a` and `b` agree.
///
/// # Panics
/// When they are of different sizes.
pub fn agreement(a: &Table, b: &Table) -> Agreement {
    let rows: Vec<usize> = (0..a.len()).collect();
    over(a, b, &rows)
}

/// As [`agreement`], the limits between which 95 % of draws of as many views lie, each view as often as it is drawn
/// (Efron's bootstrap): low, high.
pub fn interval(a: &Table, b: &Table, seed: u64) -> (Agreement, Agreement) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let draws: Vec<Agreement> = (0..DRAWS)
        .map(|_| over(a, b, &(0..a.len()).map(|_| rng.random_range(0..a.len())).collect::<Vec<_>>()))
        .collect();
    let at = |of: fn(&Agreement) -> f64, share: f64| {
        let mut sorted: Vec<f64> = draws.iter().map(of).collect();
        sorted.sort_by(f64::total_cmp);
        sorted[((DRAWS - 1) as f64 * share).round() as usize]
    };
    let of = |share: f64| Agreement {
        all: at(|v| v.all, share),
        within_views: at(|v| v.within_views, share),
        within_groups: at(|v| v.within_groups, share),
        same_first: at(|v| v.same_first, share),
    };
    (of(0.025), of(0.975))
}

fn over(a: &Table, b: &Table, rows: &[usize]) -> Agreement {
    let flat = |table: &Table| rows.iter().flat_map(|row| table[*row].clone()).collect::<Vec<f64>>();
    let column = |table: &Table, k: usize| rows.iter().map(|row| table[*row][k]).collect::<Vec<f64>>();
    let mean = |values: Vec<Option<f64>>| {
        let known: Vec<f64> = values.into_iter().flatten().collect();
        if known.is_empty() { 0.0 } else { known.iter().sum::<f64>() / known.len() as f64 }
    };
    let firsts = |row: &[f64]| {
        let max = row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (0..row.len()).filter(|k| row[*k] == max).collect::<Vec<usize>>()
    };
    let named = |row: &usize| {
        let (said, right) = (firsts(&a[*row]), firsts(&b[*row]));
        said.iter().filter(|k| right.contains(k)).count() as f64 / said.len().max(1) as f64
    };
    Agreement {
        all: spearman(&flat(a), &flat(b)).unwrap_or_default(),
        within_views: mean(rows.iter().map(|row| spearman(&a[*row], &b[*row])).collect()),
        within_groups: mean((0..a[0].len()).map(|k| spearman(&column(a, k), &column(b, k))).collect()),
        same_first: rows.iter().map(named).sum::<f64>() / rows.len() as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_agree_as_by_hand() {
        // Spearman's own formula without ties: 1 - 6 sum d^2 / (n (n^2 - 1)) = 1 - 6 * 4 / 60.
        let rho = spearman(&[1.0, 2.0, 30.0, 4.0], &[0.1, 0.3, 0.2, 0.4]).unwrap();
        assert!((rho - 0.4).abs() < 1e-12, "{rho}");
        // A tie shares ranks 1 and 2 as 1.5: covariance 4.5 of variances 4.5 and 5.
        let rho = spearman(&[1.0, 2.0, 2.0, 3.0], &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((rho - 4.5 / 22.5f64.sqrt()).abs() < 1e-12, "{rho}");
        assert_eq!(spearman(&[1.0, 1.0], &[1.0, 2.0]), None);
    }

    #[test]
    fn tables_agree_by_rows_columns_and_first_places() {
        let a = vec![vec![1.0, 2.0, 3.0], vec![2.0, 3.0, 9.0]];
        let b = vec![vec![1.0, 2.0, 3.0], vec![3.0, 4.0, 0.0]];
        let found = agreement(&a, &b);
        assert!((found.within_views - (1.0 - 0.5) / 2.0).abs() < 1e-12 && (found.same_first - 0.5).abs() < 1e-12);
        assert!((found.within_groups - 1.0 / 3.0).abs() < 1e-12, "two columns rise in both, one falls");
        let tied = vec![vec![5.0; 3], vec![5.0; 3]];
        assert!((agreement(&tied, &b).same_first - 1.0 / 3.0).abs() < 1e-12, "a third of each");
        let (low, high) = interval(&a, &a, 1);
        assert!(low.all > 0.999 && high.same_first > 0.999);
    }
}
