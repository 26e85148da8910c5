//! Sheets of labelled pictures: the check by eye that stands beside every
//! figure, since a number can be good on a wrong picture.

use cairn_scene::Picture;

use crate::export::words::{self, Label};

/// Space around and between tiles, px.
const GAP: usize = 4;
/// Height of a label's line, px.
const LINE_PX: f64 = 14.0;
/// Height of a label's strip, px.
const LABEL: usize = 18;
const PAPER: [f32; 3] = [0.97, 0.97, 0.95];
const INK: words::Colour = [30, 30, 36];

/// One picture of a sheet and what stands under it.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Any size; it is fitted into its place with its proportions kept.
    pub picture: Picture,
    /// One line; cut to the width.
    pub label: String,
}

/// Lays `rows` of tiles out on one sheet, each picture within
/// `tile_w` x `tile_h` px (at least 1 each is used), label below it. Rows may
/// differ in length; no tiles at all give a small empty sheet.
pub fn contact_sheet(rows: &[Vec<Tile>], tile_w: usize, tile_h: usize) -> Picture {
    let (tile_w, tile_h) = (tile_w.max(1), tile_h.max(1));
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = GAP + columns * (tile_w + GAP);
    let height = GAP + rows.len() * (tile_h + LABEL + GAP);
    let mut sheet = Picture::constant(width, height, PAPER);
    for (r, row) in rows.iter().enumerate() {
        for (c, tile) in row.iter().enumerate() {
            let (left, top) = (GAP + c * (tile_w + GAP), GAP + r * (tile_h + LABEL + GAP));
            let fitted = fit(&tile.picture, tile_w, tile_h);
            let (dx, dy) = ((tile_w - fitted.width()) / 2, (tile_h - fitted.height()) / 2);
            paste(&mut sheet, &fitted, left + dx, top + dy);
            let text = words::cut(&tile.label, LINE_PX, tile_w as f64);
            write(&mut sheet, text, left, top + tile_h + 1);
        }
    }
    sheet
}

/// `paragraphs` on paper of `width` x `height` px (at least 1 each is used), broken between letters where a line is full;
/// what does not fit is cut off.
pub fn paper(paragraphs: &[String], width: usize, height: usize) -> Picture {
    let mut paper = Picture::constant(width.max(1), height.max(1), PAPER);
    let line = LINE_PX as usize + 2;
    let mut top = 1;
    for paragraph in paragraphs {
        let mut rest = paragraph.as_str();
        while !rest.is_empty() && top < paper.height() {
            let mut kept = words::cut(rest, LINE_PX, width as f64);
            if kept.is_empty() {
                // Paper narrower than a letter: it is cut at the edge.
                kept = rest.chars().take(1).collect();
            }
            rest = &rest[kept.len()..];
            write(&mut paper, kept, 0, top);
            top += line;
        }
        top += line / 2;
    }
    paper
}

/// A line of words on a sheet.
fn write(sheet: &mut Picture, text: String, left: usize, top: usize) {
    let label = Label { text, left: left as f64, top: top as f64, height_px: LINE_PX, colour: INK };
    words::write(sheet, &label);
}

/// `picture` as large as fits. Values outside of [0, 1] are clamped: a sheet is
/// for looking at.
fn fit(picture: &Picture, width: usize, height: usize) -> Picture {
    let scale = (width as f64 / picture.width() as f64).min(height as f64 / picture.height() as f64);
    let side = |old: usize, most: usize| ((old as f64 * scale).round() as usize).clamp(1, most);
    picture.resized(side(picture.width(), width), side(picture.height(), height)).clamped()
}

fn paste(sheet: &mut Picture, picture: &Picture, left: usize, top: usize) {
    let (across, wide) = (sheet.width(), picture.width());
    for (y, row) in picture.rgb().chunks_exact(wide * 3).enumerate() {
        let at = ((top + y) * across + left) * 3;
        sheet.rgb_mut()[at..at + wide * 3].copy_from_slice(row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_keep_their_proportions_and_labels_stand_below() {
        let tile = |w, h, label: &str| Tile { picture: Picture::constant(w, h, [1.0, 0.0, 2.0]), label: label.into() };
        let rows = vec![vec![tile(20, 10, "A much too long label"), tile(5, 50, "")], vec![tile(1, 1, "x")]];
        let sheet = contact_sheet(&rows, 20, 20);
        assert_eq!((sheet.width(), sheet.height()), (4 + 2 * 24, 4 + 2 * (20 + LABEL + 4)));
        assert_eq!(sheet.pixel(14, 4), PAPER, "the wide picture leaves room above");
        assert_eq!(sheet.pixel(14, 14), [1.0, 0.0, 1.0]);
        assert_eq!(sheet.pixel(28 + 10, 4), [1.0, 0.0, 1.0], "the tall one leaves none");
        let is_inked = |x: usize, y: usize| sheet.pixel(x, y)[0] < 0.6;
        assert!((4..24).any(|x| (24..24 + LABEL).any(|y| is_inked(x, y))), "there is a label");
        let beyond = (25..28).any(|x| (24..24 + LABEL).any(|y| is_inked(x, y)));
        assert!(!beyond, "and it is cut to its tile");
        assert_eq!(contact_sheet(&[], 9, 9).pixel(0, 0), PAPER);
    }

    #[test]
    fn words_are_broken_where_a_line_is_full() {
        // Two letters a line: two lines of the first paragraph, one of the second.
        let width = words::width_px("HH", LINE_PX).ceil() as usize + 1;
        let paper = paper(&["HHHH".into(), "H".into()], width, 60);
        let is_inked = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
            rows.clone().any(|y| columns.clone().any(|x| paper.pixel(x, y)[0] < 0.6))
        };
        let half = width / 2;
        assert!(is_inked(1..15, 0..half) && is_inked(1..15, half..width) && is_inked(18..31, half..width), "the first");
        assert!(is_inked(42..55, 0..half) && !is_inked(42..55, half + 1..width), "the second paragraph");
    }
}
