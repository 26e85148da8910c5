//! The map of contributors: the render, beside it every pixel in the colour of whose photographs show most of it, and
//! below a legend with names and per cent.

use cairn_field::{CHANNELS, Mixed};
use cairn_scene::Picture;
use glam::DVec2;

use crate::export::drawing::{Drawing, LINE_PX, Shape};
use crate::export::words::{Colour, cut};

/// Colours of the contributors with the largest shares, told apart by people who see red and green alike (Okabe and Ito
/// 2008).
const COLOURS: [Colour; CHANNELS - 2] =
    [[230, 159, 0], [86, 180, 233], [0, 158, 115], [204, 121, 167], [240, 228, 66], [213, 94, 0]];
/// All other contributors' photographs.
const OTHERS_COLOUR: Colour = [150, 150, 150];
/// Photographs that were excluded.
const EXCLUDED_COLOUR: Colour = [120, 60, 60];
/// What no photograph shows.
const UNSEEN_COLOUR: Colour = [60, 60, 70];
/// What lies behind the scene.
const BEHIND_COLOUR: Colour = [225, 235, 245];
/// How far towards white a colour goes whose share of the pixel is next to none, 0 to 1.
const PALE: f32 = 0.75;
/// The page.
const PAPER: Colour = [250, 250, 246];
/// Ink.
const INK: Colour = [40, 40, 40];
/// Room around things, px.
const GAP: usize = 8;
/// Pixels across at least: a legend has names.
const MIN_WIDTH: usize = 420;
/// Pictures are shown about so many times as large as fit into so many pixels, or as they are.
const MIN_SIDE: usize = 256;

/// What a map shows.
pub(crate) struct WhoseMap<'a> {
    /// What is seen.
    pub(crate) render: &'a Picture,
    /// Shares by group, row-major, of as many pixels or of fewer: then each is a square of the map.
    pub(crate) pixels: &'a [Mixed],
    /// Of those, across.
    pub(crate) pixels_across: usize,
    /// Names and shares of the contributors, largest share first: of all that is seen, or of the part that was asked
    /// about.
    pub(crate) contributors: &'a [(&'a str, f64)],
    /// The share of photographs that were excluded,
    pub(crate) excluded: f64,
    /// of what no photograph shows,
    pub(crate) unseen: f64,
    /// and of what lies behind the scene.
    pub(crate) behind: f64,
}

