//! The one table of image formats: names, endings, how a file begins, limits of decoding, and encoding.
//!
//! Another format is one variant, one row and one line of [`ImageFormat::encode`].

use std::io::{BufRead, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageEncoder, ImageError, ImageReader};
use serde::{Deserialize, Serialize};

use crate::error::CaptureError;
use crate::images::picture::Picture;
use crate::images::webp;

/// A format that photographs and masks are read in, and pictures are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// PNG, lossless.
    Png,
    /// JPEG, lossy.
    Jpeg,
    /// WebP: lossy and lossless ones are read, lossless ones written.
    WebP,
}

/// What is to be known of a format.
struct Row {
    name: &'static str,
    /// Of file names, lower case, without the dot; the usual one first.
    endings: &'static [&'static str],
    /// What stands at the beginning of every file of it, and from which byte on.
    magic: &'static [(usize, &'static [u8])],
    codec: image::ImageFormat,
    /// The most that may be unpacked before the pixels, bytes; a colour profile that takes more is left out.
    max_header_bytes: u64,
    /// Whether what is written of it has the picture's 8 bits again.
    is_lossless: bool,
    /// The longest side of what is written of it, px.
    max_side_px: usize,
}

/// Quality of a JPEG that is written, of 100, with colours in full size (4:4:4). Photographs come back at 41 to 50 dB in
/// a fifth to a half of a PNG's bytes. At 100 they are not the picture either: that is what lossless formats are for.
const JPEG_QUALITY: u8 = 95;

impl ImageFormat {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::WebP];

    fn row(self) -> Row {
        match self {
            Self::Png => Row {
                name: "PNG",
                endings: &["png"],
                magic: &[(0, b"\x89PNG\r\n\x1a\n")],
                codec: image::ImageFormat::Png,
                max_header_bytes: 16 << 20,
                is_lossless: true,
                max_side_px: i32::MAX as usize,
            },
            Self::Jpeg => Row {
                name: "JPEG",
                endings: &["jpg", "jpeg"],
                magic: &[(0, b"\xff\xd8\xff")],
                codec: image::ImageFormat::Jpeg,
                max_header_bytes: 16 << 20,
                is_lossless: false,
                max_side_px: 65_535,
            },
            Self::WebP => Row {
                name: "WebP",
                endings: &["webp"],
                magic: &[(0, b"RIFF"), (8, b"WEBP")],
                codec: image::ImageFormat::WebP,
                max_header_bytes: 16 << 20,
                is_lossless: true,
                max_side_px: 16_383,
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

    /// Whether what is written of it has the picture's 8 bits again.
    pub fn is_lossless(self) -> bool {
        self.row().is_lossless
    }

    /// The longest side of what is written of it, px.
    pub fn max_side_px(self) -> usize {
        self.row().max_side_px
    }

    /// The names of all formats, for messages: `PNG, JPEG or WebP`.
    pub fn names() -> String {
        listed(Self::ALL.map(|format| format.name().to_owned()).into())
    }

    /// The endings of all formats, for messages: `.png, .jpg, .jpeg or .webp`.
    pub fn all_endings() -> String {
        listed(Self::ALL.iter().flat_map(|format| format.endings()).map(|ending| format!(".{ending}")).collect())
    }

    /// The format that `bytes` begin as.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let has = |(at, part): &(usize, &[u8])| bytes.get(*at..).is_some_and(|rest| rest.starts_with(part));
        Self::ALL.into_iter().find(|format| format.row().magic.iter().all(has))
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
    /// When a side is longer than [`ImageFormat::max_side_px`].
    pub fn encode(self, picture: &Picture) -> Vec<u8> {
        let mut bytes = Vec::new();
        let side = |side: usize| u32::try_from(side).expect("a side below 2^32 pixels");
        let (rgb, width, height) = (picture.to_rgb8(), side(picture.width()), side(picture.height()));
        let kind = image::ExtendedColorType::Rgb8;
        let written = match self {
            Self::Png => image::codecs::png::PngEncoder::new(&mut bytes).write_image(&rgb, width, height, kind),
            Self::Jpeg => image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
                .write_image(&rgb, width, height, kind),
            Self::WebP => {
                image::codecs::webp::WebPEncoder::new_lossless(&mut bytes).write_image(&rgb, width, height, kind)
            }
        };
        written.expect("writing to memory does not fail, and the buffer fits the size");
        bytes
    }
}

/// `a, b or c`.
fn listed(mut names: Vec<String>) -> String {
    let last = names.pop().unwrap_or_default();
    format!("{} or {last}", names.join(", "))
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
fn refused(name: &str, error: &ImageError) -> CaptureError {
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
    let format = ImageFormat::of(begin).ok_or_else(|| broken("it begins as none of them does".to_owned()))?;
    if format == ImageFormat::WebP {
        webp::check(&mut reader, format.row().max_header_bytes).map_err(broken)?;
    }
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

/// The pixels of what errors call `name`.
///
/// A decoder that stops on what it did not expect refuses the file, too: that of WebP does, on codes that are none.
pub(crate) fn decode_pixels(decoder: impl ImageDecoder, name: &str) -> Result<DynamicImage, CaptureError> {
    match catch_unwind(AssertUnwindSafe(|| DynamicImage::from_decoder(decoder))) {
        Ok(decoded) => decoded.map_err(|e| refused(name, &e)),
        Err(_) => {
            let reason = "its pixels are not written as the format has them".to_owned();
            Err(CaptureError::NotAPicture { photograph: name.to_owned(), reason })
        }
    }
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
        for other in [&b"GIF89a"[..], b"RIFF\x04\0\0\0WAVE", b"RIFF", b""] {
            assert_eq!(ImageFormat::of(other), None);
        }
        assert_eq!(ImageFormat::of_path(Path::new("png")), None);
    }

    #[test]
    fn what_is_written_without_loss_has_its_pixels_again() {
        let rgb = (0..7 * 5 * 3).map(|v| (v * 37 % 256) as f32 / 255.0).collect();
        let picture = Picture::new(7, 5, rgb).unwrap();
        for format in ImageFormat::ALL {
            let bytes = format.encode(&picture);
            let decoder = open_decoder(std::io::Cursor::new(&bytes), &Limits::default(), "a").unwrap();
            let back = decode_pixels(decoder, "a").unwrap().into_rgb8().into_raw();
            assert_eq!(back == picture.to_rgb8(), format.is_lossless(), "{}", format.name());
        }
    }

    #[test]
    fn messages_name_every_format() {
        assert_eq!(ImageFormat::names(), "PNG, JPEG or WebP");
        assert_eq!(ImageFormat::all_endings(), ".png, .jpg, .jpeg or .webp");
        let Err(error) = open_decoder(std::io::Cursor::new(b"GIF89a"), &Limits::default(), "a") else {
            panic!("a GIF is none of them")
        };
        assert!(error.to_string().contains(&format!("decoded as {}", ImageFormat::names())), "{error}");
    }
}
