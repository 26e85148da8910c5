//! What holds of a WebP before its decoder sees it: it is whole, still, and as large as it says.
//!
//! The decoder takes a chunk's word for its length and a frame's for its size, and has no limit on memory. Here both are
//! held to the file and to the canvas, so that the limits on the canvas hold for all of it.
//!
//! The container is that of RFC 9649, section 2; where a frame has its size is in its section 3 for lossless frames and
//! in RFC 6386, section 9.1, for lossy ones.

use std::io::{self, Read, Seek, SeekFrom};

/// Before the first chunk: `RIFF`, the length of the rest, `WEBP`.
const HEADER_BYTES: u64 = 12;
/// Of an extended header, and the most of a frame that says its size.
const HEAD_BYTES: usize = 10;
/// The flag of an extended header that says animation.
const ANIMATED: u8 = 1 << 1;
/// No encoder needs more for a pixel without loss: four channels as they are.
const LOSSLESS_PIXEL_BYTES: u64 = 4;
/// Codes and transforms of a small lossless picture. The decoder takes some 300 times as much memory for codes as they
/// take in the file, 1.4 GB at most, so that their length is bounded by the picture's size.
const LOSSLESS_CODE_BYTES: u64 = 64 << 10;

/// Width and height, px.
type Size = [u64; 2];

/// Checks the WebP in `file` from its first byte on, and goes back there. Takes no memory, whatever the file says.
///
/// `max_exif_bytes` bounds its EXIF, which the decoder reads as a whole.
///
/// # Errors
/// What is wrong with it, to be said behind the file's name.
pub(crate) fn check(file: &mut (impl Read + Seek), max_exif_bytes: u64) -> Result<(), String> {
    let length = file.seek(SeekFrom::End(0)).map_err(said)?;
    file.rewind().map_err(said)?;
    let mut header = [0; HEADER_BYTES as usize];
    file.read_exact(&mut header).map_err(said)?;
    let whole = 8 + number(&header[4..8]);
    // Some programs leave a last byte of padding away, or do not count it.
    if length.abs_diff(whole) > 1 {
        return Err(format!("its header says {whole} bytes, and it has {length}"));
    }
    let (mut at, mut canvas) = (HEADER_BYTES, None);
    while at + 8 <= length {
        let mut chunk = [0; 8];
        file.read_exact(&mut chunk).map_err(said)?;
        let (name, size) = (&chunk[..4], number(&chunk[4..]));
        at += 8;
        if size > length - at {
            return Err(format!("its chunk {} says {size} bytes, and {} are left", name.escape_ascii(), length - at));
        }
        let mut head = [0; HEAD_BYTES];
        let taken = size.min(HEAD_BYTES as u64);
        file.read_exact(&mut head[..taken as usize]).map_err(said)?;
        canvas = of_chunk(name, size, &head, canvas, max_exif_bytes)?;
        let padded = size + size % 2;
        file.seek_relative((padded - taken) as i64).map_err(said)?;
        at += padded;
    }
    file.rewind().map_err(said)
}

/// The picture's size once the chunk is known that begins with `head`, zeros where it is shorter.
fn of_chunk(
    name: &[u8],
    size: u64,
    head: &[u8; HEAD_BYTES],
    canvas: Option<Size>,
    max_exif_bytes: u64,
) -> Result<Option<Size>, String> {
    let is_extended = name == b"VP8X" && canvas.is_none();
    if matches!(name, b"ANIM" | b"ANMF") || is_extended && head[0] & ANIMATED != 0 {
        return Err("it is an animation, and one frame of it has to be chosen".to_owned());
    }
    let canvas = match name {
        b"VP8X" if is_extended && size == HEAD_BYTES as u64 => {
            Some([&head[4..7], &head[7..10]].map(|side| number(side) + 1))
        }
        b"VP8X" => return Err("its extended header is not 10 bytes at the beginning".to_owned()),
        b"VP8 " | b"VP8L" => {
            let frame = frame_size(name, head);
            let canvas = canvas.unwrap_or(frame);
            if frame != canvas {
                let [[w, h], [cw, ch]] = [frame, canvas];
                return Err(format!("it says that it has {cw} x {ch} pixels, and its frame has {w} x {h}"));
            }
            Some(canvas)
        }
        _ => canvas,
    };
    let most = match (name, canvas) {
        (b"EXIF", _) => max_exif_bytes,
        (b"VP8L" | b"ALPH", Some([w, h])) => w * h * LOSSLESS_PIXEL_BYTES + LOSSLESS_CODE_BYTES,
        _ => u64::MAX,
    };
    if size > most {
        return Err(format!("its chunk {} has {size} bytes, and {most} at most are read", name.escape_ascii()));
    }
    Ok(canvas)
}

/// What the frame of the chunk `name` says that it has.
fn frame_size(name: &[u8], head: &[u8; HEAD_BYTES]) -> Size {
    if name == b"VP8L" {
        // Behind a signature, 14 bits each of what is one less.
        let bits = number(&head[1..5]);
        return [bits, bits >> 14].map(|side| (side & 0x3fff) + 1);
    }
    // Behind a tag and a start code, in two bytes each, whose upper two bits are a scale.
    [&head[6..8], &head[8..10]].map(|side| number(side) & 0x3fff)
}

/// The unsigned number in `bytes`, the lowest first.
fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

fn said(error: io::Error) -> String {
    error.to_string()
}
