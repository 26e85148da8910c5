//! Photographs and renders in memory: one plain type, so that every later stage
//! shares a layout and none of them needs to know an image file format; and another for keeping many of them.

use crate::images::resize::AreaFilter;
use thiserror::Error;

/// An RGB image, `height x width x 3`, row-major, interleaved, display-referred
/// (sRGB-encoded) values with 0 black and 1 white. Renders may leave [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<f32>,
}

/// Why an array is not a picture.
#[derive(Debug, Error, PartialEq)]
pub enum PictureError {
    /// The array's length does not fit the size.
    #[error("a {width} x {height} picture has {expected} numbers, got {got}")]
    Length {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// `width * height * 3`.
        expected: usize,
        /// Numbers given.
        got: usize,
    },
    /// A side is zero.
    #[error("a picture of {width} x {height} pixels has none; give both sides at least one pixel")]
    Empty {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
}

impl Picture {
    /// Wraps `rgb`, `height * width * 3` numbers, row-major and interleaved.
    ///
    /// # Errors
    /// [`PictureError`] when a side is zero or the length does not fit.
    pub fn new(width: usize, height: usize, rgb: Vec<f32>) -> Result<Self, PictureError> {
        if width == 0 || height == 0 {
            return Err(PictureError::Empty { width, height });
        }
        let expected = width * height * 3;
        if rgb.len() != expected {
            return Err(PictureError::Length { width, height, expected, got: rgb.len() });
        }
        Ok(Self { width, height, rgb })
    }

    /// A picture of one colour (`rgb` in [0, 1]).
    ///
    /// # Panics
    /// When a side is zero.
    pub fn constant(width: usize, height: usize, rgb: [f32; 3]) -> Self {
        assert!(width > 0 && height > 0, "a constant picture needs at least one pixel");
        let rgb = rgb.iter().copied().cycle().take(width * height * 3).collect();
        Self { width, height, rgb }
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The numbers, `height x width x 3`.
    pub fn rgb(&self) -> &[f32] {
        &self.rgb
    }

    /// The numbers, `height x width x 3`, to change in place.
    pub fn rgb_mut(&mut self) -> &mut [f32] {
        &mut self.rgb
    }

    /// The numbers, `height x width x 3`, taking the picture apart.
    pub fn into_rgb(self) -> Vec<f32> {
        self.rgb
    }

    /// The pixel in column `x` and row `y`, both from 0.
    ///
    /// # Panics
    /// When the pixel lies outside.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        assert!(x < self.width, "column {x} of {}", self.width);
        let at = (y * self.width + x) * 3;
        [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
    }

    /// The same picture with every number brought into [0, 1]. NaN stays NaN.
    #[must_use]
    pub fn clamped(mut self) -> Self {
        for v in &mut self.rgb {
            *v = v.clamp(0.0, 1.0);
        }
        self
    }

    /// 8-bit RGB, `height x width x 3` bytes, rounded to nearest and clamped.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.rgb.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
    }

    /// From 8-bit RGB, `height x width x 3` bytes.
    ///
    /// # Errors
    /// As [`Picture::new`].
    pub fn from_rgb8(width: usize, height: usize, rgb: &[u8]) -> Result<Self, PictureError> {
        Self::new(width, height, rgb.iter().map(|&b| f32::from(b) / 255.0).collect())
    }

    /// The picture as it is once it was kept in 8 bits: numbers in [0, 1] on 256 levels.
    #[must_use]
    pub fn in_8_bits(mut self) -> Self {
        for v in &mut self.rgb {
            *v = (v.clamp(0.0, 1.0) * 255.0).round() / 255.0;
        }
        self
    }

    /// How far pixels are from the picture's mean colour: root mean square over pixels and channels,
    /// 0 where all are alike.
    pub fn spread(&self) -> f64 {
        let count = (self.width * self.height) as f64;
        let mut mean = [0.0f64; 3];
        for pixel in self.rgb.as_chunks::<3>().0 {
            (0..3).for_each(|c| mean[c] += f64::from(pixel[c]) / count);
        }
        let squares: f64 = (self.rgb.as_chunks::<3>().0.iter())
            .map(|pixel| (0..3).map(|c| (f64::from(pixel[c]) - mean[c]).powi(2)).sum::<f64>())
            .sum();
        (squares / (3.0 * count)).sqrt()
    }

    /// This picture at `width x height`, each new pixel the mean of the area it
    /// covers (exact box filter; bilinear in the limit of enlarging by area).
    ///
    /// # Panics
    /// When a new side is zero.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "cannot resize to no pixels");
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let rgb = AreaFilter::new([self.width, self.height], [width, height]).apply(&self.rgb);
        Self { width, height, rgb }
    }
}

/// An RGB image in 8 bits, as its file had it: a quarter of a [`Picture`]'s memory, for holding many photographs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture8 {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture8 {
    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The numbers, `height x width x 3`.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The same picture in [0, 1].
    pub fn to_picture(&self) -> Picture {
        let rgb = self.rgb.iter().map(|&b| f32::from(b) / 255.0).collect();
        Picture { width: self.width, height: self.height, rgb }
    }
}

/// Rounded as by [`Picture::to_rgb8`].
impl From<&Picture> for Picture8 {
    fn from(picture: &Picture) -> Self {
        Self { width: picture.width, height: picture.height, rgb: picture.to_rgb8() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bits_come_back_as_they_were() {
        let bytes: Vec<u8> = (0..=255).chain(0..=43).collect();
        let picture = Picture::from_rgb8(20, 5, &bytes).unwrap();
        let kept = Picture8::from(&picture);
        assert_eq!((kept.width(), kept.height(), kept.rgb()), (20, 5, &bytes[..]));
        assert_eq!(kept.to_picture(), picture);
        let outside = Picture::new(1, 1, vec![-1.0, 0.5019, 2.0]).unwrap();
        assert_eq!(Picture8::from(&outside).rgb(), [0, 128, 255]);
    }

    #[test]
    fn wrong_length_is_named() {
        let error = Picture::new(2, 2, vec![0.0; 11]).unwrap_err();
        assert_eq!(error.to_string(), "a 2 x 2 picture has 12 numbers, got 11");
    }

    #[test]
    fn halving_averages_two_by_two() {
        let rgb = (0..4).flat_map(|v| [v as f32; 3]).collect();
        let small = Picture::new(2, 2, rgb).unwrap().resized(1, 1);
        assert_eq!(small.pixel(0, 0), [1.5; 3]);
    }

    #[test]
    fn resizing_by_an_odd_ratio_keeps_the_mean() {
        let rgb: Vec<f32> = (0..7 * 5 * 3).map(|v| (v % 11) as f32 / 11.0).collect();
        let mean = |p: &Picture| p.rgb().iter().sum::<f32>() / p.rgb().len() as f32;
        let large = Picture::new(7, 5, rgb).unwrap();
        assert!((mean(&large) - mean(&large.resized(3, 2))).abs() < 1e-6);
        assert!((mean(&large) - mean(&large.resized(14, 10))).abs() < 1e-6);
    }

    #[test]
    fn eight_bits_round_trip() {
        let bytes: Vec<u8> = (0..=251).collect();
        assert_eq!(Picture::from_rgb8(12, 7, &bytes).unwrap().to_rgb8(), bytes);
    }
}
