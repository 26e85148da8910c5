//! How well two tables agree on an order: Spearman's rank correlation, over all of their numbers, within rows and within
//! columns, with intervals over rows.

use crate::bootstrap::{LIMITS, draws, quantile};

/// Numbers by view (row) and group of contributors (column).
pub type Table = Vec<Vec<f64>>;

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

impl Agreement {
    fn less(self, other: &Self) -> Self {
        Self {
            all: self.all - other.all,
            within_views: self.within_views - other.within_views,
            within_groups: self.within_groups - other.within_groups,
            same_first: self.same_first - other.same_first,
        }
    }
}

/// How much better `a` agrees with `truth` than `rival` does, on the same draws of views: see [`interval`].
pub fn advantage(a: &Table, rival: &Table, truth: &Table, seed: u64) -> Spread {
    let ahead = |rows: &[usize]| over(a, truth, rows).less(&over(rival, truth, rows));
    Spread::of(a.len(), seed, ahead)
}

/// How well sums over the columns of a subset foresee what leaving that subset out does (the linear datamodeling score of
/// Park et al. 2023, "TRAK", section 2): Spearman's rank correlation over the subsets, its mean over views. `truth` has a
/// column for each of `subsets`.
pub fn datamodeling(a: &Table, subsets: &[Vec<usize>], truth: &Table) -> Vec<f64> {
    let foreseen = |row: &Vec<f64>| subsets.iter().map(|of| of.iter().map(|k| row[*k]).sum()).collect::<Vec<f64>>();
    a.iter().zip(truth).map(|(row, truth)| spearman(&foreseen(row), truth).unwrap_or_default()).collect()
}

/// A figure over all views, and its limits by the bootstrap over views.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Over all views.
    pub whole: Agreement,
    /// The lower limit of each figure,
    pub low: Agreement,
    /// and the upper one.
    pub high: Agreement,
}

impl Spread {
    fn of(views: usize, seed: u64, figure: impl Fn(&[usize]) -> Agreement) -> Self {
        let draws: Vec<Agreement> = draws(views, seed).map(|rows| figure(&rows)).collect();
        let at = |of: fn(&Agreement) -> f64, share: f64| quantile(draws.iter().map(of).collect(), share);
        let of = |share: f64| Agreement {
            all: at(|v| v.all, share),
            within_views: at(|v| v.within_views, share),
            within_groups: at(|v| v.within_groups, share),
            same_first: at(|v| v.same_first, share),
        };
        Self { whole: figure(&(0..views).collect::<Vec<_>>()), low: of(LIMITS[0]), high: of(LIMITS[1]) }
    }
}

/// How `a` and `b` agree, with an interval.
///
/// # Panics
/// When they are of different sizes.
pub fn interval(a: &Table, b: &Table, seed: u64) -> Spread {
    Spread::of(a.len(), seed, |rows| over(a, b, rows))
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
        let found = interval(&a, &b, 1).whole;
        assert!((found.within_views - (1.0 - 0.5) / 2.0).abs() < 1e-12 && (found.same_first - 0.5).abs() < 1e-12);
        assert!((found.within_groups - 1.0 / 3.0).abs() < 1e-12, "two columns rise in both, one falls");
        let tied = vec![vec![5.0; 3], vec![5.0; 3]];
        assert!((interval(&tied, &b, 1).whole.same_first - 1.0 / 3.0).abs() < 1e-12, "a third of each");
        let Spread { low, high, .. } = interval(&a, &a, 1);
        assert!(low.all > 0.999 && high.same_first > 0.999);
        let ahead = advantage(&b, &tied, &b, 1);
        assert!((ahead.whole.same_first - 2.0 / 3.0).abs() < 1e-12 && ahead.low.same_first > 0.6);
    }

    #[test]
    fn subsets_are_foreseen_by_sums() {
        let a = vec![vec![1.0, 2.0, 4.0]];
        let subsets = [vec![0, 1], vec![2], vec![0, 2]];
        assert_eq!(datamodeling(&a, &subsets, &vec![vec![10.0, 20.0, 30.0]]), [1.0]);
        assert_eq!(datamodeling(&a, &subsets, &vec![vec![30.0, 20.0, 10.0]]), [-1.0]);
    }
}
