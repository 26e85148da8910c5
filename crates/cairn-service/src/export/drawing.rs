//! Drawings of lines, polygons, dots and words, as SVG or as a picture. One list
//! of shapes and two ways to put it down, so that both show the same.

use std::fmt::Write as _;

use cairn_landmark::font;
use cairn_scene::Picture;
use glam::DVec2;

/// Samples of a pixel across and down: edges are soft, words stay sharp.
const FINE: usize = 3;
/// Pixels of a letter's dot.
const DOT_PX: usize = 2;
/// The words' letter height, px.
pub const LETTER_PX: f64 = (font::LINE * DOT_PX) as f64;

/// Red, green, blue.
pub type Colour = [u8; 3];

/// A shape; places are px from the top left corner.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A closed polygon, filled where there is a fill, then drawn around.
    Polygon {
        /// Its corners.
        corners: Vec<DVec2>,
        /// What fills it, and how strongly, 0 to 1.
        fill: Option<(Colour, f64)>,
        /// Its outline and the line's width, px.
        line: Option<(Colour, f64)>,
    },
    /// A line.
    Line {
        /// From where to where.
        ends: [DVec2; 2],
        /// Its colour.
        colour: Colour,
        /// Its width, px.
        width: f64,
    },
    /// A disc.
    Dot {
        /// Its middle.
        at: DVec2,
        /// Its radius, px.
        radius: f64,
        /// Its colour.
        colour: Colour,
    },
    /// Words, their top left corner at a place.
    Words {
        /// Where.
        at: DVec2,
        /// What. The picture has capital letters, digits and common signs.
        text: String,
        /// Their colour.
        colour: Colour,
    },
}

/// Shapes on paper, the later ones on top.
#[derive(Clone, Debug)]
pub struct Drawing {
    /// Pixels across, 1 and up.
    pub width: usize,
    /// Pixels down, 1 and up.
    pub height: usize,
    /// The paper.
    pub paper: Colour,
    /// What is on it.
    pub shapes: Vec<Shape>,
}

impl Drawing {
    /// The drawing as a picture.
    pub fn picture(&self) -> Picture {
        let mut fine = Fine::new(self);
        for shape in &self.shapes {
            match shape {
                Shape::Polygon { corners, fill, line } => {
                    if let Some((colour, strength)) = fill {
                        fine.fill(corners, *colour, *strength);
                    }
                    if let Some((colour, width)) = line {
                        for (i, from) in corners.iter().enumerate() {
                            fine.line(*from, corners[(i + 1) % corners.len()], *colour, *width);
                        }
                    }
                }
                Shape::Line { ends: [from, to], colour, width } => fine.line(*from, *to, *colour, *width),
                Shape::Dot { at, radius, colour } => fine.line(*at, *at, *colour, 2.0 * radius),
                Shape::Words { .. } => {}
            }
        }
        let mut picture = fine.averaged();
        for shape in &self.shapes {
            if let Shape::Words { at, text, colour } = shape {
                let (left, top) = (at.x.round().max(0.0) as usize, at.y.round().max(0.0) as usize);
                font::draw_text(&mut picture, text, left, top, DOT_PX, colour.map(|v| f32::from(v) / 255.0));
            }
        }
        picture
    }

    /// The drawing as an SVG document.
    pub fn svg(&self) -> String {
        let (w, h, paper) = (self.width, self.height, hex(self.paper));
        // Writing into a string cannot fail, here and below.
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" font-family=\"monospace\" font-size=\"17\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"{paper}\"/>\n"
        );
        for shape in &self.shapes {
            match shape {
                Shape::Polygon { corners, fill, line } => {
                    let corners: Vec<String> = corners.iter().map(|c| format!("{:.2},{:.2}", c.x, c.y)).collect();
                    let fill = fill.map_or("none".to_owned(), |(c, s)| format!("{}\" fill-opacity=\"{s}", hex(c)));
                    let line = line.map_or("none".to_owned(), |(c, w)| format!("{}\" stroke-width=\"{w}", hex(c)));
                    let _ =
                        writeln!(svg, "<polygon points=\"{}\" fill=\"{fill}\" stroke=\"{line}\"/>", corners.join(" "));
                }
                Shape::Line { ends: [a, b], colour, width } => {
                    let _ = writeln!(
                        svg,
                        "<line x1=\"{:.2}\" y1=\"{:.2}\" x2=\"{:.2}\" y2=\"{:.2}\" stroke=\"{}\" stroke-width=\"{width}\"/>",
                        a.x,
                        a.y,
                        b.x,
                        b.y,
                        hex(*colour)
                    );
                }
                Shape::Dot { at, radius, colour } => {
                    let _ = writeln!(
                        svg,
                        "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius}\" fill=\"{}\"/>",
                        at.x,
                        at.y,
                        hex(*colour)
                    );
                }
                Shape::Words { at, text, colour } => {
                    let escaped = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
                    let (x, y, colour) = (at.x, at.y + LETTER_PX, hex(*colour));
                    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\">{escaped}</text>");
                }
            }
        }
        svg + "</svg>\n"
    }
}

/// Pixels across of `text`.
pub fn words_width(text: &str) -> f64 {
    font::text_width(text, DOT_PX) as f64
}

