//! Small charts as SVG: text that versions well, from two pages of code instead
//! of a plotting library.

mod ticks;

use std::fmt::Write as _;

use ticks::{Ticks, place, span};

/// The area that is drawn into, px.
const PLOT: (f64, f64) = (520.0, 330.0);
/// Room left of it, above it and below it, px.
const MARGINS: (f64, f64, f64) = (72.0, 58.0, 52.0);
/// Between the area and the legend, and from there to the names, px.
const LEGEND: (f64, f64) = (14.0, 30.0);
/// What a letter of the legend takes, px.
const LETTER: f64 = 6.6;
/// Height of a label, px.
const LINE: f64 = 12.0;
/// Okabe and Ito's palette, told apart by colour-blind readers too.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// How an axis is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By powers of ten; points at or below zero are left out.
    Log,
}

/// An axis: its title, with unit, and its scale.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Such as `time, s`.
    pub title: String,
    /// How it is divided.
    pub scale: Scale,
}

impl Axis {
    /// An axis of evenly spaced values.
    pub fn linear(title: &str) -> Self {
        Self { title: title.into(), scale: Scale::Linear }
    }

    /// An axis of powers of ten.
    pub fn log(title: &str) -> Self {
        Self { title: title.into(), scale: Scale::Log }
    }
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Points joined by a line.
    Line,
    /// Hollow diamonds, not joined: places on the chart that are no measurements.
    Marks,
}

/// A place on a chart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point {
    /// Across, in the x axis's unit.
    pub x: f64,
    /// Up, in the y axis's unit.
    pub y: f64,
    /// What stands beside it, where there is room; may be empty.
    pub label: String,
    /// Whether a ring is drawn around it.
    pub ring: bool,
}

/// A line of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// What the legend says.
    pub name: String,
    /// Drawn in this order. Points that are not finite are left out.
    pub points: Vec<Point>,
    /// Line or marks.
    pub look: Look,
}

/// A level drawn across the whole chart.
#[derive(Clone, Debug)]
pub struct Level {
    /// Where, in the y axis's unit.
    pub y: f64,
    /// What stands on it.
    pub label: String,
}

/// A chart of several series.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Its heading.
    pub title: String,
    /// A line below that says how to read it; may be empty.
    pub subtitle: String,
    /// Across.
    pub x: Axis,
    /// Up.
    pub y: Axis,
    /// What is drawn, in the legend's order.
    pub series: Vec<Series>,
    /// Levels to compare with; they do not stretch the axes.
    pub levels: Vec<Level>,
}

/// The chart's frame: where values land, px.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn across(&self, v: f64) -> f64 {
        MARGINS.0 + (v - self.x.0) / (self.x.1 - self.x.0) * PLOT.0
    }

    fn down(&self, v: f64) -> f64 {
        MARGINS.1 + PLOT.1 - (v - self.y.0) / (self.y.1 - self.y.0) * PLOT.1
    }
}

/// A point that has a place, in the axes' own divisions.
struct Placed<'a> {
    x: f64,
    y: f64,
    point: &'a Point,
}

