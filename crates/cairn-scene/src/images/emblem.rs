//! Pictures that people bring to be hidden: logos and emblems, many of them drawn for a ground that the file leaves
//! to whoever shows it. A white logo on a transparent ground is nothing but white where photographs are composited.

use crate::error::CaptureError;
use crate::images::format::{ImageFormat, Limits};
use crate::images::photograph::decode_picture;
use crate::images::picture::Picture;

/// A picture with less than this share of its contrast on white than on black is put on black.
const LOST_ON_WHITE: f64 = 0.25;

/// What stands behind an emblem's transparent pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ground {
    /// Nothing: no pixel is transparent.
    None,
    /// White, as behind photographs.
    White,
    /// Black, since white would leave too little to see.
    Black,
}

/// Decodes a picture of any [`ImageFormat`] to be hidden, brought to `side` x `side` px (means of areas; other
/// proportions are stretched) and to the 8 bits that it is kept in. What is transparent becomes white, or black where
/// white leaves less than a quarter of the contrast ([`Picture::spread`]) that black does; which it was is returned.
///
/// # Errors
/// As [`decode_picture`].
///
/// # Panics
/// When `side` is 0.
pub fn decode_emblem(bytes: &[u8], limits: &Limits, side: usize) -> Result<(Picture, Ground), CaptureError> {
    let on = |ground: [f32; 3]| {
        let picture = decode_picture(bytes, limits, Some(ground))?.resized(side, side);
        Ok::<_, CaptureError>(picture.in_8_bits())
    };
    // One after another: in full size each takes four times the memory of its 8 bits.
    let white = on([1.0; 3])?;
    // A JPEG has no transparency.
    if ImageFormat::of(bytes) == Some(ImageFormat::Jpeg) {
        return Ok((white, Ground::None));
    }
    let black = on([0.0; 3])?;
    if white == black {
        return Ok((white, Ground::None));
    }
    let is_lost = white.spread() < LOST_ON_WHITE * black.spread();
    Ok(if is_lost { (black, Ground::Black) } else { (white, Ground::White) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A PNG of `side` x `side` px with these RGBA pixels.
    fn png(side: u32, pixel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::RgbaImage::from_fn(side, side, |x, y| image::Rgba(pixel(x, y)))
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    fn decoded(bytes: &[u8]) -> (Picture, Ground) {
        decode_emblem(bytes, &Limits::default(), 8).unwrap()
    }

    #[test]
    fn what_white_would_swallow_is_put_on_black() {
        let bar = |colour: [u8; 3]| png(16, move |x, _| [colour[0], colour[1], colour[2], if x < 8 { 255 } else { 0 }]);
        let (white, ground) = decoded(&bar([255; 3]));
        assert_eq!(ground, Ground::Black);
        assert_eq!((white.pixel(0, 3), white.pixel(7, 3)), ([1.0; 3], [0.0; 3]));
        // Nearly white is as lost.
        assert_eq!(decoded(&bar([240, 240, 235])).1, Ground::Black);
        let (dark, ground) = decoded(&bar([0, 0, 0]));
        assert_eq!((ground, dark.pixel(0, 3), dark.pixel(7, 3)), (Ground::White, [0.0; 3], [1.0; 3]));
        assert_eq!(decoded(&bar([255, 200, 0])).1, Ground::White, "yellow shows on either");
    }

    #[test]
    fn what_is_opaque_has_no_ground() {
        let (page, ground) = decoded(&png(16, |x, _| if x < 2 { [0, 0, 0, 255] } else { [255; 4] }));
        assert_eq!((ground, page.pixel(0, 0), page.pixel(7, 7)), (Ground::None, [0.0; 3], [1.0; 3]));
        // A page with round corners stays a page.
        let corner = |x: u32, y: u32| x + y < 3;
        let page = png(16, |x, y| match (corner(x, y), x < 8) {
            (true, _) => [255, 255, 255, 0],
            (false, true) => [0, 0, 0, 255],
            (false, false) => [255; 4],
        });
        assert_eq!(decoded(&page).1, Ground::White);
        assert!(decode_emblem(b"GIF89a", &Limits::default(), 8).is_err());
    }
}
