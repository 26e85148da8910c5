//! The one table of image formats: names, endings, how a file begins, limits of decoding, and encoding.
//!
//! Another format is one variant and one row.

use std::io::{BufRead, Seek};
use std::path::Path;

use image::{ImageDecoder, ImageEncoder, ImageError, ImageReader};
use serde::{Deserialize, Serialize};

use crate::error::CaptureError;
use crate::images::picture::Picture;

/// A format that photographs and masks are read in, and pictures are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// PNG, lossless.
    Png,
    /// JPEG, lossy.
    Jpeg,
}

/// What is to be known of a format.
struct Row {
    name: &'static str,
    /// Of file names, lower case, without the dot; the usual one first.
    endings: &'static [&'static str],
    /// How every file of it begins.
    magic: &'static [u8],
    codec: image::ImageFormat,
    /// The most that may be unpacked before the pixels, bytes; a colour profile that takes more is left out.
    max_header_bytes: u64,
}

/// Quality of a JPEG that is written, of 100.
const JPEG_QUALITY: u8 = 95;

impl ImageFormat {
    /// All formats.
    pub const ALL: [Self; 2] = [Self::Png, Self::Jpeg];

    fn row(self) -> Row {
        match self {
            Self::Png => Row {
                name: "PNG",
                endings: &["png"],
                magic: b"\x89PNG\r\n\x1a\n",
                codec: image::ImageFormat::Png,
                max_header_bytes: 16 << 20,
            },
            Self::Jpeg => Row {
                name: "JPEG",
                endings: &["jpg", "jpeg"],
                magic: b"\xff\xd8\xff",
                codec: image::ImageFormat::Jpeg,
                max_header_bytes: 16 << 20,
            },
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Endings of its files, lower case, without the dot; the usual one first.
    pub fn endings(self) -> &'static [&'static str] {
        self.row().endings
    }

    /// The format that `bytes` begin as.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| bytes.starts_with(format.row().magic))
    }

    /// The format that the ending of `path` says, in any case.
    pub fn of_path(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        Self::ALL.into_iter().find(|format| format.endings().contains(&ending.as_str()))
    }

    /// `picture` as 8-bit RGB, values clamped to [0, 1] and rounded to nearest; a JPEG at quality 95.
    ///
    /// The same picture gives the same bytes. A number that is not finite has no 8-bit value:
    /// [`save_png`](crate::save_png) refuses it, here it is the caller's to have refused.
    ///
    /// # Panics
    /// When a side is longer than the format allows: 2^32 - 1 pixels, 65,535 for JPEG.
    pub fn encode(self, picture: &Picture) -> Vec<u8> {
        let mut bytes = Vec::new();
        let side = |side: usize| u32::try_from(side).expect("a side below 2^32 pixels");
        let (rgb, width, height) = (picture.to_rgb8(), side(picture.width()), side(picture.height()));
        let kind = image::ExtendedColorType::Rgb8;
        let written = match self {
            Self::Png => image::codecs::png::PngEncoder::new(&mut bytes).write_image(&rgb, width, height, kind),
            Self::Jpeg => image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
                .write_image(&rgb, width, height, kind),
        };
        written.expect("writing to memory does not fail, and the buffer fits the size");
        bytes
    }
}

/// The names of all formats, for messages.
fn names() -> String {
    ImageFormat::ALL.map(ImageFormat::name).join(", ")
}

/// The most that is accepted from people; everything is checked before memory
/// is taken for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest photograph, table or JSON file, bytes.
    pub max_file_bytes: u64,
    /// Longest side of a photograph, px.
    pub max_side_px: usize,
    /// Most pixels in a photograph.
    pub max_pixels: u64,
    /// Most views in a capture.
    pub max_views: usize,
}

impl Default for Limits {
    /// 64 MiB, 16384 px, 100 million pixels, 100 000 views.
    fn default() -> Self {
        Self { max_file_bytes: 64 << 20, max_side_px: 16_384, max_pixels: 100_000_000, max_views: 100_000 }
    }
}

/// Refuses `got` over `limit`, naming the file.
pub(crate) fn check(what: &'static str, file: &str, got: u64, limit: u64) -> Result<(), CaptureError> {
    if got > limit {
        return Err(CaptureError::TooLarge { file: file.to_owned(), what, limit, got });
    }
    Ok(())
}

/// What the decoder said of the file `name`.
pub(crate) fn refused(name: &str, error: &ImageError) -> CaptureError {
    CaptureError::NotAPicture { photograph: name.to_owned(), reason: error.to_string() }
}

/// A decoder of what errors call `name`, its header read and held to `limits`.
pub(crate) fn open_decoder<'a, R: BufRead + Seek + 'a>(
    mut reader: R,
    limits: &Limits,
    name: &str,
) -> Result<impl ImageDecoder + 'a, CaptureError> {
    let broken = |reason: String| CaptureError::NotAPicture { photograph: name.to_owned(), reason };
    let begin = reader.fill_buf().map_err(|e| broken(e.to_string()))?;
    let format = ImageFormat::of(begin).ok_or_else(|| broken(format!("it begins as none of {} does", names())))?;
    let mut reader = ImageReader::with_format(reader, format.row().codec);
    // Before the first byte: a PNG's compressed colour profile is unpacked along with the header.
    let mut of_header = image::Limits::no_limits();
    of_header.max_alloc = Some(format.row().max_header_bytes);
    reader.limits(of_header);
    let mut decoder = reader.into_decoder().map_err(|e| refused(name, &e))?;
    let (w, h) = decoder.dimensions();
    check("longest side in pixels", name, u64::from(w.max(h)), limits.max_side_px as u64)?;
    check("number of pixels", name, u64::from(w) * u64::from(h), limits.max_pixels)?;
    let mut allowed = image::Limits::no_limits();
    allowed.max_image_width = Some(w);
    allowed.max_image_height = Some(h);
    // Four 16-bit channels, once in the decoder and once in its result.
    allowed.max_alloc = Some(limits.max_pixels.saturating_mul(16).saturating_add(64 << 20));
    decoder.set_limits(allowed).map_err(|e| refused(name, &e))?;
    Ok(decoder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_format_is_known_by_what_it_wrote_and_by_its_endings() {
        let picture = Picture::constant(3, 2, [0.2, 0.4, 0.6]);
        for format in ImageFormat::ALL {
            let bytes = format.encode(&picture);
            assert_eq!(ImageFormat::of(&bytes), Some(format));
            assert!(open_decoder(std::io::Cursor::new(&bytes), &Limits::default(), "a").is_ok());
            for ending in format.endings() {
                assert_eq!(ImageFormat::of_path(Path::new(&format!("a.b.{}", ending.to_uppercase()))), Some(format));
            }
        }
        assert_eq!(ImageFormat::of(b"GIF89a"), None);
        assert_eq!(ImageFormat::of_path(Path::new("png")), None);
    }
}