impl Chart {
    /// The chart as an SVG document. Equal charts give equal bytes; without a
    /// single point that can be drawn it says so.
    pub fn to_svg(&self) -> String {
        let placed: Vec<Vec<Placed<'_>>> = self.series.iter().map(|s| self.placed(s)).collect();
        let letters = self.series.iter().map(|s| s.name.chars().count()).max().unwrap_or(0) as f64;
        let width = (MARGINS.0 + PLOT.0 + LEGEND.0 + LEGEND.1 + letters * LETTER + 10.0).ceil();
        let height = MARGINS.1 + PLOT.1 + MARGINS.2;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"22\" font-size=\"15\" font-weight=\"bold\">{}</text>",
            MARGINS.0,
            escaped(&self.title)
        );
        text(&mut svg, (MARGINS.0, 41.0), ("start", "#555"), &self.subtitle);
        let spans = (span(placed.iter().flatten().map(|p| p.x)), span(placed.iter().flatten().map(|p| p.y)));
        let (Some(x), Some(y)) = spans else {
            text(&mut svg, (width / 2.0, height / 2.0), ("middle", "#000"), "nothing to draw");
            return svg + "</svg>\n";
        };
        let frame = Frame { x, y };
        self.axes(&mut svg, &frame);
        self.draw_levels(&mut svg, &frame);
        for (index, (points, series)) in placed.iter().zip(&self.series).enumerate() {
            let colour = colour(index, series.look);
            draw(&mut svg, &frame, points, series.look, colour);
            legend(&mut svg, index, &series.name, series.look, colour);
        }
        self.labels(&mut svg, &frame, &placed);
        svg + "</svg>\n"
    }

    fn placed<'a>(&self, series: &'a Series) -> Vec<Placed<'a>> {
        let at = |p: &'a Point| Some(Placed { x: place(p.x, self.x.scale)?, y: place(p.y, self.y.scale)?, point: p });
        series.points.iter().filter_map(at).collect()
    }

    fn axes(&self, svg: &mut String, frame: &Frame) {
        let (left, top) = (MARGINS.0, MARGINS.1);
        let (right, bottom) = (left + PLOT.0, top + PLOT.1);
        let Ticks { labelled, fine } = ticks::ticks(frame.x, self.x.scale);
        fine.iter().for_each(|at| line(svg, (frame.across(*at), top), (frame.across(*at), bottom), "#f0f0f0"));
        for (at, label) in labelled {
            line(svg, (frame.across(at), top), (frame.across(at), bottom), "#d8d8d8");
            text(svg, (frame.across(at), bottom + 17.0), ("middle", "#000"), &label);
        }
        let Ticks { labelled, fine } = ticks::ticks(frame.y, self.y.scale);
        fine.iter().for_each(|at| line(svg, (left, frame.down(*at)), (right, frame.down(*at)), "#f0f0f0"));
        for (at, label) in labelled {
            line(svg, (left, frame.down(at)), (right, frame.down(at)), "#d8d8d8");
            text(svg, (left - 7.0, frame.down(at) + 4.0), ("end", "#000"), &label);
        }
        line(svg, (left, bottom), (right, bottom), "#333");
        line(svg, (left, top), (left, bottom), "#333");
        text(svg, ((left + right) / 2.0, bottom + 40.0), ("middle", "#000"), &self.x.title);
        let _ = writeln!(
            svg,
            "<text transform=\"translate(18 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            (top + bottom) / 2.0,
            escaped(&self.y.title)
        );
    }

    /// Writes the points' labels, those of ringed points first. One that would cover
    /// another is left out: a label that cannot be read says less than none.
    fn labels(&self, svg: &mut String, frame: &Frame, placed: &[Vec<Placed<'_>>]) {
        let points = placed.iter().flatten().map(|p| Place::of_mark(frame.across(p.x), frame.down(p.y)));
        let mut taken: Vec<Place> = points.collect();
        for (place, label) in self.levels.iter().filter_map(|level| Some((level.place(self.y.scale, frame)?, level))) {
            place.write(svg, "#666", &label.label);
            taken.push(place);
        }
        for ringed in [true, false] {
            for (index, (points, series)) in placed.iter().zip(&self.series).enumerate() {
                for p in points.iter().filter(|p| p.point.ring == ringed && !p.point.label.is_empty()) {
                    let at = (frame.across(p.x), frame.down(p.y));
                    let Some(place) = Place::free(at, &p.point.label, &taken) else { continue };
                    place.write(svg, colour(index, series.look), &p.point.label);
                    taken.push(place);
                }
            }
        }
    }

    fn draw_levels(&self, svg: &mut String, frame: &Frame) {
        for level in &self.levels {
            let Some(y) = place(level.y, self.y.scale).filter(|y| (frame.y.0..=frame.y.1).contains(y)) else {
                continue;
            };
            let y = frame.down(y);
            let _ = writeln!(
                svg,
                "<line x1=\"{:.2}\" y1=\"{y:.2}\" x2=\"{:.2}\" y2=\"{y:.2}\" stroke=\"#888\" stroke-dasharray=\"5 4\"/>",
                MARGINS.0,
                MARGINS.0 + PLOT.0
            );
        }
    }
}