impl WhoseMap<'_> {
    /// The group of those who have no colour of their own.
    pub(crate) const OTHERS: usize = CHANNELS - 2;
    /// The group of photographs that were excluded.
    pub(crate) const EXCLUDED: usize = CHANNELS - 1;

    /// The group of the contributor `name`: one each of those with the largest shares.
    pub(crate) fn group_of(contributors: &[(&str, f64)], name: &str) -> usize {
        contributors.iter().take(COLOURS.len()).position(|of| of.0 == name).unwrap_or(Self::OTHERS)
    }

    /// Draws it.
    pub(crate) fn draw(&self) -> Picture {
        // A small picture is shown larger, each of its pixels as a square.
        let times = (MIN_SIDE / self.render.width().max(self.render.height())).max(1);
        let (w, h) = (times * self.render.width(), times * self.render.height());
        let lines = self.legend();
        let width = (2 * w + 3 * GAP).max(MIN_WIDTH);
        let height = h + 3 * GAP + (lines.len() as f64 * LINE_PX).ceil() as usize;
        let mut shapes = Vec::new();
        for (n, (colour, text)) in lines.into_iter().enumerate() {
            let top = (h + 2 * GAP) as f64 + n as f64 * LINE_PX;
            let [left, side] = [GAP as f64, LINE_PX - 5.0];
            let corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)];
            let corners = corners.map(|(x, y)| DVec2::new(left + x, top + 2.0 + y)).to_vec();
            shapes.push(Shape::Polygon { corners, fill: Some((colour, 1.0)), line: Some((INK, 0.7)) });
            let room = width as f64 - left - LINE_PX - GAP as f64;
            let text = cut(&text, LINE_PX, room);
            shapes.push(Shape::Words { at: DVec2::new(left + LINE_PX + 2.0, top), text, colour: INK });
        }
        let mut picture = Drawing { width, height, paper: PAPER, shapes }.picture();
        let mut put = |left: usize, colour: &dyn Fn(usize, usize) -> [f32; 3]| {
            for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                let to = 3 * ((y + GAP) * width + left + x);
                picture.rgb_mut()[to..to + 3].copy_from_slice(&colour(x, y));
            }
        };
        put(GAP, &|x, y| self.render.pixel(x / times, y / times));
        let (colours, across) = (self.colours(), self.pixels_across);
        let down = colours.len() / across;
        put(2 * GAP + w, &|x, y| colours[y * down / h * across + x * across / w]);
        picture
    }

    /// The colour of what shows most of each pixel, the paler the smaller its share is beside the largest shares of the
    /// map.
    fn colours(&self) -> Vec<[f32; 3]> {
        let firsts: Vec<(Colour, f32)> = self.pixels.iter().map(|pixel| self.first(pixel)).collect();
        let mut shares: Vec<f32> =
            firsts.iter().filter(|(c, _)| COLOURS.contains(c)).map(|(_, share)| *share).collect();
        shares.sort_by(f32::total_cmp);
        let full = shares.get(shares.len() * 19 / 20).copied().unwrap_or(1.0);
        let shown = |(colour, share): (Colour, f32)| {
            let pale = PALE * (1.0 - (share / full).clamp(0.0, 1.0));
            colour.map(|v| pale + (1.0 - pale) * f32::from(v) / 255.0)
        };
        firsts.into_iter().map(shown).collect()
    }

    /// What shows most of a pixel, and its share: one of the contributors with a colour, where none of those without one
    /// shows more on average, or what is no contributor's.
    fn first(&self, pixel: &Mixed) -> (Colour, f32) {
        let attributed = pixel.channels.iter().sum::<f32>();
        let unseen = (1.0 - pixel.behind - attributed).max(0.0);
        let no_contributors = [(UNSEEN_COLOUR, unseen), (BEHIND_COLOUR, pixel.behind)];
        if let Some(largest) = no_contributors.into_iter().find(|(_, share)| *share > 0.5) {
            return largest;
        }
        let others = self.contributors.len().saturating_sub(COLOURS.len()).max(1) as f32;
        let own = COLOURS.into_iter().zip(pixel.channels);
        let rest =
            [(OTHERS_COLOUR, pixel.channels[Self::OTHERS] / others), (EXCLUDED_COLOUR, pixel.channels[Self::EXCLUDED])];
        own.chain(rest).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((UNSEEN_COLOUR, 1.0))
    }

    /// The lines of the legend.
    fn legend(&self) -> Vec<(Colour, String)> {
        let per_cent = |share: f64| format!("{:5.1} %", 100.0 * share);
        let all = self.contributors;
        let line = |((name, share), colour): (&(&str, f64), Colour)| (colour, format!("{}  {name}", per_cent(*share)));
        let mut lines: Vec<_> = all.iter().zip(COLOURS).map(line).collect();
        let rest: f64 = all.iter().skip(COLOURS.len()).map(|of| of.1).sum();
        match all.len().saturating_sub(COLOURS.len()) {
            0 => {}
            1 => lines.push((OTHERS_COLOUR, format!("{}  one other", per_cent(rest)))),
            more => lines.push((OTHERS_COLOUR, format!("{}  {more} others", per_cent(rest)))),
        }
        for (share, colour, what) in [
            (self.excluded, EXCLUDED_COLOUR, "photographs that were excluded"),
            (self.unseen, UNSEEN_COLOUR, "shown by no photograph"),
            (self.behind, BEHIND_COLOUR, "sky or background"),
        ] {
            if share >= 0.0005 {
                lines.push((colour, format!("{}  {what}", per_cent(share))));
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_has_the_colour_of_whose_it_is_and_a_legend_names_them() {
        let names: Vec<String> = (0..10).map(|n| format!("person-{n}")).collect();
        let contributors: Vec<(&str, f64)> = names.iter().map(|name| (name.as_str(), 0.05)).collect();
        let groups = ["person-0", "person-5", "person-6", "person-9", "not-there"];
        assert_eq!(groups.map(|name| WhoseMap::group_of(&contributors, name)), [0, 5, 6, 6, WhoseMap::OTHERS]);
        let render = Picture::constant(2, 1, [1.0; 3]);
        let mut pixels = vec![Mixed::default(); 2];
        (pixels[0].channels[1], pixels[0].channels[2]) = (0.6, 0.4);
        pixels[1].behind = 1.0;
        let (excluded, unseen, behind) = (0.0, 0.2, 0.3);
        let (pixels, pixels_across, contributors) = (&pixels, 2, &contributors);
        let map = WhoseMap { render: &render, pixels, pixels_across, contributors, excluded, unseen, behind };
        let near = |a: [f32; 3], b: Colour| a.iter().zip(b).all(|(a, b)| (a - f32::from(b) / 255.0).abs() < 1e-5);
        let colours = map.colours();
        assert!(near(colours[0], COLOURS[1]) && near(colours[1], BEHIND_COLOUR), "{colours:?}");
        // Four others show 0.1 each on average, less than one with a colour; with 0.3 each they show more.
        let shown = |named: f32, others: f32| {
            let mut pixel = Mixed::default();
            (pixel.channels[3], pixel.channels[WhoseMap::OTHERS]) = (named, others);
            map.first(&pixel).0
        };
        assert_eq!([shown(0.2, 0.4), shown(0.2, 1.2)], [COLOURS[3], OTHERS_COLOUR]);
        let lines: Vec<String> = map.legend().into_iter().map(|(_, text)| text).collect();
        assert!(lines[0].contains("5.0 %  person-0") && lines[6].contains("20.0 %  4 others"), "{lines:?}");
        assert!(lines[7].contains("20.0 %  shown by no photograph") && lines[8].contains("30.0 %  sky"), "{lines:?}");
        let picture = map.draw();
        // Two pixels, each 128 x 128 px large.
        assert_eq!((picture.width(), picture.height() > 128 + GAP), (2 * 256 + 3 * GAP, true));
        assert_eq!(picture.pixel(2 * GAP + 256, GAP), picture.pixel(2 * GAP + 256 + 127, GAP + 127));
        assert!(near(picture.pixel(2 * GAP + 256 + 128, GAP), BEHIND_COLOUR));
        assert_eq!(picture.pixel(GAP, GAP), [1.0; 3], "the render stands beside it");
    }
}
