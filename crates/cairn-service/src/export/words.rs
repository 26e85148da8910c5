//! Words on pictures, in the one font that the program brings along: the same on every machine.

use std::sync::OnceLock;

use ab_glyph::{Font, FontRef, ScaleFont, point};
use cairn_scene::Picture;

/// Red, green, blue.
pub type Colour = [u8; 3];

/// DejaVu Sans: Latin, Greek, Cyrillic and more, since contributors have names. Its licence stands beside it.
pub static FONT: &[u8] = include_bytes!("font/DejaVuSans.ttf");

/// Words at a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// The words; one line.
    pub text: String,
    /// Their left edge, px.
    pub left: f64,
    /// The upper edge of their line, px.
    pub top: f64,
    /// The height of their line, px.
    pub height_px: f64,
    /// Their colour.
    pub colour: Colour,
}

/// `None` where the font does not read; the tests below read it.
fn font() -> Option<&'static FontRef<'static>> {
    static FONT_READ: OnceLock<Option<FontRef<'static>>> = OnceLock::new();
    FONT_READ.get_or_init(|| FontRef::try_from_slice(FONT).ok()).as_ref()
}

/// Pixels across that `text` takes, in lines of this height.
pub fn width_px(text: &str, height_px: f64) -> f64 {
    let Some(font) = font() else { return 0.0 };
    let font = font.as_scaled(height_px as f32);
    text.chars().map(|c| f64::from(font.h_advance(font.glyph_id(c)))).sum()
}

/// As much of the beginning of `text` as `max_px` have room for.
pub fn cut(text: &str, height_px: f64, max_px: f64) -> String {
    let mut kept = text.to_owned();
    while !kept.is_empty() && width_px(&kept, height_px) > max_px {
        kept.pop();
    }
    kept
}

/// Draws `label` on `picture`; what lies outside of it is cut off. Letters a font lacks are boxes.
pub fn write(picture: &mut Picture, label: &Label) {
    let Some(font) = font() else { return };
    let scaled = font.as_scaled(label.height_px as f32);
    let (width, height) = (picture.width() as i64, picture.height() as i64);
    let (mut left, baseline) = (label.left as f32, label.top as f32 + scaled.ascent());
    for letter in label.text.chars() {
        let mut glyph = scaled.scaled_glyph(letter);
        glyph.position = point(left, baseline);
        left += scaled.h_advance(glyph.id);
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|x, y, share| {
            let (x, y) = (corner.x as i64 + i64::from(x), corner.y as i64 + i64::from(y));
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let at = (y * width + x) as usize * 3;
                for (value, new) in picture.rgb_mut()[at..at + 3].iter_mut().zip(label.colour) {
                    *value += (f32::from(new) / 255.0 - *value) * share.min(1.0);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(text: &str, left: f64, top: f64) -> Label {
        Label { text: text.into(), left, top, height_px: 14.0, colour: [0; 3] }
    }

    /// Rows and columns with ink.
    fn inked(picture: &Picture) -> (Vec<usize>, Vec<usize>) {
        let (width, height) = (picture.width(), picture.height());
        let ink = |x: usize, y: usize| picture.pixel(x, y)[0] < 0.5;
        let rows = (0..height).filter(|y| (0..width).any(|x| ink(x, *y))).collect();
        (rows, (0..width).filter(|x| (0..height).any(|y| ink(*x, y))).collect())
    }

    #[test]
    fn words_have_small_letters_and_stay_in_their_line() {
        let written = |text: &str| {
            let mut paper = Picture::constant(160, 24, [1.0; 3]);
            write(&mut paper, &label(text, 2.0, 4.0));
            inked(&paper)
        };
        let (small, large) = (written("noun").0, written("NOUN").0);
        assert!(!small.is_empty() && small.len() < large.len(), "{small:?} and {large:?}");
        for text in ["Юлия Müller", "Adgjpqy"] {
            let (rows, columns) = written(text);
            assert!(rows[0] >= 4 && rows[rows.len() - 1] < 4 + 14, "{text}: rows {rows:?}");
            let end = 2.0 + width_px(text, 14.0);
            assert!(columns[0] >= 2 && (columns[columns.len() - 1] as f64) < end, "{text}: {columns:?} of {end}");
        }
    }

    #[test]
    fn words_are_cut_to_the_room_there_is_and_at_the_edge() {
        let all = width_px("a long name", 12.0);
        let kept = cut("a long name", 12.0, 30.0);
        assert!(all > 30.0 && !kept.is_empty() && width_px(&kept, 12.0) <= 30.0, "{kept}");
        assert_eq!(cut("a long name", 12.0, all), "a long name");
        let mut paper = Picture::constant(10, 10, [1.0; 3]);
        for left in [-5.0, 8.0, 40.0] {
            write(&mut paper, &label("W", left, -3.0));
        }
        assert!(!inked(&paper).0.is_empty());
    }
}
