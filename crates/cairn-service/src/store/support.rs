//! Which photographs structure from motion does not support, and what is held against a view therefore.
//!
//! A residual alone excludes nothing: a photograph that nobody else's overlaps fits weakly and is honest. What is
//! excluded without a person's word has two independent witnesses against it: the other photographs do not explain it,
//! and its pose is poorly known.

use cairn_scene::{Capture, Support};

use crate::store::exclusions::{Against, Measured};

/// A photograph with fewer reconstructed points is poorly supported. Three points fix a pose, and a fourth tells the
/// solutions apart; COLMAP registers a photograph with 30 inliers at least (`abs_pose_min_num_inliers`), ten times the
/// minimal set. One that keeps fewer lost them to the filters after bundle adjustment.
pub const MIN_POINTS: u32 = 30;
/// How many sigmas above the scene's median a reprojection error is large: of honest photographs one in 740 is, where
/// errors are normally distributed. Median and MAD hold up to half of the photographs.
const MAX_ERROR_SIGMAS: f64 = 3.0;
/// MAD to sigma, of a normal distribution.
const SIGMAS_PER_MAD: f64 = 1.4826;

/// What structure from motion says against each view, in their order; `None` where it supports the view, or the
/// capture brings nothing of that.
pub fn unsupported(supports: &[Option<Support>]) -> Vec<Option<String>> {
    let errors = supports.iter().flatten().filter(|s| s.points > 0).map(|s| s.reprojection_error_px);
    let errors: Vec<f64> = errors.collect();
    let middle = median(errors.clone());
    let sigma = SIGMAS_PER_MAD * median(errors.iter().map(|e| (e - middle).abs()).collect());
    let limit = middle + MAX_ERROR_SIGMAS * sigma;
    let of = |support: &Support| {
        if support.points < MIN_POINTS {
            return Some(format!("{} reconstructed points, and fewer than {MIN_POINTS} are few", support.points));
        }
        let error = support.reprojection_error_px;
        (error > limit)
            .then(|| format!("a reprojection error of {error:.2} px, where the scene's limit is {limit:.2} px"))
    };
    supports.iter().map(|support| support.as_ref().and_then(of)).collect()
}

/// What structure from motion says of each view of a capture, in their order. Nothing where none of them sees a point: the
/// capture's points do not say then which photographs saw them, and no view's support is known.
pub fn supports(capture: &Capture) -> Vec<Option<Support>> {
    known(capture.views.iter().map(|view| view.support).collect())
}

/// `supports`, or nothing of any view where none of them sees a point.
fn known(supports: Vec<Option<Support>>) -> Vec<Option<Support>> {
    let is_known = supports.iter().flatten().any(|support| support.points > 0);
    supports.into_iter().map(|support| support.filter(|_| is_known)).collect()
}

/// What excludes views of `capture`: they are outliers of the screening, and structure from motion does not support them.
pub fn against(capture: &Capture, measured: &Measured) -> Vec<Against> {
    let unsupported = unsupported(&supports(capture));
    let outlies = |name: &str| measured.scores.iter().find(|s| s.view == name && s.is_outlier);
    let views = capture.views.iter().zip(unsupported).enumerate();
    let against = views.filter_map(|(at, (view, why))| {
        let (score, why) = (outlies(&view.name)?, why?);
        let fit = score.fit_db;
        Some(Against { view: at, why: format!("the other views explain it by {fit:.2} dB, and it has {why}") })
    });
    against.collect()
}

/// The middle one of some numbers, the upper one of two; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_points_and_large_errors_are_no_support() {
        let support = |points, reprojection_error_px| Some(Support { points, reprojection_error_px });
        let mut supports: Vec<_> = (0..10).map(|n| support(400, 0.5 + 0.01 * f64::from(n))).collect();
        assert!(unsupported(&supports).iter().all(Option::is_none));
        supports.extend([support(29, 0.5), support(30, 0.5), support(400, 4.0), None, support(0, 0.0)]);
        let against: Vec<bool> = unsupported(&supports).iter().map(Option::is_some).collect();
        assert_eq!(against[10..], [true, false, true, false, true]);
        assert!(unsupported(&supports)[12].as_ref().unwrap().contains("4.00 px"));
        assert_eq!(unsupported(&[None, None]), [None, None]);
    }

    #[test]
    fn points_that_no_photograph_sees_are_held_against_none() {
        let support = |points| Some(Support { points, reprojection_error_px: 0.0 });
        assert_eq!(known(vec![support(0), None, support(0)]), [None; 3]);
        let some = vec![support(0), None, support(2)];
        assert_eq!(known(some.clone()), some);
    }
}
