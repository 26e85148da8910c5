//! Charts of what was measured, as SVG: lines with a point for each measurement.

use std::path::Path;

use anyhow::anyhow;
use plotters::prelude::{
    ChartBuilder, Circle, Color, IntoDrawingArea, LineSeries, RGBColor, SVGBackend, SeriesLabelPosition, WHITE,
};

use crate::file;

/// A chart's size, px.
const SIZE: (u32, u32) = (900, 560);
/// Far apart from each other, for colour-blind readers too (Okabe and Ito's).
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// An axis, its unit in its name.
#[derive(Clone, Copy, Debug)]
pub struct Axis<'a> {
    /// What stands beside it.
    pub name: &'a str,
    /// Whether equal distances are equal ratios.
    pub is_log: bool,
}

impl Axis<'_> {
    fn place(&self, value: f64) -> f64 {
        if self.is_log { value.max(1e-12).log10() } else { value }
    }

    fn label(&self, place: f64) -> String {
        let value = if self.is_log { 10f64.powf(place) } else { place };
        match value.abs() {
            size if size >= 10_000.0 || (size > 0.0 && size < 0.01) => format!("{value:.0e}"),
            size if size >= 10.0 => format!("{value:.0}"),
            _ => format!("{value:.2}"),
        }
    }
}

/// A line of measurements.
#[derive(Clone, Debug)]
pub struct Line {
    /// What the legend calls it.
    pub name: String,
    /// Its points, from left to right.
    pub points: Vec<[f64; 2]>,
}

/// Draws `lines` into the file `path`; points that are not finite are left out.
///
/// # Errors
/// For a chart without a point, and a file that cannot be written.
pub fn draw(path: &Path, title: &str, x: Axis<'_>, y: Axis<'_>, lines: &[Line]) -> anyhow::Result<()> {
    let place = |line: &Line| -> Vec<(f64, f64)> {
        let finite = line.points.iter().filter(|point| point.iter().all(|v| v.is_finite()));
        finite.map(|[across, up]| (x.place(*across), y.place(*up))).collect()
    };
    let placed: Vec<Vec<(f64, f64)>> = lines.iter().map(place).collect();
    let all = || placed.iter().flatten();
    anyhow::ensure!(all().next().is_some(), "the chart {} has no point", path.display());
    let range = |of: fn(&(f64, f64)) -> f64| {
        let low = all().map(of).fold(f64::INFINITY, f64::min);
        let high = all().map(of).fold(f64::NEG_INFINITY, f64::max);
        let room = ((high - low) * 0.05).max(0.01);
        low - room..high + room
    };
    let mut svg = String::new();
    {
        let wrong = |e: &dyn std::fmt::Display| anyhow!("cannot draw {}: {e}", path.display());
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(|e| wrong(&e))?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, ("sans-serif", 22))
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(range(|point| point.0), range(|point| point.1))
            .map_err(|e| wrong(&e))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc(x.name)
            .y_desc(y.name)
            .x_label_formatter(&|place| x.label(*place))
            .y_label_formatter(&|place| y.label(*place))
            .draw()
            .map_err(|e| wrong(&e))?;
        for (at, (line, points)) in lines.iter().zip(&placed).enumerate() {
            let colour = COLOURS[at % COLOURS.len()];
            chart
                .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))
                .map_err(|e| wrong(&e))?
                .label(&line.name)
                .legend(move |(left, top)| Circle::new((left + 8, top), 4, colour.filled()));
            let dots = points.iter().map(|point| Circle::new(*point, 3, colour.filled()));
            chart.draw_series(dots).map_err(|e| wrong(&e))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(RGBColor(190, 190, 186))
            .draw()
            .map_err(|e| wrong(&e))?;
        area.present().map_err(|e| wrong(&e))?;
    }
    file::write(path, svg.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_names_its_axes_and_lines_and_leaves_out_what_is_not_finite() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.svg");
        let lines = [
            Line { name: "fern & lego".into(), points: vec![[1.0, 20.0], [10.0, 25.0], [f64::NAN, 1.0]] },
            Line { name: "trex".into(), points: vec![[100.0, 22.0]] },
        ];
        let x = Axis { name: "Training, s", is_log: true };
        draw(&path, "What a budget gives", x, Axis { name: "PSNR, dB", is_log: false }, &lines).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for wanted in ["Training, s", "PSNR, dB", "What a budget gives", "fern &amp; lego", "trex"] {
            assert!(svg.contains(wanted), "no {wanted}: {svg}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert!(draw(&path, "", x, x, &[]).is_err());
    }
}
