//! Photographs in and out: decoded under limits that are checked on the header
//! before a pixel is allocated, and PNG written in one step.
//!
//! EXIF orientation is honoured. Values stay display-referred (sRGB-encoded);
//! alpha is composited in those values, as browsers and the published
//! NeRF-Synthetic figures do.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

use cairn_durable::read_limited;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder};

use crate::cameras::intrinsics::Intrinsics;
use crate::error::CaptureError;
use crate::images::format::{self, ImageFormat, Limits, decode_pixels, open_decoder};
use crate::images::mask::Mask;
use crate::images::picture::Picture;

/// What a transparent pixel is composited on where nothing else is said.
pub(crate) const WHITE: [f32; 3] = [1.0; 3];

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
/// When it is missing, over the limits, or of no format that is read.
pub(crate) fn header(path: &Path, limits: &Limits) -> Result<Header, CaptureError> {
    let file = File::open(path).map_err(CaptureError::io("open", path))?;
    let length = file.metadata().map_err(CaptureError::io("read", path))?.len();
    let name = path.display().to_string();
    format::check("file size in bytes", &name, length, limits.max_file_bytes)?;
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
    Ok(match decode_pixels(decoder, &name)? {
        DynamicImage::ImageRgba8(image) => image.pixels().any(|p| p[3] < u8::MAX),
        DynamicImage::ImageLumaA8(image) => image.pixels().any(|p| p[1] < u8::MAX),
        DynamicImage::ImageRgba16(image) => image.pixels().any(|p| p[3] < u16::MAX),
        DynamicImage::ImageLumaA16(image) => image.pixels().any(|p| p[1] < u16::MAX),
        other => other.color().has_alpha() && other.into_rgba32f().pixels().any(|p| p[3] < 1.0),
    })
}

/// Decodes a picture of any [`ImageFormat`]: EXIF orientation applied, alpha composited on
/// `background` (RGB in [0, 1]; `None` is white), 16-bit values kept to f32.
///
/// # Errors
/// [`CaptureError::TooLarge`] over the limits (found on the header, before any
/// pixel is allocated) and [`CaptureError::NotAPicture`] for anything else.
pub fn decode_picture(bytes: &[u8], limits: &Limits, background: Option<[f32; 3]>) -> Result<Picture, CaptureError> {
    decode("picture", bytes, limits, background, |_, _| Ok(true))
}

/// As [`decode_picture`], for the photograph at `path`, which must have the size of `camera`: checked
/// on the header, before any pixel is allocated. Where only the stored pixels have that size, the
/// camera was computed on those, and they are returned without EXIF orientation; where both have it,
/// `as_stored` says whether they are.
pub(crate) fn decode_sized(
    path: &Path,
    bytes: &[u8],
    limits: &Limits,
    background: Option<[f32; 3]>,
    camera: &Intrinsics,
    as_stored: bool,
) -> Result<Picture, CaptureError> {
    let size = (camera.width, camera.height);
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
    format::check("file size in bytes", name, bytes.len() as u64, limits.max_file_bytes)?;
    let mut decoder = open_decoder(Cursor::new(bytes), limits, name)?;
    let (header, orientation) = read_header(&mut decoder);
    let apply = orient(header.oriented, header.stored)?;
    let mut decoded = decode_pixels(decoder, name)?;
    if apply {
        decoded.apply_orientation(orientation);
    }
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let rgb = composite(decoded, background.unwrap_or(WHITE));
    Picture::new(width, height, rgb)
        .map_err(|e| CaptureError::NotAPicture { photograph: name.to_owned(), reason: e.to_string() })
}

/// `picture` as an 8-bit RGB PNG; as [`ImageFormat::encode`].
///
/// # Panics
/// When a side is over 2^32 - 1 pixels.
pub fn encode_png(picture: &Picture) -> Vec<u8> {
    ImageFormat::Png.encode(picture)
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
    Ok(cairn_durable::write_atomic(path, &encode_png(picture))?)
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

/// Decodes the mask at `path`, of which `bytes` were read: any [`ImageFormat`], by its brightness. Neither EXIF
/// orientation nor alpha is looked at. It must have the size of `camera`, which is the photograph's: found on the
/// header, before any pixel is allocated.
///
/// # Errors
/// [`CaptureError::MaskSize`] names both sizes; else as [`decode_picture`].
pub(crate) fn decode_mask(
    path: &Path,
    bytes: &[u8],
    limits: &Limits,
    camera: &Intrinsics,
) -> Result<Mask, CaptureError> {
    let name = path.display().to_string();
    format::check("file size in bytes", &name, bytes.len() as u64, limits.max_file_bytes)?;
    let decoder = open_decoder(Cursor::new(bytes), limits, &name)?;
    let (width, height) = (decoder.dimensions().0 as usize, decoder.dimensions().1 as usize);
    if (width, height) != (camera.width, camera.height) {
        let photograph = (camera.width, camera.height);
        return Err(CaptureError::MaskSize { mask: path.to_path_buf(), photograph, got: (width, height) });
    }
    let grey = decode_pixels(decoder, &name)?.into_luma8();
    Mask::from_grey8(width, height, grey.as_raw())
        .map_err(|e| CaptureError::NotAPicture { photograph: name, reason: e.to_string() })
}
