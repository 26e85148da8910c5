//! A strict reader for the one shape of NumPy file that LLFF brings: a
//! two-dimensional, C-ordered array of little-endian floats (NEP 1 format,
//! versions 1 to 3). Anything else is refused by name.

use std::path::Path;

use crate::error::CaptureError;

const REMEDY: &str = "save it with numpy.save as a two-dimensional float64 array";

/// A matrix: rows, columns, and the numbers in row-major order.
#[derive(Debug)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub columns: usize,
    pub values: Vec<f64>,
}

/// Parses `bytes`, which were read from `file`.
///
/// # Errors
/// For anything but a complete 2-D `<f8` or `<f4` array in C order.
pub(crate) fn parse(file: &Path, bytes: &[u8]) -> Result<Matrix, CaptureError> {
    let wrong = |entry: &str, expected: &str, got: String| CaptureError::malformed(file, entry, expected, got, REMEDY);
    let short = || wrong("the header", "a complete NumPy header", format!("{} bytes", bytes.len()));
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err(wrong("the first bytes", "a NumPy file's \\x93NUMPY", "something else".to_owned()));
    }
    let version = *bytes.get(6).ok_or_else(short)?;
    let (length, start) = match version {
        1 => (bytes.get(8..10).map(|b| usize::from(b[0]) | usize::from(b[1]) << 8), 10),
        2 | 3 => (bytes.get(8..12).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize), 12),
        other => return Err(wrong("the format version", "1, 2 or 3", other.to_string())),
    };
    let end = length.and_then(|l| l.checked_add(start)).ok_or_else(short)?;
    let header = std::str::from_utf8(bytes.get(start..end).ok_or_else(short)?).map_err(|_| short())?;
    let data = &bytes[end..];

    let size = match value_of(header, "descr") {
        Some("'<f8'") => 8,
        Some("'<f4'") => 4,
        other => return Err(wrong("descr", "'<f8' or '<f4'", other.unwrap_or("nothing").to_owned())),
    };
    match value_of(header, "fortran_order") {
        Some("False") => {}
        other => return Err(wrong("fortran_order", "False", other.unwrap_or("nothing").to_owned())),
    }
    let shape = value_of(header, "shape").unwrap_or("nothing");
    let (rows, columns) = parse_shape(shape).ok_or_else(|| wrong("shape", "(rows, columns)", shape.to_owned()))?;
    let expected = rows.checked_mul(columns).and_then(|n| n.checked_mul(size));
    if expected != Some(data.len()) {
        let wanted = format!("{rows} x {columns} numbers of {size} bytes");
        return Err(wrong("the data", &wanted, format!("{} bytes", data.len())));
    }
    let values = match size {
        8 => data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        _ => data.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
    };
    Ok(Matrix { rows, columns, values })
}

/// The text of `key`'s value in the header, which is a Python dict literal with
/// three known keys.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let rest = header.split_once(&format!("'{key}':"))?.1.trim_start();
    let end = if rest.starts_with('(') { rest.find(')')? + 1 } else { rest.find([',', '}'])? };
    Some(rest[..end].trim_end())
}

fn parse_shape(text: &str) -> Option<(usize, usize)> {
    let mut sides = text.strip_prefix('(')?.strip_suffix(')')?.split(',').map(|side| side.trim().parse().ok());
    let shape = (sides.next()??, sides.next()??);
    sides.next().is_none().then_some(shape)
}
