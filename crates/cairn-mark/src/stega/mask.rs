//! The gradient mask: coefficients that matter to the picture barely move,
//! those that don't carry the signal.
//!
//! The paper's `w = |theta_0|^alpha, m = w^-1 / sum(w^-1)` is infinite at zero and
//! tiny after a sum over millions. Here it is worked out in logarithms over a
//! floored magnitude and divided by its largest value, so that learning rates
//! keep their meaning; it is clipped below, so that one weight among millions
//! cannot hold all of it. It is applied to updates, not to gradients: Adam would
//! divide it out again.

use crate::stega::recipe::MaskKind;
use cairn_field::grid::sh::SH;
use cairn_field::{CarrierBasis, MarkableField};

/// Quantile of the magnitudes that counts as "does not matter": everything below
/// moves freely.
const FREE: f64 = 0.25;

/// The mask of a carrier, `rows x basis.width()`, each in `[min_mask, 1]`; 0 or 1 where it
/// is binary, 0 for the `share` of the weights that are largest.
pub(crate) fn gradient_mask(
    kind: MaskKind,
    alpha: f64,
    min_mask: f64,
    share: f64,
    field: &dyn MarkableField,
    basis: CarrierBasis,
) -> Vec<f32> {
    let magnitudes = match basis {
        CarrierBasis::Constant => field.row_magnitudes(),
        CarrierBasis::Harmonics => field.coefficient_magnitudes(),
    };
    let mask = match (kind, basis) {
        (MaskKind::Binary, _) => all_or_nothing(&magnitudes, share),
        (MaskKind::PerWeight, _) => from_magnitudes(&magnitudes, alpha, min_mask),
        (MaskKind::PerCoefficientGroup, CarrierBasis::Harmonics) => by_group(&magnitudes, alpha, min_mask),
        // One coefficient a channel is one group, and nothing to be told apart by: `Recipe::validate` refuses it.
        (MaskKind::None, _) | (MaskKind::PerCoefficientGroup, CarrierBasis::Constant) => vec![1.0; magnitudes.len()],
    };
    match basis {
        CarrierBasis::Constant => mask.into_iter().flat_map(|m| [m; 3]).collect(),
        CarrierBasis::Harmonics => mask,
    }
}

/// `(e_smallest / e)^alpha` of a coefficient's group, `e` the sum of the group's magnitudes, clipped below at `least`.
fn by_group(magnitudes: &[f32], alpha: f64, least: f64) -> Vec<f32> {
    let mut groups = [0.0f64; SH];
    for (i, v) in magnitudes.iter().enumerate() {
        groups[i % SH] += f64::from(*v);
    }
    let smallest = groups.iter().copied().fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE);
    let group = groups.map(|g| ((alpha * (smallest.ln() - g.max(smallest).ln())).exp().max(least)) as f32);
    (0..magnitudes.len()).map(|i| group[i % SH]).collect()
}

/// `(e_free / max(e, e_free))^alpha`, clipped below at `least`.
pub(crate) fn from_magnitudes(magnitudes: &[f32], alpha: f64, least: f64) -> Vec<f32> {
    let mut sorted: Vec<f32> = magnitudes.iter().copied().filter(|m| *m > 0.0).collect();
    if sorted.is_empty() {
        return vec![1.0; magnitudes.len()];
    }
    let at = ((sorted.len() - 1) as f64 * FREE) as usize;
    let (_, free, _) = sorted.select_nth_unstable_by(at, f32::total_cmp);
    // Both floored alike: nothing would move where a quarter of the magnitudes were less than a normal number.
    let log_of = |m: f32| f64::from(m.max(f32::MIN_POSITIVE)).ln();
    let log_free = log_of(*free);
    let mask = |m: &f32| {
        let log = log_of(*m);
        ((alpha * (log_free - log)).min(0.0).exp().max(least)) as f32
    };
    magnitudes.iter().map(mask).collect()
}

