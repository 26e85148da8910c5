//! From fits to scores and outliers.
//!
//! Fits are compared in their logarithm: what honest views of one capture have spreads over a
//! factor, and what has no pose lies orders of magnitude below. Median and MAD (median of
//! absolute deviations, as sigmas) are moved by less than half of the views. An outlier
//! lies [`MAX_SCORE`] sigmas below the median, and below [`MIN_DB`] whatever the spread, so
//! that a good capture with a narrow spread loses nobody; and other poses explain it about
//! as well as its own, so that a photograph that nobody else's overlaps much, which fits weakly
//! but fits nowhere better, is kept. What captures gave is in docs/design/limits.md.

use super::fit::ViewFit;
use crate::stats::median;
use std::collections::BTreeSet;

/// What screening found of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewScore {
    /// The view.
    pub view: String,
    /// How many sigmas (of the fits' logarithms, by MAD) its fit lies below the median; below 0 where it lies above.
    pub score: f64,
    /// PSNR of the photograph as the others explain it from its own pose, less the median of the same
    /// from other poses, dB. About 0, or below, where it has nothing to do with its pose.
    pub fit_db: f64,
    /// Whether the others do not explain it: far below the median, and from its own pose no better than from others.
    pub is_outlier: bool,
}

/// Why no view is called an outlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// More than a fifth of the views would be, so many: the capture or the scouts are wrong.
    TooMany(usize),
    /// The scouts explain the views so little that nothing can be told.
    Untold,
}

/// What screening came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Screened {
    /// Every view's, in their order; suspects' by the second look.
    pub scores: Vec<ViewScore>,
    /// Median of the fits, dB.
    pub median_db: f64,
    /// What an outlier stays below, dB.
    pub limit_db: f64,
    /// Where there is one, no view is an outlier.
    pub doubt: Option<Doubt>,
}

/// How many sigmas below the median an outlier lies. The fits' logarithms have a longer tail than a normal
/// distribution. Chosen on liberty's 118 visitors' photographs, where it makes limits of 0.17 and 0.20 dB (two
/// seeds): the second-least honest view fits by 0.46 dB, and nine of ten wrong ones by 0.12 dB at most.
const MAX_SCORE: f64 = 6.5;
/// A view that fits its pose by this much is no outlier, dB. Where all photographs fit alike, 6.5 sigmas are little;
/// what has nothing to do with its pose fits by 0 dB, give or take chance.
const MIN_DB: f64 = 0.5;
/// Largest share of the views that can be outliers. Median and MAD hold up to a half; long before, the scouts learn
/// from so many wrong views that their word counts for little.
const MAX_SHARE: f64 = 0.2;
/// Spread below which scores are counted by this: fits that are all alike tell nothing of a sigma.
const MIN_SPREAD: f64 = 1e-3;
/// Median fit below which scouts have not learnt enough to tell anything, dB.
const TOLD_FROM_DB: f64 = 0.8;
/// What is below this counts as this much, dB: a logarithm needs something.
const FLOOR_DB: f64 = 0.01;
/// Views that fit by less than this share of the median are looked at again, a third of all at most.
const SUSPECT: f64 = 0.5;
/// A pose that explains a photograph this much better than others do, in their standard
/// deviations, is its own.
const OWN_POSE: f64 = 1.0;

/// Whom to look at a second time, the worst at most a third of all.
pub(super) fn suspects(fits: &[ViewFit], trusted: &BTreeSet<usize>) -> Vec<usize> {
    let limit = SUSPECT * median(fits.iter().map(|f| f.fit_db).collect());
    let mut found: Vec<usize> = (0..fits.len()).filter(|v| fits[*v].fit_db < limit && !trusted.contains(v)).collect();
    found.sort_by(|a, b| fits[*a].fit_db.total_cmp(&fits[*b].fit_db));
    found.truncate(fits.len() / 3);
    found.sort_unstable();
    found
}

