//! Drawings of lines, polygons, dots and words, as SVG or as a picture. One list of shapes and two backends, so that both
//! show the same.

use cairn_scene::Picture;
use glam::DVec2;
use plotters::coord::Shift;
use plotters::prelude::{
    BitMapBackend, Circle, Color, DrawingArea, DrawingAreaErrorKind, DrawingBackend, IntoDrawingArea, IntoFont,
    PathElement, Polygon, RGBColor, SVGBackend, ShapeStyle,
};

use crate::export::words::{self, Colour, Label};

/// Samples of a pixel across and down in a picture: edges are soft, words are sharp.
const FINE: usize = 3;
/// Units of an SVG document for a pixel: its places are whole numbers.
const SVG_UNITS: usize = 10;
/// The height of a line of words, px.
pub const LINE_PX: f64 = 17.0;

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
    /// A line of words, its top left corner at a place.
    Words {
        /// Where.
        at: DVec2,
        /// What.
        text: String,
        /// Their colour.
        colour: Colour,
    },
}

/// Shapes on paper, the later ones on top; words above all.
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
        let (width, height) = (self.width * FINE, self.height * FINE);
        let mut samples = self.paper.repeat(width * height);
        {
            let area = BitMapBackend::with_buffer(&mut samples, (width as u32, height as u32)).into_drawing_area();
            // Samples in memory take every shape: there is nothing that could fail.
            let _ = draw(&area, &self.shapes, FINE as f64).and_then(|()| area.present());
        }
        let mut picture = averaged(&samples, self.width, self.height);
        for shape in &self.shapes {
            if let Shape::Words { at, text, colour } = shape {
                let (text, height_px, colour) = (text.clone(), LINE_PX, *colour);
                words::write(&mut picture, &Label { text, left: at.x, top: at.y, height_px, colour });
            }
        }
        picture
    }

    /// The drawing as an SVG document.
    pub fn svg(&self) -> String {
        let (width, height) = ((self.width * SVG_UNITS) as u32, (self.height * SVG_UNITS) as u32);
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
            let words = self.shapes.iter().filter_map(|shape| match shape {
                Shape::Words { at, text, colour } => Some((at, text, colour)),
                _ => None,
            });
            // A string takes every shape: there is nothing that could fail.
            let drawn = area.fill(&rgb(self.paper)).and_then(|()| draw(&area, &self.shapes, SVG_UNITS as f64));
            let _ = drawn.and_then(|()| {
                for (at, text, colour) in words {
                    let style = ("sans-serif", LINE_PX * SVG_UNITS as f64).into_font().color(&rgb(*colour));
                    area.draw_text(text, &style, place(*at, SVG_UNITS as f64))?;
                }
                area.present()
            });
        }
        // The document's own units are finer than the pixels that it is to be shown at.
        let fine = format!("width=\"{width}\" height=\"{height}\"");
        svg.replacen(&fine, &format!("width=\"{}\" height=\"{}\"", self.width, self.height), 1)
    }
}

/// Pixels across of `text`.
pub fn words_width(text: &str) -> f64 {
    words::width_px(text, LINE_PX)
}

fn rgb([red, green, blue]: Colour) -> RGBColor {
    RGBColor(red, green, blue)
}

fn place(at: DVec2, scale: f64) -> (i32, i32) {
    ((at.x * scale).round() as i32, (at.y * scale).round() as i32)
}

/// A line of so many px.
fn stroke(colour: Colour, width: f64, scale: f64) -> ShapeStyle {
    rgb(colour).stroke_width((width * scale).round().max(1.0) as u32)
}

/// Draws all shapes but words, `scale` units a pixel.
fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    shapes: &[Shape],
    scale: f64,
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    for shape in shapes {
        match shape {
            Shape::Polygon { corners, fill, line } => {
                let mut corners: Vec<(i32, i32)> = corners.iter().map(|corner| place(*corner, scale)).collect();
                if let Some((colour, strength)) = fill {
                    area.draw(&Polygon::new(corners.clone(), rgb(*colour).mix(*strength).filled()))?;
                }
                if let Some((colour, width)) = line {
                    corners.extend(corners.first().copied());
                    area.draw(&PathElement::new(corners, stroke(*colour, *width, scale)))?;
                }
            }
            Shape::Line { ends, colour, width } => {
                let ends = ends.map(|end| place(end, scale)).to_vec();
                area.draw(&PathElement::new(ends, stroke(*colour, *width, scale)))?;
            }
            Shape::Dot { at, radius, colour } => {
                let radius = (radius * scale).round().max(1.0) as i32;
                area.draw(&Circle::new(place(*at, scale), radius, rgb(*colour).filled()))?;
            }
            Shape::Words { .. } => {}
        }
    }
    Ok(())
}

/// The mean of the samples of each pixel.
fn averaged(samples: &[u8], width: usize, height: usize) -> Picture {
    let mut picture = Picture::constant(width, height, [0.0; 3]);
    let scale = 1.0 / (255 * FINE * FINE) as f32;
    for (y, row) in samples.chunks_exact(width * FINE * 3).enumerate() {
        for (x, sample) in row.chunks_exact(3).enumerate() {
            let at = (y / FINE * width + x / FINE) * 3;
            for (sum, value) in picture.rgb_mut()[at..at + 3].iter_mut().zip(sample) {
                *sum += f32::from(*value) * scale;
            }
        }
    }
    picture
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
        assert!(near(15, 15, [1.0, 0.0, 0.0]) && near(12, 18, [1.0, 0.0, 0.0]) && near(8, 15, [1.0; 3]));
        assert!(near(30, 5, [0.0, 0.0, 1.0]) && near(35, 5, [1.0; 3]));
        let dark = |x: usize| (24..27).any(|y| picture.pixel(x, y)[0] < 0.7);
        assert!(dark(0) && dark(39) && near(20, 28, [1.0; 3]));
    }

    #[test]
    fn words_are_in_both_and_names_are_escaped() {
        let at = DVec2::new(3.0, 4.0);
        let drawing = drawing(vec![
            Shape::Words { at, text: "a<b & \"c\"".into(), colour: [1, 2, 3] },
            Shape::Dot { at, radius: 1.0, colour: [255; 3] },
            Shape::Polygon { corners: vec![at, at * 2.0, at * 3.0], fill: None, line: Some(([0; 3], 1.5)) },
        ]);
        let svg = drawing.svg();
        assert!(svg.contains("a&lt;b &amp; ") && svg.contains("<circle") && svg.contains("<polyline"), "{svg}");
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>") && svg.contains("#010203"), "{svg}");
        assert!(svg.contains("width=\"40\" height=\"30\"") && svg.contains("viewBox=\"0 0 400 300\""), "{svg}");
        assert!(drawing.picture().rgb().iter().any(|v| *v < 0.5));
    }
}
