//! What the coefficients of a change of colours stand for.

use crate::appearance::code::Appearance;
use crate::grid::sh::SH;

/// What a carrier's coefficients multiply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CarrierBasis {
    /// One coefficient a channel, the same from everywhere and in every light.
    Constant,
    /// Nine a channel: spherical harmonics as the field's own, seen in the light that those are seen in.
    Harmonics,
}

impl CarrierBasis {
    /// Coefficients a row: 3 or 27 (channel-major).
    pub fn width(self) -> usize {
        match self {
            Self::Constant => 3,
            Self::Harmonics => 3 * SH,
        }
    }

    /// What light makes of a carrier's colours, a row for each channel that comes out, near and far, where the field is
    /// seen with `appearance`. Nothing of constant ones: an appearance fitted to a dusky photograph made marks six to
    /// eight decibels stronger and turned their hue, which is what tells owners apart.
    pub(super) fn tints(self, appearance: &Appearance) -> Tints {
        match self {
            Self::Constant => [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]; 2],
            Self::Harmonics => lit(appearance),
        }
    }
}

/// What becomes of a change of colours, near and far: a row for each channel that comes out.
pub(super) type Tints = [[[f32; 3]; 3]; 2];

/// What a light makes of a change of the field's own colours.
pub(super) fn lit(appearance: &Appearance) -> Tints {
    [appearance.near_matrix(), appearance.far_matrix()]
}
