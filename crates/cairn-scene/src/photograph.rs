//! Photographs in and out: PNG and JPEG, decoded under limits that are checked
//! on the header before a pixel is allocated, and PNG written in one step.
//!
//! EXIF orientation is honoured. Values stay display-referred (sRGB-encoded);
//! alpha is composited in those values, as browsers and the published
//! NeRF-Synthetic figures do.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek, Write};
use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageEncoder, ImageError, ImageReader};
use serde::{Deserialize, Serialize};

use crate::error::CaptureError;
use crate::picture::Picture;

/// What a transparent pixel is composited on where nothing else is said.
pub(crate) const WHITE: [f32; 3] = [1.0; 3];

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

/// The most that a PNG's chunks before its pixels may take, bytes; a colour profile that unpacks to more is left out.
const MAX_HEADER_BYTES: u64 = 16 << 20;

/// What a photograph's header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// Width and height with EXIF orientation applied, px.
    pub oriented: (usize, usize),
    /// Width and height as stored, px.
    pub stored: (usize, usize),
    /// Whether EXIF orientation turns or mirrors the stored pixels.
    pub turned: bool,
    /// Whether there is an alpha channel, which may well be full everywhere (see [`shows_through`]).
    pub alpha: bool,
}

/// Reads only as much of `path` as says how large the photograph is.
///
/// # Errors
/// When it is missing, over the limits, or no PNG or JPEG.
pub(crate) fn header(path: &Path, limits: &Limits) -> Result<Header, CaptureError> {
    let file = File::open(path).map_err(CaptureError::io("open", path))?;
    let length = file.metadata().map_err(CaptureError::io("read", path))?.len();
    let name = path.display().to_string();
    check("file size in bytes", &name, length, limits.max_file_bytes)?;
    let mut decoder = open_decoder(BufReader::new(file), limits, &name)?;
    Ok(read_header(&mut decoder).0)
}

fn read_header(decoder: &mut impl ImageDecoder) -> (Header, Orientation) {
    let (w, h) = (decoder.dimensions().0 as usize, decoder.dimensions().1 as usize);
    // Broken EXIF says nothing about the pixels, so it counts as none.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let oriented = if swaps_sides(orientation) { (h, w) } else { (w, h) };
    let turned = orientation != Orientation::NoTransforms;
    (Header { oriented, stored: (w, h), turned, alpha: decoder.color_type().has_alpha() }, orientation)
}

/// Whether something shows through the photograph at `path`: some pixel's alpha is less than full. An alpha channel
/// alone says nothing, because many programs write one that is full everywhere.
///
/// # Errors
/// When it is missing, over the limits, or cannot be decoded.
pub(crate) fn shows_through(path: &Path, limits: &Limits) -> Result<bool, CaptureError> {
    let bytes = read_limited(path, limits.max_file_bytes)?;
    let name = path.display().to_string();
    let decoder = open_decoder(Cursor::new(&bytes), limits, &name)?;
    Ok(match DynamicImage::from_decoder(decoder).map_err(|e| refused(&name, &e))? {
        DynamicImage::ImageRgba8(image) => image.pixels().any(|p| p[3] < u8::MAX),
        DynamicImage::ImageLumaA8(image) => image.pixels().any(|p| p[1] < u8::MAX),
        DynamicImage::ImageRgba16(image) => image.pixels().any(|p| p[3] < u16::MAX),
        DynamicImage::ImageLumaA16(image) => image.pixels().any(|p| p[1] < u16::MAX),
        other => other.color().has_alpha() && other.into_rgba32f().pixels().any(|p| p[3] < 1.0),
    })
}

/// The bytes of `path`, at most `limits.max_file_bytes` of them.
///
/// # Errors
/// When it cannot be read or is larger.
pub(crate) fn read_limited(path: &Path, max_bytes: u64) -> Result<Vec<u8>, CaptureError> {
    let file = File::open(path).map_err(CaptureError::io("open", path))?;
    let length = file.metadata().map_err(CaptureError::io("read", path))?.len();
    check("file size in bytes", &path.display().to_string(), length, max_bytes)?;
    let mut bytes = Vec::with_capacity(length as usize);
    // `take`, because a file may grow between the look and the read.
    std::io::Read::read_to_end(&mut std::io::Read::take(file, max_bytes), &mut bytes)
        .map_err(CaptureError::io("read", path))?;
    Ok(bytes)
}

/// Decodes a PNG or JPEG: EXIF orientation applied, alpha composited on
/// `background` (RGB in [0, 1]; `None` is white), 16-bit values kept to f32.
///
/// # Errors
/// [`CaptureError::TooLarge`] over the limits (found on the header, before any
/// pixel is allocated) and [`CaptureError::NotAPicture`] for anything else.
pub fn decode_picture(bytes: &[u8], limits: &Limits, background: Option<[f32; 3]>) -> Result<Picture, CaptureError> {
    decode("picture", bytes, limits, background, |_, _| Ok(true))
}

