//! From fits to outliers, and the settings of that.
//!
//! Fits are compared in their logarithm: what honest views of one capture have spreads over a
//! factor, and what has no pose lies orders of magnitude below. Median and MAD (median of
//! absolute deviations, as sigmas) are moved by less than half of the views. An outlier
//! lies `deviations` sigmas below the median, and below `min_db` whatever the spread, so
//! that a good capture with a narrow spread loses nobody; and other poses explain it about
//! as well as its own, so that a photograph that nobody else's overlaps much, which fits weakly
//! but fits nowhere better, is kept. What captures gave is in docs/experiments.md.

use super::fit::ViewFit;
use crate::error::FieldError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Settings of the quarantine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QuarantineConfig {
    /// Whether views are screened before stage 1.
    pub enabled: bool,
    /// Scouts, each trained without its share of the views, 2 to 16: more of them cost
    /// more, and miss less of what surrounds a view.
    pub folds: usize,
    /// How many sigmas (of the logarithm, by MAD) an outlier lies below the median, 1 to 20.
    pub deviations: f64,
    /// A view that fits its pose by this much is no outlier, dB, 0 to 10.
    pub min_db: f64,
    /// Largest share of the views that can be outliers; where more are, it is the
    /// capture or the scouts that are wrong, and nobody is quarantined. 0 to 0.5.
    pub max_share: f64,
}

impl Default for QuarantineConfig {
    fn default() -> Self {
        Self { enabled: true, folds: 4, deviations: 6.5, min_db: 0.5, max_share: 0.2 }
    }
}

impl QuarantineConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// [`FieldError::Setting`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), FieldError> {
        let check = |ok: bool, key, value: String, allowed| {
            if ok { Ok(()) } else { Err(FieldError::Setting { key, value, allowed }) }
        };
        let number = |v: f64| v.to_string();
        check((2..=16).contains(&self.folds), "quarantine.folds", self.folds.to_string(), "2 to 16")?;
        check((1.0..=20.0).contains(&self.deviations), "quarantine.deviations", number(self.deviations), "1 to 20")?;
        check((0.0..=10.0).contains(&self.min_db), "quarantine.min_db", number(self.min_db), "0 to 10")?;
        check((0.0..=0.5).contains(&self.max_share), "quarantine.max_share", number(self.max_share), "0 to 0.5")
    }
}

/// What screening came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Screened {
    /// Every view's, in their order; suspects' by the second look.
    pub fits: Vec<ViewFit>,
    /// Median of the fits, dB.
    pub median_db: f64,
    /// Spread of their natural logarithms: 1.4826 times the MAD.
    pub spread: f64,
    /// What an outlier stays below, dB.
    pub limit_db: f64,
    /// Who that is.
    pub outcome: ScreeningOutcome,
}

/// Which views are outliers, by their index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ScreeningOutcome {
    /// These, which may be none.
    Outliers(Vec<usize>),
    /// More than `max_share` of the views would be: that is not believed.
    TooMany(Vec<usize>),
    /// The scouts explain the views so little that nothing can be told.
    Untold,
}

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

pub(super) fn screened(fits: Vec<ViewFit>, trusted: &BTreeSet<usize>, settings: &QuarantineConfig) -> Screened {
    let logarithms: Vec<f64> = fits.iter().map(|f| f.fit_db.max(FLOOR_DB).ln()).collect();
    let middle = median(logarithms.clone());
    let spread = 1.4826 * median(logarithms.iter().map(|v| (v - middle).abs()).collect());
    let limit_db = (middle - settings.deviations * spread).exp().min(settings.min_db);
    let outlies = |v: &usize| {
        let fit = &fits[*v];
        fit.fit_db < limit_db && fit.deviations < OWN_POSE && !trusted.contains(v)
    };
    let found: Vec<usize> = (0..fits.len()).filter(outlies).collect();
    let outcome = if middle.exp() < TOLD_FROM_DB {
        ScreeningOutcome::Untold
    } else if found.len() as f64 > settings.max_share * fits.len() as f64 {
        ScreeningOutcome::TooMany(found)
    } else {
        ScreeningOutcome::Outliers(found)
    };
    Screened { fits, median_db: middle.exp(), spread, limit_db, outcome }
}

/// The middle one of some numbers, the upper one of two.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits(db: &[f64]) -> Vec<ViewFit> {
        let one =
            |(n, fit_db): (usize, &f64)| ViewFit { view: n.to_string(), fit_db: *fit_db, deviations: fit_db * 2.0 };
        db.iter().enumerate().map(one).collect()
    }

    fn outcome(db: &[f64]) -> ScreeningOutcome {
        screened(fits(db), &BTreeSet::new(), &QuarantineConfig::default()).outcome
    }

    #[test]
    fn what_fits_nowhere_is_an_outlier_and_what_fits_weakly_is_not() {
        let good = [3.0, 2.5, 4.0, 1.0, 3.5, 6.0, 2.0, 0.7, 3.3, 5.0];
        assert_eq!(outcome(&good), ScreeningOutcome::Outliers(vec![]));
        let mut poisoned = good.to_vec();
        poisoned.extend([-0.8, 0.0]);
        assert_eq!(outcome(&poisoned), ScreeningOutcome::Outliers(vec![10, 11]));
        // A narrow spread puts 4.8 many sigmas below: it is no outlier for that.
        assert_eq!(outcome(&[6.0, 6.1, 5.9, 6.0, 6.05, 5.95, 6.0, 4.8]), ScreeningOutcome::Outliers(vec![]));
        // Weak, and yet nowhere better: somebody stood where nobody else did.
        let mut lonely = fits(&good);
        lonely.push(ViewFit { view: "lonely".into(), fit_db: 0.1, deviations: 2.5 });
        let alone = screened(lonely, &BTreeSet::new(), &QuarantineConfig::default());
        assert_eq!(alone.outcome, ScreeningOutcome::Outliers(vec![]));
    }

    #[test]
    fn too_many_are_not_believed_and_scouts_that_know_nothing_not_asked() {
        let mut many = vec![3.0; 7];
        many.extend([-0.5, -0.4, 0.0]);
        assert_eq!(outcome(&many), ScreeningOutcome::TooMany(vec![7, 8, 9]));
        assert_eq!(outcome(&[0.1, 0.2, 0.0, 0.1, -0.1, 0.2, 0.1, 0.1]), ScreeningOutcome::Untold);
    }

    #[test]
    fn whom_a_person_trusts_is_neither_suspect_nor_outlier() {
        let all = fits(&[3.0, 2.5, 4.0, 2.0, 3.5, 6.0, -0.8, -0.1]);
        assert_eq!(suspects(&all, &BTreeSet::new()), [6, 7]);
        let trusted = BTreeSet::from([6]);
        assert_eq!(suspects(&all, &trusted), [7]);
        let found = screened(all, &trusted, &QuarantineConfig::default());
        assert_eq!(found.outcome, ScreeningOutcome::Outliers(vec![7]));
    }
}