impl Level {
    /// Where it is drawn, px; `None` where the chart does not reach.
    fn down(&self, scale: Scale, frame: &Frame) -> Option<f64> {
        let y = place(self.y, scale).filter(|y| (frame.y.0..=frame.y.1).contains(y))?;
        Some(frame.down(y))
    }

    /// Where its label stands: on it, at the right end.
    fn place(&self, scale: Scale, frame: &Frame) -> Option<Place> {
        let width = Place::width(&self.label);
        Some(Place { x: MARGINS.0 + PLOT.0 - width, y: self.down(scale, frame)? - 4.0, width })
    }
}

fn colour(index: usize, look: Look) -> &'static str {
    match look {
        Look::Line => COLOURS[index % COLOURS.len()],
        Look::Marks => "#555",
    }
}

fn draw(svg: &mut String, frame: &Frame, points: &[Placed<'_>], look: Look, colour: &str) {
    if look == Look::Line {
        let path: Vec<String> =
            points.iter().map(|p| format!("{:.2},{:.2}", frame.across(p.x), frame.down(p.y))).collect();
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            path.join(" ")
        );
    }
    for p in points {
        let (x, y) = (frame.across(p.x), frame.down(p.y));
        mark(svg, (x, y), look, colour);
        if p.point.ring {
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"7\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>"
            );
        }
    }
}

/// Where a label stands: left, baseline and width, px.
#[derive(Clone, Copy)]
struct Place {
    x: f64,
    y: f64,
    width: f64,
}

impl Place {
    /// What a label takes across.
    fn width(label: &str) -> f64 {
        label.chars().count() as f64 * LETTER + 2.0
    }

    /// What a point's own mark takes.
    fn of_mark(x: f64, y: f64) -> Self {
        Self { x: x - 4.0, y: y + 4.0, width: 8.0 }
    }

    /// The first place beside the point at `x`, `y` that is on the chart and free.
    fn free((x, y): (f64, f64), label: &str, taken: &[Self]) -> Option<Self> {
        let width = Self::width(label);
        let sides = [(8.0, -6.0), (8.0, 15.0), (-8.0 - width, -6.0), (-8.0 - width, 15.0), (-width / 2.0, -11.0)];
        let places = sides.map(|(dx, dy)| Self { x: x + dx, y: y + dy, width });
        places.into_iter().find(|place| place.is_on_the_chart() && !taken.iter().any(|other| place.covers(other)))
    }

    fn is_on_the_chart(&self) -> bool {
        let across = self.x >= MARGINS.0 && self.x + self.width <= MARGINS.0 + PLOT.0;
        across && self.y - LINE >= MARGINS.1 - 6.0 && self.y <= MARGINS.1 + PLOT.1
    }

    fn covers(&self, other: &Self) -> bool {
        (self.y - other.y).abs() < LINE && self.x < other.x + other.width && other.x < self.x + self.width
    }

    /// In white first, so that lines behind it do not strike it out.
    fn write(&self, svg: &mut String, colour: &str, label: &str) {
        let (x, y, label) = (self.x, self.y, escaped(label));
        let _ = writeln!(
            svg,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" stroke=\"white\" stroke-width=\"3\" stroke-linejoin=\"round\">{label}</text>\n<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\">{label}</text>"
        );
    }
}

fn mark(svg: &mut String, (x, y): (f64, f64), look: Look, colour: &str) {
    let _ = match look {
        Look::Line => writeln!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"3\" fill=\"{colour}\"/>"),
        Look::Marks => writeln!(
            svg,
            "<path d=\"M{:.2} {y:.2}L{x:.2} {:.2}L{:.2} {y:.2}L{x:.2} {:.2}Z\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
            x - 5.0,
            y - 5.0,
            x + 5.0,
            y + 5.0
        ),
    };
}

