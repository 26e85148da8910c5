//! The map of contributors: the render, beside it every pixel in the colours of whose photographs show it, and below a
//! legend with names and per cent.

use cairn_field::{CHANNELS, Mixed};
use cairn_scene::Picture;
use glam::DVec2;

use crate::export::drawing::{Drawing, LINE_PX, Shape};
use crate::export::words::{Colour, cut};

/// Colours of the contributors with the largest shares, told apart by people who see red and green alike (Okabe and Ito
/// 2008).
const COLOURS: [Colour; CHANNELS - 1] =
    [[230, 159, 0], [86, 180, 233], [0, 158, 115], [204, 121, 167], [240, 228, 66], [213, 94, 0], [0, 114, 178]];
/// All other photographs'.
const OTHERS_COLOUR: Colour = [150, 150, 150];
/// What no photograph shows, and what lies behind the scene.
const PAPER: Colour = [250, 250, 246];
/// Ink.
const INK: Colour = [40, 40, 40];
/// Room around things, px.
const GAP: usize = 8;
/// Least pixels across: a legend has names.
const MIN_WIDTH: usize = 420;
/// Pictures are shown about so many times as large as fit into so many pixels, or as they are.
const MIN_SIDE: usize = 256;

/// What a map shows.
pub(crate) struct WhoseMap<'a> {
    /// What is seen.
    pub(crate) render: &'a Picture,
    /// Each pixel's shares by group.
    pub(crate) pixels: &'a [Mixed],
    /// Names and shares of the contributors, largest share first: of all that is seen, or of the part that was asked
    /// about.
    pub(crate) contributors: &'a [(&'a str, f64)],
    /// The share of what was excluded,
    pub(crate) excluded: f64,
    /// and of what no photograph shows.
    pub(crate) nobodys: f64,
}

impl WhoseMap<'_> {
    /// The group of those who have no colour of their own.
    pub(crate) const OTHERS: usize = CHANNELS - 1;

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
        let mut put = |left: usize, colour: &dyn Fn(usize) -> [f32; 3]| {
            for at in 0..w * h {
                let to = 3 * ((at / w + GAP) * width + left + at % w);
                let own = at / w / times * self.render.width() + at % w / times;
                picture.rgb_mut()[to..to + 3].copy_from_slice(&colour(own));
            }
        };
        let across = self.render.width();
        put(GAP, &|at| self.render.pixel(at % across, at / across));
        put(2 * GAP + w, &|at| self.colour(at));
        picture
    }

    /// The colours of whose photographs show pixel `at`, by their shares; as dark as what is seen there.
    fn colour(&self, at: usize) -> [f32; 3] {
        let (pixel, width) = (&self.pixels[at], self.render.width());
        let [red, green, blue] = self.render.pixel(at % width, at / width);
        // Rec. 709's weights.
        let light = 0.4 + 0.6 * (0.2126 * red + 0.7152 * green + 0.0722 * blue);
        let all = COLOURS.iter().chain([&OTHERS_COLOUR]).zip(pixel.channels);
        let nobody = (1.0 - pixel.channels.iter().sum::<f32>()).max(0.0);
        let mut sum = PAPER.map(|v| nobody * f32::from(v) / 255.0);
        for (colour, share) in all {
            for (sum, v) in sum.iter_mut().zip(colour) {
                *sum += share * light * f32::from(*v) / 255.0;
            }
        }
        sum.map(|v| v.clamp(0.0, 1.0))
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
        if self.excluded > 0.0 {
            lines.push((OTHERS_COLOUR, format!("{}  photographs that were excluded", per_cent(self.excluded))));
        }
        lines.push((PAPER, format!("{}  nobody's: unseen, sky or background", per_cent(self.nobodys))));
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
        let groups = ["person-0", "person-6", "person-7", "person-9", "nobody"];
        assert_eq!(groups.map(|name| WhoseMap::group_of(&contributors, name)), [0, 6, 7, 7, WhoseMap::OTHERS]);
        let render = Picture::constant(2, 1, [1.0; 3]);
        let mut pixels = vec![Mixed::default(); 2];
        pixels[0].channels[1] = 1.0;
        pixels[1].behind = 1.0;
        let map =
            WhoseMap { render: &render, pixels: &pixels, contributors: &contributors, excluded: 0.0, nobodys: 0.5 };
        let near = |a: [f32; 3], b: Colour| a.iter().zip(b).all(|(a, b)| (a - f32::from(b) / 255.0).abs() < 1e-5);
        assert!(near(map.colour(0), COLOURS[1]) && near(map.colour(1), PAPER));
        let lines: Vec<String> = map.legend().into_iter().map(|(_, text)| text).collect();
        assert_eq!(lines.len(), 9);
        assert!(lines[0].contains("5.0 %  person-0") && lines[7].contains("15.0 %  3 others"), "{lines:?}");
        assert!(lines[8].contains("50.0 %  nobody's"), "{lines:?}");
        let picture = map.draw();
        // Two pixels, each 128 x 128 px large.
        assert_eq!((picture.width(), picture.height() > 128 + GAP), (2 * 256 + 3 * GAP, true));
        assert!(near(picture.pixel(2 * GAP + 256, GAP), COLOURS[1]));
        assert!(near(picture.pixel(2 * GAP + 256 + 127, GAP + 127), COLOURS[1]));
        assert!(near(picture.pixel(2 * GAP + 256 + 128, GAP), PAPER));
        assert_eq!(picture.pixel(GAP, GAP), [1.0; 3], "the render stands beside it");
    }
}
