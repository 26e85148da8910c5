//! A baseline: a picture hidden in photographs' least significant bits before a
//! field is trained on them, as the paper compares with. What a field renders
//! are means over many photographs, and their lowest bits are nobody's; this is
//! here to be measured, not to be used.

use cairn_scene::Picture;

/// Bits of a hidden number that fit: all the photograph's lowest bits, shared evenly.
fn bits(photograph: &Picture, hidden: [usize; 2]) -> usize {
    (photograph.rgb().len() / (hidden[0] * hidden[1] * 3).max(1)).min(8)
}

/// `photograph` in 8 bits with `hidden` in the lowest bit of each number: the highest bits
/// of each of its numbers first, as many of the eight as there is room for, row by row.
///
/// # Errors
/// An error for a photograph with less than one bit a hidden number.
pub fn hide_in_lowest_bits(photograph: &Picture, hidden: &Picture) -> anyhow::Result<Picture> {
    let each = bits(photograph, [hidden.width(), hidden.height()]);
    if each == 0 {
        let (w, h) = (photograph.width(), photograph.height());
        let why = format!(
            "a photograph of {w} x {h} px has no room for {} hidden numbers; hide a smaller picture",
            hidden.rgb().len()
        );
        anyhow::bail!(why);
    }
    let mut levels = photograph.clone().clamped().to_rgb8();
    let wanted = hidden.clone().clamped().to_rgb8();
    let stream = wanted.iter().flat_map(|v| (0..each).map(move |k| v >> (7 - k) & 1));
    for (level, bit) in levels.iter_mut().zip(stream) {
        *level = *level & !1 | bit;
    }
    picture(photograph.width(), photograph.height(), &levels)
}

/// What [`hide_in_lowest_bits`] hid in `picture`, `[width, height]` pixels.
///
/// # Errors
/// An error for a picture with less than one bit a hidden number.
pub fn read_lowest_bits(from: &Picture, [width, height]: [usize; 2]) -> anyhow::Result<Picture> {
    let each = bits(from, [width, height]);
    if each == 0 {
        let why = format!("{} x {} px hold no picture of {width} x {height}", from.width(), from.height());
        anyhow::bail!(why);
    }
    let levels = from.clone().clamped().to_rgb8();
    let number = |bits: &[u8]| bits.iter().enumerate().fold(0u8, |v, (k, level)| v | (level & 1) << (7 - k));
    let hidden: Vec<u8> = levels.chunks_exact(each).take(width * height * 3).map(number).collect();
    picture(width, height, &hidden)
}

fn picture(width: usize, height: usize, levels: &[u8]) -> anyhow::Result<Picture> {
    Picture::from_rgb8(width, height, levels).map_err(anyhow::Error::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_mark::Distortion;

    fn ramp(width: usize, height: usize, step: usize) -> Picture {
        let levels: Vec<u8> = (0..width * height * 3).map(|i| (i * step % 256) as u8).collect();
        picture(width, height, &levels).unwrap()
    }

    #[test]
    fn what_was_hidden_is_read_and_the_photograph_hardly_moves() {
        let hidden = ramp(12, 10, 7);
        for (size, exact) in [([40, 40], true), ([30, 24], false)] {
            let photograph = ramp(size[0], size[1], 13);
            let stego = hide_in_lowest_bits(&photograph, &hidden).unwrap();
            let off = stego.rgb().iter().zip(photograph.rgb()).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
            assert!(off > 0.0 && off < 1.01 / 255.0, "{off}");
            let read = read_lowest_bits(&stego, [12, 10]).unwrap();
            let kept = bits(&photograph, [12, 10]);
            let mask = !0u8 << (8 - kept);
            let expected: Vec<u8> = hidden.to_rgb8().iter().map(|v| v & mask).collect();
            assert_eq!(read.to_rgb8(), expected, "{kept} bits");
            assert_eq!(exact, kept == 8);
        }
    }

    #[test]
    fn a_level_up_or_down_is_the_end_of_it() {
        let (hidden, photograph) = (ramp(12, 10, 7), ramp(40, 40, 13));
        let stego = hide_in_lowest_bits(&photograph, &hidden).unwrap();
        let attacked = Distortion::Noise { sigma: 0.004 }.apply(&stego, 1);
        let read = read_lowest_bits(&attacked, [12, 10]).unwrap();
        let right = read.to_rgb8().iter().zip(hidden.to_rgb8()).filter(|(a, b)| a.abs_diff(*b) < 8).count();
        assert!(right < 60, "{right} of 360 numbers are still about right");
        assert!(hide_in_lowest_bits(&ramp(8, 8, 1), &hidden).unwrap_err().to_string().contains("smaller picture"));
        assert!(read_lowest_bits(&ramp(8, 8, 1), [12, 10]).is_err());
    }
}