pub(super) fn screened(fits: &[ViewFit], trusted: &BTreeSet<usize>) -> Screened {
    let logarithms: Vec<f64> = fits.iter().map(|f| f.fit_db.max(FLOOR_DB).ln()).collect();
    let middle = median(logarithms.clone());
    let spread = 1.4826 * median(logarithms.iter().map(|v| (v - middle).abs()).collect());
    let limit_db = (middle - MAX_SCORE * spread).exp().min(MIN_DB);
    let outlies = |at: usize| fits[at].fit_db < limit_db && fits[at].deviations < OWN_POSE && !trusted.contains(&at);
    let found = (0..fits.len()).filter(|at| outlies(*at)).count();
    let doubt = if middle.exp() < TOLD_FROM_DB {
        Some(Doubt::Untold)
    } else {
        (found as f64 > MAX_SHARE * fits.len() as f64).then_some(Doubt::TooMany(found))
    };
    let score = |at: usize| ViewScore {
        view: fits[at].view.clone(),
        score: (middle - logarithms[at]) / spread.max(MIN_SPREAD),
        fit_db: fits[at].fit_db,
        is_outlier: doubt.is_none() && outlies(at),
    };
    Screened { scores: (0..fits.len()).map(score).collect(), median_db: middle.exp(), limit_db, doubt }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits(db: &[f64]) -> Vec<ViewFit> {
        let one =
            |(n, fit_db): (usize, &f64)| ViewFit { view: n.to_string(), fit_db: *fit_db, deviations: fit_db * 2.0 };
        db.iter().enumerate().map(one).collect()
    }

    fn outliers(found: &Screened) -> Vec<usize> {
        (0..found.scores.len()).filter(|at| found.scores[*at].is_outlier).collect()
    }

    fn found(db: &[f64]) -> Screened {
        screened(&fits(db), &BTreeSet::new())
    }

    #[test]
    fn what_fits_nowhere_is_an_outlier_and_what_fits_weakly_is_not() {
        let good = [3.0, 2.5, 4.0, 1.0, 3.5, 6.0, 2.0, 0.7, 3.3, 5.0];
        assert_eq!(outliers(&found(&good)), [0; 0]);
        let mut poisoned = good.to_vec();
        poisoned.extend([-0.8, 0.0]);
        assert_eq!(outliers(&found(&poisoned)), [10, 11]);
        // A narrow spread puts 4.8 many sigmas below: it is no outlier for that.
        let narrow = found(&[6.0, 6.1, 5.9, 6.0, 6.05, 5.95, 6.0, 4.8]);
        assert!(narrow.scores[7].score > MAX_SCORE && narrow.doubt.is_none(), "{narrow:?}");
        assert_eq!(outliers(&narrow), [0; 0]);
        // Weak, and yet nowhere better: its place is one that no other view has.
        let mut lonely = fits(&good);
        lonely.push(ViewFit { view: "lonely".into(), fit_db: 0.1, deviations: 2.5 });
        assert_eq!(outliers(&screened(&lonely, &BTreeSet::new())), [0; 0]);
    }

    #[test]
    fn scores_are_robust_sigmas_of_the_logarithm() {
        let e = std::f64::consts::E;
        // Logarithms -1, 0, 0, 1, 1: the median is 0, that of the distances 1.
        let scores = found(&[1.0 / e, 1.0, 1.0, e, e]).scores;
        let expected = [1.0, 0.0, 0.0, -1.0, -1.0].map(|v| v / 1.4826);
        assert!(scores.iter().zip(expected).all(|(s, v)| (s.score - v).abs() < 1e-9), "{scores:?}");
        // All alike: no score is out of bounds.
        assert!(found(&[2.0; 9]).scores.iter().all(|s| s.score == 0.0));
    }

    #[test]
    fn too_many_are_not_believed_and_scouts_that_know_nothing_not_asked() {
        let mut many = vec![3.0; 7];
        many.extend([-0.5, -0.4, 0.0]);
        let many = found(&many);
        assert_eq!((many.doubt, outliers(&many)), (Some(Doubt::TooMany(3)), vec![]));
        assert_eq!(found(&[0.1, 0.2, 0.0, 0.1, -0.1, 0.2, 0.1, 0.1]).doubt, Some(Doubt::Untold));
    }

    #[test]
    fn whom_a_person_trusts_is_neither_suspect_nor_outlier() {
        let all = fits(&[3.0, 2.5, 4.0, 2.0, 3.5, 6.0, -0.8, -0.1]);
        assert_eq!(suspects(&all, &BTreeSet::new()), [6, 7]);
        let trusted = BTreeSet::from([6]);
        assert_eq!(suspects(&all, &trusted), [7]);
        assert_eq!(outliers(&screened(&all, &trusted)), [7]);
    }
}