fn hex(colour: Colour) -> String {
    format!("#{:02x}{:02x}{:02x}", colour[0], colour[1], colour[2])
}

/// The picture at several samples a pixel.
struct Fine {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Fine {
    fn new(drawing: &Drawing) -> Self {
        let (width, height) = (drawing.width * FINE, drawing.height * FINE);
        Self { width, height, rgb: drawing.paper.repeat(width * height) }
    }

    /// Rows and columns of samples between two places, px, as far as there are any.
    fn samples(&self, low: DVec2, high: DVec2) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let range = |low: f64, high: f64, most: usize| {
            let at = |v: f64| (v * FINE as f64).clamp(0.0, most as f64);
            at(low).floor() as usize..at(high).ceil() as usize
        };
        (range(low.y, high.y, self.height), range(low.x, high.x, self.width))
    }

    /// Lays `colour` over the samples between two places for which `inside` holds.
    fn paint(&mut self, (low, high): (DVec2, DVec2), colour: Colour, strength: f64, inside: impl Fn(DVec2) -> bool) {
        let (rows, columns) = self.samples(low, high);
        for y in rows {
            for x in columns.clone() {
                if inside(DVec2::new(x as f64 + 0.5, y as f64 + 0.5) / FINE as f64) {
                    let at = (y * self.width + x) * 3;
                    for (old, new) in self.rgb[at..at + 3].iter_mut().zip(colour) {
                        let mixed = f64::from(*old) + (f64::from(new) - f64::from(*old)) * strength;
                        *old = mixed.round() as u8;
                    }
                }
            }
        }
    }

    /// A line with round ends.
    fn line(&mut self, from: DVec2, to: DVec2, colour: Colour, width: f64) {
        let (way, half) = (to - from, width / 2.0);
        let long = way.length_squared();
        let inside = |p: DVec2| {
            let t = if long > 0.0 { ((p - from).dot(way) / long).clamp(0.0, 1.0) } else { 0.0 };
            (p - from - way * t).length_squared() <= half * half
        };
        self.paint((from.min(to) - half, from.max(to) + half), colour, 1.0, inside);
    }

    /// A polygon's inside, by the even-odd rule.
    fn fill(&mut self, corners: &[DVec2], colour: Colour, strength: f64) {
        let Some(first) = corners.first() else { return };
        let (low, high) = corners.iter().fold((*first, *first), |(l, h), c| (l.min(*c), h.max(*c)));
        let inside = |p: DVec2| {
            let crossed = |i: usize| {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y)
            };
            (0..corners.len()).filter(|i| crossed(*i)).count() % 2 == 1
        };
        self.paint((low, high), colour, strength, inside);
    }

    fn averaged(&self) -> Picture {
        let (width, height) = (self.width / FINE, self.height / FINE);
        let mut picture = Picture::constant(width, height, [0.0; 3]);
        let scale = 1.0 / (255 * FINE * FINE) as f32;
        for (y, row) in self.rgb.chunks_exact(self.width * 3).enumerate() {
            for (x, sample) in row.chunks_exact(3).enumerate() {
                let at = (y / FINE * width + x / FINE) * 3;
                for (sum, value) in picture.rgb_mut()[at..at + 3].iter_mut().zip(sample) {
                    *sum += f32::from(*value) * scale;
                }
            }
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing(shapes: Vec<Shape>) -> Drawing {
        Drawing { width: 40, height: 30, paper: [255; 3], shapes }
    }

    #[test]
    fn shapes_land_where_they_should_and_are_cut_at_the_edge() {
        let red = [255, 0, 0];
        let square = [(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)].map(|(x, y)| DVec2::new(x, y));
        let picture = drawing(vec![
            Shape::Polygon { corners: square.to_vec(), fill: Some((red, 1.0)), line: None },
            Shape::Dot { at: DVec2::new(30.5, 5.5), radius: 3.0, colour: [0, 0, 255] },
            Shape::Line { ends: [DVec2::new(-50.0, 25.5), DVec2::new(90.0, 25.5)], colour: [0; 3], width: 1.0 },
        ])
        .picture();
        let near = |x, y, colour: [f32; 3]| {
            picture.pixel(x, y).iter().zip(colour).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-3)
        };
        assert!(near(15, 15, [1.0, 0.0, 0.0]) && near(10, 19, [1.0, 0.0, 0.0]) && near(9, 15, [1.0; 3]));
        assert!(near(30, 5, [0.0, 0.0, 1.0]) && near(35, 5, [1.0; 3]));
        assert!(near(0, 25, [0.0; 3]) && near(39, 25, [0.0; 3]) && near(20, 27, [1.0; 3]));
    }

    #[test]
    fn the_svg_has_every_shape_and_escapes_names() {
        let at = DVec2::new(3.0, 4.0);
        let svg = drawing(vec![
            Shape::Words { at, text: "a<b & \"c\"".into(), colour: [1, 2, 3] },
            Shape::Dot { at, radius: 1.0, colour: [255; 3] },
            Shape::Polygon { corners: vec![at], fill: None, line: Some(([0; 3], 1.5)) },
        ])
        .svg();
        assert!(svg.contains("a&lt;b &amp; \"c\"</text>") && svg.contains("<circle") && svg.contains("fill=\"none\""));
        assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n") && svg.contains("#010203"));
    }
}