fn legend(svg: &mut String, index: usize, name: &str, look: Look, colour: &str) {
    let (x, y) = (MARGINS.0 + PLOT.0 + LEGEND.0, MARGINS.1 + 10.0 + 20.0 * index as f64);
    if look == Look::Line {
        let _ = writeln!(
            svg,
            "<line x1=\"{x:.2}\" y1=\"{y:.2}\" x2=\"{:.2}\" y2=\"{y:.2}\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            x + 22.0
        );
    }
    mark(svg, (x + 11.0, y), look, colour);
    text(svg, (x + LEGEND.1, y + 4.0), ("start", "#000"), name);
}

fn text(svg: &mut String, (x, y): (f64, f64), (anchor, colour): (&str, &str), content: &str) {
    if !content.is_empty() {
        let content = escaped(content);
        let _ = writeln!(
            svg,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" fill=\"{colour}\">{content}</text>"
        );
    }
}

fn line(svg: &mut String, from: (f64, f64), to: (f64, f64), colour: &str) {
    let _ = writeln!(
        svg,
        "<line x1=\"{:.2}\" y1=\"{:.2}\" x2=\"{:.2}\" y2=\"{:.2}\" stroke=\"{colour}\"/>",
        from.0, from.1, to.0, to.1
    );
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(scale: Scale, points: &[(f64, f64)]) -> Chart {
        let points = points.iter().map(|&(x, y)| Point { x, y, ..Point::default() }).collect();
        let axis = |title: &str| Axis { title: title.into(), scale };
        Chart {
            title: "t & u".into(),
            subtitle: String::new(),
            x: axis("x"),
            y: axis("y"),
            series: vec![Series { name: "a < b".into(), points, look: Look::Line }],
            levels: vec![Level { y: 20.0, label: "a level".into() }, Level { y: 1e9, label: "out of sight".into() }],
        }
    }

    /// Circles: one a point, and one in the legend.
    fn dots(svg: &str) -> usize {
        svg.matches("<circle").count()
    }

    #[test]
    fn points_that_have_no_place_are_left_out() {
        let points = [(0.0, 1.0), (1.0, 10.0), (10.0, f64::NAN), (100.0, 1000.0)];
        let svg = chart(Scale::Log, &points).to_svg();
        assert_eq!(dots(&svg), 2 + 1);
        assert!(svg.contains("a &lt; b") && svg.contains("t &amp; u") && !svg.contains("NaN"));
        assert!(svg.contains("a level") && !svg.contains("out of sight"));
        let empty = chart(Scale::Linear, &[]).to_svg();
        assert!(empty.contains("nothing to draw") && empty.ends_with("</svg>\n"));
    }

    #[test]
    fn a_single_point_labels_rings_and_marks_are_drawn() {
        let mut one = chart(Scale::Linear, &[(3.0, 3.0)]);
        one.series[0].points[0] = Point { x: 3.0, y: 3.0, label: "here".into(), ring: true };
        let svg = one.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains(">here<"));
        assert_eq!(dots(&svg), 2 + 1, "the point, its ring and the legend");
        one.series[0].look = Look::Marks;
        assert_eq!(one.to_svg().matches("<path").count(), 2);
    }

    #[test]
    fn labels_that_would_cover_each_other_are_left_out() {
        let mut crowd = chart(Scale::Linear, &[(0.0, 0.0), (9.0, 9.0)]);
        let near = (0..9).map(|i| Point { x: 5.0, y: 5.0, label: format!("label {i}"), ring: i == 8 });
        crowd.series[0].points.extend(near);
        let svg = crowd.to_svg();
        assert!(svg.contains(">label 8<"), "that of the ringed point stays");
        // Each is written twice.
        assert!((4..=10).contains(&svg.matches(">label ").count()), "{svg}");
    }
}