/// 0 for the `share` of the magnitudes above zero that are largest, else 1.
pub(crate) fn all_or_nothing(magnitudes: &[f32], share: f64) -> Vec<f32> {
    let mut sorted: Vec<f32> = magnitudes.iter().copied().filter(|m| *m > 0.0).collect();
    let free = sorted.len() - ((sorted.len() as f64 * share).round() as usize).min(sorted.len());
    if free == sorted.len() {
        return vec![1.0; magnitudes.len()];
    }
    let (_, first_locked, _) = sorted.select_nth_unstable_by(free, f32::total_cmp);
    let locked = *first_locked;
    magnitudes.iter().map(|m| if *m >= locked { 0.0 } else { 1.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_field::LinearView;
    use cairn_scene::Camera;

    /// Rows whose coefficients have these magnitudes, the same in all channels.
    struct Rows(Vec<[f32; SH]>);

    impl MarkableField for Rows {
        fn rows(&self) -> usize {
            self.0.len()
        }
        fn lattice(&self) -> Vec<[u32; 3]> {
            vec![[0; 3]; self.0.len()]
        }
        fn row_magnitudes(&self) -> Vec<f32> {
            self.0.iter().map(|row| row[0]).collect()
        }
        fn coefficient_magnitudes(&self) -> Vec<f32> {
            self.0.iter().flat_map(|row| [*row; 3]).flatten().collect()
        }
        fn densities(&self) -> Vec<f32> {
            vec![0.0; self.0.len()]
        }
        fn view(&self, _: &Camera, _: f32, _: usize) -> LinearView {
            unreachable!("a mask looks at no view")
        }
    }

    /// What nobody should meet: no colour, less than a normal number, as much as there can be.
    const ODD: [f32; SH] = [f32::MAX, 0.0, -0.0, 1e-45, 1e-42, f32::MIN_POSITIVE, 1e-3, 1.0, 1e30];

    #[test]
    fn the_group_mask_is_the_ratio_of_the_smallest_group_to_each() {
        // Sums over two rows and three channels: 6 x 1, 6 x 2 and 6 x 4, then 6 x 1: 1, 1/8, 1/64 at alpha 3, 1, 1/2, 1/4 at 1.
        let row = |scale: f32| [1.0, 2.0, 4.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0].map(|v: f32| v * scale);
        let field = Rows(vec![row(0.5), row(1.5)]);
        for (alpha, least, expected) in
            [(3.0, 0.0, [1.0, 0.125, 1.0 / 64.0]), (1.0, 0.0, [1.0, 0.5, 0.25]), (3.0, 0.1, [1.0, 0.125, 0.1])]
        {
            let mask = gradient_mask(MaskKind::PerCoefficientGroup, alpha, least, 0.5, &field, CarrierBasis::Harmonics);
            assert_eq!(mask.len(), 2 * 3 * SH);
            for of_channel in mask.chunks_exact(SH) {
                for (got, expected) in of_channel.iter().zip(expected.into_iter().chain([1.0; 6])) {
                    assert!((got - expected).abs() < 1e-6, "{got} for {expected} at {alpha}, {least}");
                }
            }
        }
    }

    #[test]
    fn odd_magnitudes_give_masks_in_range_in_every_kind_and_basis() {
        for rows in [[ODD, [1.0; SH]], [[0.0; SH]; 2], [[f32::MAX; SH], [1.0; SH]], [ODD, [0.0; SH]]] {
            let field = Rows(rows.to_vec());
            for basis in [CarrierBasis::Constant, CarrierBasis::Harmonics] {
                for (alpha, least) in [(0.0, 0.2), (3.0, 0.0), (3.0, 0.2), (10.0, 0.0)] {
                    for kind in [MaskKind::PerWeight, MaskKind::PerCoefficientGroup, MaskKind::Binary, MaskKind::None] {
                        let mask = gradient_mask(kind, alpha, least, 0.5, &field, basis);
                        assert_eq!(mask.len(), field.rows() * basis.width(), "{kind:?}, {basis:?}");
                        let lowest = if kind == MaskKind::Binary { 0.0 } else { least as f32 };
                        let odd = mask.iter().find(|m| !(lowest..=1.0).contains(*m));
                        assert!(odd.is_none(), "{kind:?}, {basis:?}, alpha {alpha}: {odd:?}");
                        assert!(mask.contains(&1.0), "{kind:?}, {basis:?}, alpha {alpha}: nothing moves freely");
                    }
                }
            }
        }
    }

    #[test]
    fn a_group_without_colour_moves_freely_and_holds_the_others_at_the_least() {
        let field = Rows(vec![ODD; 2]);
        let mask = gradient_mask(MaskKind::PerCoefficientGroup, 3.0, 0.2, 0.5, &field, CarrierBasis::Harmonics);
        // Smallest is nothing at all, taken as the smallest normal f64, 2^-1022: against it even 1e-45 is large.
        assert_eq!(mask[..SH], [0.2, 1.0, 1.0, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2]);
        let open = gradient_mask(MaskKind::PerCoefficientGroup, 0.0, 0.2, 0.5, &field, CarrierBasis::Harmonics);
        assert_eq!(open, [1.0; 2 * 3 * SH], "alpha 0 is no mask");
    }

    #[test]
    fn a_binary_mask_locks_giants_and_never_what_has_no_colour() {
        // Above zero are seven of nine: half of them, rounded up, is four.
        assert_eq!(all_or_nothing(&ODD, 0.5), [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(all_or_nothing(&ODD, 1.0), [0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(all_or_nothing(&ODD, 0.0), [1.0; SH]);
        // One number a vertex counts for its three channels.
        let rows = Rows(vec![[0.0; SH], [1e-42; SH], [f32::MAX; SH]]);
        let mask = gradient_mask(MaskKind::Binary, 3.0, 0.2, 0.5, &rows, CarrierBasis::Constant);
        assert_eq!(mask, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn zeros_denormals_and_giants_give_masks_in_range() {
        let magnitudes = [0.0, 1e-42, 1e-20, 1e-3, 1.0, 1e30, f32::MAX];
        for alpha in [0.0, 3.0, 10.0] {
            for m in from_magnitudes(&magnitudes, alpha, 0.1) {
                assert!((0.1..=1.0).contains(&m), "{m} at alpha {alpha}");
            }
        }
    }

    #[test]
    fn the_mask_is_the_ratio_to_the_power_of_alpha() {
        // The free quantile of these is 1: twice the magnitude moves an eighth.
        let mask = from_magnitudes(&[1.0, 1.0, 1.0, 2.0, 4.0], 3.0, 0.0);
        assert_eq!(mask[0], 1.0);
        assert!((mask[3] - 0.125).abs() < 1e-6);
        assert!((mask[4] - 1.0 / 64.0).abs() < 1e-6);
    }

    #[test]
    fn a_binary_mask_locks_its_share_of_the_largest() {
        let magnitudes = [0.0, 3.0, 1.0, 4.0, 2.0];
        assert_eq!(all_or_nothing(&magnitudes, 0.5), [1.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(all_or_nothing(&magnitudes, 0.0), [1.0; 5]);
        assert_eq!(all_or_nothing(&magnitudes, 1.0), [1.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(all_or_nothing(&[0.0; 3], 1.0), [1.0; 3]);
    }

    #[test]
    fn a_field_without_colour_is_not_masked() {
        assert_eq!(from_magnitudes(&[0.0; 4], 3.0, 0.1), [1.0; 4]);
    }
}
