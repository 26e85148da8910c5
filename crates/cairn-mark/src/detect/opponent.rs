//! Pictures in opponent colours.

use cairn_scene::Picture;

use crate::weave::woven::OPPONENT;

/// Lightness, red-green and yellow-blue of each pixel, row-major, three numbers a pixel.
#[derive(Clone, Debug)]
pub(super) struct Planes {
    /// Width and height, px.
    pub(super) size: [usize; 2],
    pub(super) values: Vec<f32>,
}

impl Planes {
    /// Of a picture.
    pub(super) fn of(picture: &Picture) -> Self {
        Self { size: size_of(picture), values: picture.rgb().chunks_exact(3).flat_map(opponent).collect() }
    }

    /// This picture less another of its size.
    pub(super) fn less(mut self, other: &Self) -> Self {
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a -= b);
        self
    }
}

/// Lightness, red-green and yellow-blue, orthonormal.
pub(super) fn opponent(rgb: &[f32]) -> [f32; 3] {
    OPPONENT.map(|row| row.iter().zip(rgb).map(|(a, b)| a * b).sum())
}

/// Width and height, px.
pub(super) fn size_of(picture: &Picture) -> [usize; 2] {
    [picture.width(), picture.height()]
}