/// As [`decode_picture`], for the photograph at `path`, which must have `size`
/// (width, height): found on the header, before any pixel is allocated. Where
/// only the stored pixels have that size, the camera was computed on those, and
/// they are returned without EXIF orientation; where both have it, `as_stored`
/// says whether they are.
pub(crate) fn decode_sized(
    path: &Path,
    bytes: &[u8],
    limits: &Limits,
    background: Option<[f32; 3]>,
    size: (usize, usize),
    as_stored: bool,
) -> Result<Picture, CaptureError> {
    let orient = |oriented, stored| {
        if oriented == size || stored == size {
            return Ok(oriented == size && !(as_stored && stored == size));
        }
        Err(CaptureError::SizeMismatch { photograph: path.to_path_buf(), expected: size, got: oriented })
    };
    decode(&path.display().to_string(), bytes, limits, background, orient)
}

/// Decodes what errors call `name`; `orient` is given the oriented and the
/// stored size and says whether EXIF orientation is to be applied.
fn decode(
    name: &str,
    bytes: &[u8],
    limits: &Limits,
    background: Option<[f32; 3]>,
    orient: impl FnOnce((usize, usize), (usize, usize)) -> Result<bool, CaptureError>,
) -> Result<Picture, CaptureError> {
    check("file size in bytes", name, bytes.len() as u64, limits.max_file_bytes)?;
    let mut decoder = open_decoder(Cursor::new(bytes), limits, name)?;
    let (header, orientation) = read_header(&mut decoder);
    let apply = orient(header.oriented, header.stored)?;
    let mut decoded = DynamicImage::from_decoder(decoder).map_err(|e| refused(name, &e))?;
    if apply {
        decoded.apply_orientation(orientation);
    }
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let rgb = composite(decoded, background.unwrap_or(WHITE));
    Picture::new(width, height, rgb)
        .map_err(|e| CaptureError::NotAPicture { photograph: name.to_owned(), reason: e.to_string() })
}

/// `picture` as an 8-bit RGB PNG, values clamped to [0, 1] and rounded to nearest.
///
/// The same picture gives the same bytes. A number that is not finite has no
/// 8-bit value: [`save_png`] refuses it, here it is the caller's to have refused.
///
/// # Panics
/// When a side is over 2^32 - 1 pixels.
pub fn encode_png(picture: &Picture) -> Vec<u8> {
    let mut bytes = Vec::new();
    let size = |side: usize| u32::try_from(side).expect("a PNG's side is below 2^32 pixels");
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&picture.to_rgb8(), size(picture.width()), size(picture.height()), image::ExtendedColorType::Rgb8)
        .expect("writing to memory does not fail, and the buffer fits the size");
    bytes
}

/// Saves `picture` as PNG: written and synced beside `path`, then renamed, so
/// that nobody ever sees half a file.
///
/// # Errors
/// [`CaptureError::NotFinite`] for a picture that holds NaN or infinity, and
/// [`CaptureError::Io`].
pub fn save_png(path: &Path, picture: &Picture) -> Result<(), CaptureError> {
    if let Some(at) = picture.rgb().iter().position(|v| !v.is_finite()) {
        let (pixel, got) = (at / 3, picture.rgb()[at]);
        let (x, y) = (pixel % picture.width(), pixel / picture.width());
        return Err(CaptureError::NotFinite { path: path.to_path_buf(), x, y, got });
    }
    write_atomic(path, &encode_png(picture))
}

/// Writes `bytes` to `path` through a synced file beside it and a rename.
pub(crate) fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), CaptureError> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let part: PathBuf = path.with_file_name(name);
    let written =
        write_synced(&part, bytes).and_then(|()| std::fs::rename(&part, path).map_err(CaptureError::io("write", path)));
    if written.is_err() {
        // The write's own error is the one to report; the leftover is only litter.
        let _ = std::fs::remove_file(&part);
    }
    written
}

/// Writes `bytes` to a new file `path` and waits until they are on the disk.
pub(crate) fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), CaptureError> {
    let mut file = File::create(path).map_err(CaptureError::io("create", path))?;
    file.write_all(bytes).and_then(|()| file.sync_all()).map_err(CaptureError::io("write", path))
}

fn check(what: &'static str, file: &str, got: u64, limit: u64) -> Result<(), CaptureError> {
    if got > limit {
        return Err(CaptureError::TooLarge { file: file.to_owned(), what, limit, got });
    }
    Ok(())
}

fn refused(name: &str, error: &ImageError) -> CaptureError {
    CaptureError::NotAPicture { photograph: name.to_owned(), reason: error.to_string() }
}

fn open_decoder<'a, R: BufRead + Seek + 'a>(
    reader: R,
    limits: &Limits,
    name: &str,
) -> Result<impl ImageDecoder + 'a, CaptureError> {
    let mut reader = ImageReader::new(reader)
        .with_guessed_format()
        .map_err(|e| CaptureError::NotAPicture { photograph: name.to_owned(), reason: e.to_string() })?;
    // Before the first byte: a PNG's compressed colour profile is unpacked along with the header.
    let mut of_header = image::Limits::no_limits();
    of_header.max_alloc = Some(MAX_HEADER_BYTES);
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

fn swaps_sides(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

fn composite(decoded: DynamicImage, background: [f32; 3]) -> Vec<f32> {
    if !decoded.color().has_alpha() {
        return decoded.into_rgb32f().into_raw();
    }
    let rgba = decoded.into_rgba32f();
    rgba.as_raw().chunks_exact(4).flat_map(|p| [0, 1, 2].map(|c| p[c] * p[3] + background[c] * (1.0 - p[3]))).collect()
}
