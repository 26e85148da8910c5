//! What a carrier's numbers are: colours alone, or colours and density. And what weighs
//! the updates of each.

use crate::stega::mask::{all_or_nothing, from_magnitudes, gradient_mask};
use crate::stega::recipe::{CarrierKind, DensityKind, MaskKind, Recipe};
use cairn_field::CHANGE;
use cairn_field::{CarrierBasis, MarkableField};

/// What a carrier's numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CarrierShape {
    /// Colour coefficients: a view is a fixed linear map of them.
    Colours(CarrierBasis),
    /// The field's own harmonics and the raw density ([`CHANGE`]): views are marched anew.
    Free,
}

impl CarrierShape {
    /// That of the settings; a free density with carriers of the clusters' own is refused
    /// by [`Recipe::validate`].
    pub(crate) fn of(carrier: CarrierKind, density: DensityKind) -> Self {
        match (carrier, density) {
            (_, DensityKind::Free) => Self::Free,
            (CarrierKind::PerCluster, DensityKind::Frozen) => Self::Colours(CarrierBasis::Constant),
            (CarrierKind::Harmonics, DensityKind::Frozen) => Self::Colours(CarrierBasis::Harmonics),
        }
    }

    /// Numbers a row: 3, 27 or 28.
    pub(crate) fn width(self) -> usize {
        match self {
            Self::Colours(basis) => basis.width(),
            Self::Free => CHANGE,
        }
    }

    /// Of them, colour coefficients, channel-major; they come first.
    pub(crate) fn colours(self) -> usize {
        match self {
            Self::Colours(basis) => basis.width(),
            Self::Free => CarrierBasis::Harmonics.width(),
        }
    }
}

/// What weighs the updates of a carrier of `shape`, `rows x width`. Densities have a mask
/// of their own, by the density where colours have it by the colour's magnitude, in
/// `[min_mask, 1]` times the ratio of the two learning rates.
pub(crate) fn carrier_mask(config: &Recipe, field: &dyn MarkableField, shape: CarrierShape) -> Vec<f32> {
    let basis = match shape {
        CarrierShape::Colours(basis) => basis,
        CarrierShape::Free => CarrierBasis::Harmonics,
    };
    let colours = gradient_mask(config.mask, config.mask_alpha, config.min_mask, config.mask_share, field, basis);
    if shape != CarrierShape::Free {
        return colours;
    }
    let densities = match config.mask {
        // The densities are one group: nothing to be told apart by.
        MaskKind::None | MaskKind::PerCoefficientGroup => vec![1.0; field.rows()],
        MaskKind::PerWeight => from_magnitudes(&field.densities(), config.mask_alpha, config.min_mask),
        MaskKind::Binary => all_or_nothing(&field.densities(), config.mask_share),
    };
    let ratio = (config.learning_rate_density / config.learning_rate_carrier) as f32;
    let mut mask = Vec::with_capacity(field.rows() * CHANGE);
    for (colours, density) in colours.chunks_exact(CHANGE - 1).zip(densities) {
        mask.extend_from_slice(colours);
        mask.push(density * ratio);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_field::LinearView;
    use cairn_scene::Camera;

    /// Two vertices of like colours, one twice as dense as the other.
    struct Two;

    impl MarkableField for Two {
        fn rows(&self) -> usize {
            3
        }
        fn lattice(&self) -> Vec<[u32; 3]> {
            vec![[0; 3]; 3]
        }
        fn row_magnitudes(&self) -> Vec<f32> {
            vec![1.0; 3]
        }
        fn coefficient_magnitudes(&self) -> Vec<f32> {
            vec![1.0; 3 * 27]
        }
        fn densities(&self) -> Vec<f32> {
            vec![0.0, 1.0, 2.0]
        }
        fn view(&self, _: &Camera, _: f32, _: usize) -> LinearView {
            unreachable!("a mask looks at no view")
        }
    }

    #[test]
    fn densities_have_their_own_mask_and_rate() {
        let shape = CarrierShape::of(CarrierKind::Harmonics, DensityKind::Free);
        assert_eq!((shape.width(), shape.colours()), (28, 27));
        for (mask, densities) in [
            // Twice the density moves an eighth (alpha 3); the rate is twice that of colours.
            (MaskKind::PerWeight, [2.0, 2.0, 0.25]),
            (MaskKind::Binary, [2.0, 2.0, 0.0]),
            (MaskKind::PerCoefficientGroup, [2.0; 3]),
            (MaskKind::None, [2.0; 3]),
        ] {
            let rates = Recipe { learning_rate_density: 1e-3, learning_rate_carrier: 5e-4, ..Recipe::default() };
            let config = Recipe { mask, min_mask: 0.0, ..rates };
            let all = carrier_mask(&config, &Two, shape);
            assert_eq!(all.len(), 3 * 28, "{mask:?}");
            for (row, density) in all.chunks_exact(28).zip(densities) {
                assert!((row[27] - density).abs() < 1e-6, "{mask:?}: {} for {density}", row[27]);
            }
            let colours = carrier_mask(&config, &Two, CarrierShape::Colours(CarrierBasis::Harmonics));
            for (free, alone) in all.chunks_exact(28).zip(colours.chunks_exact(27)) {
                assert_eq!(&free[..27], alone, "{mask:?}: colours are masked as without densities");
            }
        }
    }
}
