//! Masks: which pixels of a photograph are to be used. What a mask leaves out (passers-by, a caption,
//! a visible watermark) teaches nothing.

use crate::images::picture::PictureError;

/// Which pixels of a photograph are to be used, one bit a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: usize,
    height: usize,
    /// Row-major without padding; pixel `i` is bit `i % 64` of word `i / 64`. Bits beyond the last pixel are 0.
    bits: Vec<u64>,
}

/// The darkest grey level, of 255, that means use.
const MIN_USED_LEVEL: u8 = 128;

impl Mask {
    /// The mask that uses the pixels for which `uses(x, y)` holds; columns and rows count from 0 at the top left.
    ///
    /// # Errors
    /// [`PictureError::Empty`] when a side is zero.
    pub fn from_fn(width: usize, height: usize, uses: impl Fn(usize, usize) -> bool) -> Result<Self, PictureError> {
        if width == 0 || height == 0 {
            return Err(PictureError::Empty { width, height });
        }
        let mut bits = vec![0u64; (width * height).div_ceil(64)];
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                bits[at / 64] |= u64::from(uses(x, y)) << (at % 64);
            }
        }
        Ok(Self { width, height, bits })
    }

    /// From 8-bit grey, `height x width` bytes, row-major: a pixel is used from level 128 on.
    ///
    /// # Errors
    /// [`PictureError`] when a side is zero or the length is not `width * height`.
    pub fn from_grey8(width: usize, height: usize, grey: &[u8]) -> Result<Self, PictureError> {
        let expected = width * height;
        if grey.len() != expected {
            return Err(PictureError::Length { width, height, expected, got: grey.len() });
        }
        Self::from_fn(width, height, |x, y| grey[y * width + x] >= MIN_USED_LEVEL)
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether the pixel in column `x` and row `y`, both from 0, is used.
    ///
    /// # Panics
    /// When the pixel lies outside.
    pub fn uses(&self, x: usize, y: usize) -> bool {
        assert!(x < self.width && y < self.height, "pixel {x}, {y} of {} x {}", self.width, self.height);
        let at = y * self.width + x;
        self.bits[at / 64] >> (at % 64) & 1 == 1
    }

    /// How many pixels are used.
    pub fn used_pixels(&self) -> usize {
        self.bits.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// A grey PNG of 1 bit, white where a pixel is used. The same mask gives the same bytes.
    pub fn to_png(&self) -> Vec<u8> {
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::One);
        let row_bytes = self.width.div_ceil(8);
        let mut bytes = vec![0u8; row_bytes * self.height];
        for (y, row) in bytes.chunks_exact_mut(row_bytes).enumerate() {
            // The leftmost pixel is a byte's highest bit.
            (0..self.width).filter(|&x| self.uses(x, y)).for_each(|x| row[x / 8] |= 0x80 >> (x % 8));
        }
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&bytes));
        written.expect("writing to memory, of the mask's own size, cannot fail");
        png
    }

    /// The mask of the photograph at `width x height`. A new pixel is used where **all** pixels that it covers, in
    /// whole or in part, are used: the colour of any other is mixed with what the mask leaves out.
    ///
    /// # Panics
    /// When a new side is zero.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "cannot resize to no pixels");
        // The same pixels as those that the area filter of pictures takes the mean of.
        let covered = |i: usize, from: usize, to: usize| {
            let scale = from as f64 / to as f64;
            let (start, end) = (i as f64 * scale, (i + 1) as f64 * scale);
            start as usize..(end.ceil() as usize).min(from)
        };
        let uses = |x: usize, y: usize| {
            let columns = covered(x, self.width, width);
            covered(y, self.height, height).all(|row| columns.clone().all(|column| self.uses(column, row)))
        };
        Self::from_fn(width, height, uses).expect("both sides have pixels")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_levels_from_128_on_are_used() {
        let mask = Mask::from_grey8(3, 2, &[0, 127, 128, 255, 1, 200]).unwrap();
        let used: Vec<bool> = (0..6).map(|i| mask.uses(i % 3, i / 3)).collect();
        assert_eq!(used, [false, false, true, true, false, true]);
        assert_eq!((mask.width(), mask.height(), mask.used_pixels()), (3, 2, 3));
        assert_eq!(
            Mask::from_grey8(3, 2, &[0; 5]),
            Err(PictureError::Length { width: 3, height: 2, expected: 6, got: 5 })
        );
        assert_eq!(Mask::from_grey8(0, 2, &[]), Err(PictureError::Empty { width: 0, height: 2 }));
    }

    #[test]
    fn a_smaller_pixel_is_used_where_all_that_it_covers_is() {
        // Column 4 of 0..10 is left out.
        let mask = Mask::from_fn(10, 3, |x, _| x != 4).unwrap();
        let half = mask.resized(5, 3);
        assert_eq!((0..5).map(|x| half.uses(x, 1)).collect::<Vec<_>>(), [true, true, false, true, true]);
        // Four columns of 2.5 pixels each: only the second reaches into column 4.
        let odd = mask.resized(4, 2);
        assert_eq!((0..4).map(|x| odd.uses(x, 0)).collect::<Vec<_>>(), [true, false, true, true]);
        assert_eq!(mask.resized(10, 3), mask);
        assert_eq!(mask.resized(20, 3).used_pixels(), 18 * 3);
    }
}
