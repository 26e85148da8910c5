//! Letters of five by seven dots, for initials on emblems and for labels on
//! sheets of pictures. Seven small numbers a letter are easier to keep than a
//! font file and its rasteriser.

use cairn_scene::Picture;

/// Dots from one letter's left edge to the next one's.
pub const ADVANCE: usize = 6;
/// Dots down.
pub const LINE: usize = 7;

/// Rows from the top; in each the highest of five bits is the left dot.
const LETTERS: &[(char, [u8; 7])] = &[
    ('A', [14, 17, 17, 31, 17, 17, 17]),
    ('B', [30, 17, 17, 30, 17, 17, 30]),
    ('C', [14, 17, 16, 16, 16, 17, 14]),
    ('D', [30, 17, 17, 17, 17, 17, 30]),
    ('E', [31, 16, 16, 30, 16, 16, 31]),
    ('F', [31, 16, 16, 30, 16, 16, 16]),
    ('G', [14, 17, 16, 23, 17, 17, 15]),
    ('H', [17, 17, 17, 31, 17, 17, 17]),
    ('I', [14, 4, 4, 4, 4, 4, 14]),
    ('J', [7, 2, 2, 2, 2, 18, 12]),
    ('K', [17, 18, 20, 24, 20, 18, 17]),
    ('L', [16, 16, 16, 16, 16, 16, 31]),
    ('M', [17, 27, 21, 21, 17, 17, 17]),
    ('N', [17, 25, 21, 19, 17, 17, 17]),
    ('O', [14, 17, 17, 17, 17, 17, 14]),
    ('P', [30, 17, 17, 30, 16, 16, 16]),
    ('Q', [14, 17, 17, 17, 21, 18, 13]),
    ('R', [30, 17, 17, 30, 20, 18, 17]),
    ('S', [15, 16, 16, 14, 1, 1, 30]),
    ('T', [31, 4, 4, 4, 4, 4, 4]),
    ('U', [17, 17, 17, 17, 17, 17, 14]),
    ('V', [17, 17, 17, 17, 17, 10, 4]),
    ('W', [17, 17, 17, 21, 21, 27, 17]),
    ('X', [17, 17, 10, 4, 10, 17, 17]),
    ('Y', [17, 17, 10, 4, 4, 4, 4]),
    ('Z', [31, 1, 2, 4, 8, 16, 31]),
    ('0', [14, 17, 19, 21, 25, 17, 14]),
    ('1', [4, 12, 4, 4, 4, 4, 14]),
    ('2', [14, 17, 1, 6, 8, 16, 31]),
    ('3', [30, 1, 1, 14, 1, 1, 30]),
    ('4', [2, 6, 10, 18, 31, 2, 2]),
    ('5', [31, 16, 30, 1, 1, 17, 14]),
    ('6', [6, 8, 16, 30, 17, 17, 14]),
    ('7', [31, 1, 2, 4, 8, 8, 8]),
    ('8', [14, 17, 17, 14, 17, 17, 14]),
    ('9', [14, 17, 17, 15, 1, 2, 12]),
    ('.', [0, 0, 0, 0, 0, 12, 12]),
    (',', [0, 0, 0, 0, 12, 4, 8]),
    (':', [0, 12, 12, 0, 12, 12, 0]),
    ('-', [0, 0, 0, 31, 0, 0, 0]),
    ('+', [0, 4, 4, 31, 4, 4, 0]),
    ('_', [0, 0, 0, 0, 0, 0, 31]),
    ('=', [0, 0, 31, 0, 31, 0, 0]),
    ('/', [1, 1, 2, 4, 8, 16, 16]),
    ('%', [24, 25, 2, 4, 8, 19, 3]),
    ('(', [2, 4, 8, 8, 8, 4, 2]),
    (')', [8, 4, 2, 2, 2, 4, 8]),
    ('>', [8, 4, 2, 1, 2, 4, 8]),
    ('<', [2, 4, 8, 16, 8, 4, 2]),
    (' ', [0; 7]),
];

/// Drawn for a letter that the font lacks, so that it is seen to be missing.
const MISSING: [u8; 7] = [31, 17, 17, 17, 17, 17, 31];

/// Whether dot (`x`, `y`), from the letter's top left, is inked. Small letters
/// are drawn as capitals; outside of the five by seven dots nothing is.
pub fn inked(letter: char, x: usize, y: usize) -> bool {
    if x >= 5 || y >= LINE {
        return false;
    }
    let wanted = letter.to_ascii_uppercase();
    let rows = LETTERS.iter().find(|(l, _)| *l == wanted).map_or(MISSING, |(_, rows)| *rows);
    rows[y] >> (4 - x) & 1 == 1
}

/// Pixels across of `text` at `scale` pixels a dot.
pub fn text_width(text: &str, scale: usize) -> usize {
    (text.chars().count() * ADVANCE).saturating_sub(1) * scale
}

/// Writes `text` into `picture`, its top left corner at (`left`, `top`), in
/// colour `rgb` at `scale` pixels a dot. What does not fit is cut off.
pub fn draw_text(picture: &mut Picture, text: &str, left: usize, top: usize, scale: usize, rgb: [f32; 3]) {
    let (width, height) = (picture.width(), picture.height());
    for (index, letter) in text.chars().enumerate() {
        let start = left + index * ADVANCE * scale;
        if start >= width {
            return;
        }
        for y in (top..height).take(LINE * scale) {
            for x in (start..width).take(5 * scale) {
                if inked(letter, (x - start) / scale, (y - top) / scale) {
                    picture.rgb_mut()[(y * width + x) * 3..][..3].copy_from_slice(&rgb);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_distinct_and_fit() {
        for (i, (a, rows)) in LETTERS.iter().enumerate() {
            assert!(rows.iter().all(|r| *r < 32), "{a} is wider than five dots");
            for (b, others) in &LETTERS[i + 1..] {
                assert!(a != b && rows != others, "{a} and {b} look the same");
            }
        }
    }

    #[test]
    fn text_lands_where_it_should_and_is_cut_at_the_edge() {
        let mut picture = Picture::constant(20, 9, [0.0; 3]);
        draw_text(&mut picture, "ll~x", 1, 1, 1, [1.0, 0.5, 0.0]);
        assert_eq!(picture.pixel(1, 1), [1.0, 0.5, 0.0]);
        assert_eq!(picture.pixel(2, 1), [0.0; 3]);
        assert_eq!(picture.pixel(5, 7), [1.0, 0.5, 0.0]);
        assert_eq!(picture.pixel(13, 1), [1.0, 0.5, 0.0], "a missing letter is a box");
        draw_text(&mut picture, "A", 500, 500, 3, [1.0; 3]);
        assert_eq!(text_width("ab", 2), 22);
        assert_eq!(text_width("", 2), 0);
    }
}
