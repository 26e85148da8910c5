//! Small line charts as SVG: text that versions well, from a page of code
//! instead of a plotting library.

use std::fmt::Write as _;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
/// Left, right, top, bottom.
const MARGINS: (f64, f64, f64, f64) = (70.0, 150.0, 40.0, 55.0);
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

/// A line of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// What the legend says.
    pub name: String,
    /// (x, y), drawn in this order. Points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

/// A chart of several lines as an SVG document. The same input gives the same
/// bytes; without a single point that can be drawn it says so.
pub fn line_chart(title: &str, x: &Axis, y: &Axis, series: &[Series]) -> String {
    let drawable: Vec<Vec<(f64, f64)>> = series
        .iter()
        .map(|s| s.points.iter().filter_map(|&(a, b)| Some((place(a, x.scale)?, place(b, y.scale)?))).collect())
        .collect();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    text(&mut svg, WIDTH / 2.0, 22.0, "middle", title);
    let (left, right, top, bottom) = MARGINS;
    let (Some(xs), Some(ys)) =
        (span(drawable.iter().flatten().map(|p| p.0)), span(drawable.iter().flatten().map(|p| p.1)))
    else {
        text(&mut svg, WIDTH / 2.0, HEIGHT / 2.0, "middle", "nothing to draw");
        return svg + "</svg>\n";
    };
    let across = |v: f64| left + (v - xs.0) / (xs.1 - xs.0) * (WIDTH - left - right);
    let down = |v: f64| HEIGHT - bottom - (v - ys.0) / (ys.1 - ys.0) * (HEIGHT - top - bottom);
    for (at, label) in ticks(xs, x.scale) {
        line(&mut svg, (across(at), top), (across(at), HEIGHT - bottom), "#ddd");
        text(&mut svg, across(at), HEIGHT - bottom + 16.0, "middle", &label);
    }
    for (at, label) in ticks(ys, y.scale) {
        line(&mut svg, (left, down(at)), (WIDTH - right, down(at)), "#ddd");
        text(&mut svg, left - 6.0, down(at) + 4.0, "end", &label);
    }
    text(&mut svg, (left + WIDTH - right) / 2.0, HEIGHT - 14.0, "middle", &x.title);
    let middle = (top + HEIGHT - bottom) / 2.0;
    let _ = writeln!(
        svg,
        "<text transform=\"translate(16 {middle}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        escaped(&y.title)
    );
    for (index, (points, named)) in drawable.iter().zip(series).enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let path: Vec<String> = points.iter().map(|p| format!("{:.2},{:.2}", across(p.0), down(p.1))).collect();
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            path.join(" ")
        );
        for p in points {
            let _ = writeln!(
                svg,
                "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"2.5\" fill=\"{colour}\"/>",
                across(p.0),
                down(p.1)
            );
        }
        let row = top + 10.0 + 18.0 * index as f64;
        line(&mut svg, (WIDTH - right + 10.0, row - 4.0), (WIDTH - right + 30.0, row - 4.0), colour);
        text(&mut svg, WIDTH - right + 36.0, row, "start", &named.name);
    }
    svg + "</svg>\n"
}

/// A value on its axis: itself or its logarithm; `None` where it has no place.
fn place(value: f64, scale: Scale) -> Option<f64> {
    let at = match scale {
        Scale::Linear => value,
        Scale::Log if value > 0.0 => value.log10(),
        Scale::Log => return None,
    };
    at.is_finite().then_some(at)
}

/// Smallest and largest, with a little air; never of no extent.
fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return None;
    }
    let air = if low == high { low.abs().max(1.0) * 0.1 } else { (high - low) * 0.05 };
    Some((low - air, high + air))
}

/// Where lines of the grid go, and what they say: steps of 1, 2 or 5 times a
/// power of ten; on a logarithmic axis of some decades, the powers of ten.
fn ticks((low, high): (f64, f64), scale: Scale) -> Vec<(f64, String)> {
    let raw = (high - low) / 6.5;
    let unit = 10f64.powf(raw.log10().floor());
    let mut step = [1.0, 2.0, 5.0, 10.0].iter().map(|m| m * unit).find(|s| *s >= raw).unwrap_or(10.0 * unit);
    if scale == Scale::Log && high - low > 2.0 {
        step = step.max(1.0).round();
    }
    let first = (low / step).ceil() as i64;
    let digits = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
    let at = (first..).map(|k| k as f64 * step).take_while(|v| *v <= high).take(20);
    at.map(|v| match scale {
        Scale::Linear => (v, format!("{v:.digits$}")),
        Scale::Log => {
            let value = 10f64.powf(v);
            let digits = (1.0 - v.floor()).clamp(0.0, 12.0) as usize;
            let text = format!("{value:.digits$}");
            let short = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
            (v, short.to_owned())
        }
    })
    .collect()
}

fn text(svg: &mut String, x: f64, y: f64, anchor: &str, content: &str) {
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>", escaped(content));
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

    fn axis(title: &str, scale: Scale) -> Axis {
        Axis { title: title.into(), scale }
    }

    #[test]
    fn points_that_have_no_place_are_left_out() {
        let points = vec![(0.0, 1.0), (1.0, 10.0), (10.0, f64::NAN), (100.0, 1000.0)];
        let series = [Series { name: "a < b".into(), points }];
        let svg = line_chart("t & u", &axis("x", Scale::Log), &axis("y", Scale::Log), &series);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains("a &lt; b") && svg.contains("t &amp; u") && !svg.contains("NaN"));
        let empty = line_chart("t", &axis("x", Scale::Linear), &axis("y", Scale::Linear), &[]);
        assert!(empty.contains("nothing to draw") && empty.ends_with("</svg>\n"));
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        let labels = |span, scale| ticks(span, scale).into_iter().map(|(_, l)| l).collect::<Vec<_>>();
        assert_eq!(labels((-0.1, 1.1), Scale::Linear), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels((-1.1, 2.2), Scale::Log), ["0.1", "1", "10", "100"]);
        let one = line_chart(
            "one point",
            &axis("x", Scale::Linear),
            &axis("y", Scale::Linear),
            &[Series { name: "s".into(), points: vec![(3.0, 3.0)] }],
        );
        assert!(!one.contains("NaN") && !one.contains("inf"));
    }
}
