//! The suite's two tables and the charts that are drawn from them. A run adds to
//! the tables in its folder, so that captures may be measured one by one.

use std::path::Path;

use cairn_eval::chart::{Axis, Chart, Level, Look, Point, Series};
use cairn_eval::table::Table;

use super::case::Case;
use super::outcome::Outcome;
use super::tradeoff::{FINE_STEP, Tradeoff, Varied};

const BUDGETS: [&str; 13] = [
    "case",
    "seed",
    "share_of_steps",
    "steps",
    "training_s",
    "held_out_views",
    "scored",
    "psnr_db",
    "ssim",
    "mask_psnr_db",
    "wanted_psnr_db",
    "wanted_mask_psnr_db",
    "wanted_training_s",
];
const TRADEOFFS: [&str; 12] = [
    "case",
    "seed",
    "varied",
    "value",
    "shipped",
    "rays_per_s",
    "max_error_levels_same_step",
    "rms_error_levels_same_step",
    "max_error_levels_fine_step",
    "rms_error_levels_fine_step",
    "views",
    "error_rays",
];

/// Adds a case to the tables in `out`, in place of what they had of it, and draws
/// the charts again.
///
/// # Errors
/// For files that cannot be read or written, and tables of another release.
pub fn save(out: &Path, name: &str, seed: u64, case: &Case, outcome: &Outcome) -> anyhow::Result<()> {
    // A comma ends a field of CSV.
    let (name, seed) = (name.replace(", ", " "), seed.to_string());
    let budgets = budgets(&out.join("budgets.csv"), &name, &seed, case, outcome)?;
    crate::cli::files::write(&out.join("budgets.svg"), budget_chart(&budgets).to_svg().as_bytes())?;
    if outcome.tradeoffs.is_empty() {
        return Ok(());
    }
    tradeoffs(&out.join("tradeoffs.csv"), &name, &seed, &outcome.tradeoffs)?;
    let slug: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    for (what, which) in [("max", true), ("rms", false)] {
        let chart = tradeoff_chart(&name, &outcome.tradeoffs, which);
        crate::cli::files::write(&out.join(format!("tradeoffs-{slug}-{what}.svg")), chart.to_svg().as_bytes())?;
    }
    Ok(())
}

fn budgets(path: &Path, name: &str, seed: &str, case: &Case, outcome: &Outcome) -> anyhow::Result<Table> {
    let mut table = Table::load(path, &BUDGETS)?;
    table.retain(|row| row[..2] != [name, seed]);
    for budget in &outcome.budgets {
        let (trained, scored) = (&budget.trained, &budget.scored);
        table.push(vec![
            name.to_owned(),
            seed.to_owned(),
            budget.share.to_string(),
            trained.steps.to_string(),
            format!("{:.3}", trained.seconds),
            scored.views.to_string(),
            if scored.right_half { "right half" } else { "whole" }.to_owned(),
            format!("{:.4}", scored.psnr_db),
            format!("{:.5}", scored.ssim),
            scored.mask.map(|m| format!("{:.4}", m.psnr_db)).unwrap_or_default(),
            case.psnr_db.to_string(),
            case.mask_psnr_db.map(|db| db.to_string()).unwrap_or_default(),
            case.seconds.to_string(),
        ])?;
    }
    table.save(path)?;
    Ok(table)
}

fn tradeoffs(path: &Path, name: &str, seed: &str, found: &[Tradeoff]) -> anyhow::Result<()> {
    let mut table = Table::load(path, &TRADEOFFS)?;
    table.retain(|row| row[..2] != [name, seed]);
    for t in found {
        table.push(vec![
            name.to_owned(),
            seed.to_owned(),
            t.varied.as_str().to_owned(),
            t.label.clone(),
            if t.shipped { "yes" } else { "no" }.to_owned(),
            format!("{:.0}", t.rays_per_s),
            format!("{:.6}", t.own.max),
            format!("{:.6}", t.own.rms),
            format!("{:.6}", t.fine.max),
            format!("{:.6}", t.fine.rms),
            t.views.to_string(),
            format!("{} of {}", t.error_rays, t.rays),
        ])?;
    }
    table.save(path)?;
    Ok(())
}

/// Columns of [`BUDGETS`] that are drawn.
const SHARE: usize = 2;
const SECONDS: usize = 4;
const WANTED_SECONDS: usize = 12;
/// What is measured, what is wanted of it, and what the legend adds for it.
const QUALITIES: [(usize, usize, &str); 2] = [(7, 10, ""), (9, 11, ", on the mask")];

/// Seconds against PSNR, a line each for a case, its masks and a seed, from the
/// whole table.
fn budget_chart(table: &Table) -> Chart {
    let (mut series, mut targets): (Vec<Series>, Vec<Point>) = (Vec::new(), Vec::new());
    let seeds: std::collections::BTreeSet<&str> = table.rows().iter().map(|row| row[1].as_str()).collect();
    for rows in table.rows().chunk_by(|a, b| a[..2] == b[..2]) {
        let (case, seed) = (&rows[0][0], &rows[0][1]);
        for (measured, wanted, of) in QUALITIES {
            let points: Vec<Point> =
                rows.iter().filter(|row| !row[measured].is_empty()).map(|row| budget_point(row, measured)).collect();
            if points.is_empty() {
                continue;
            }
            let seed = if seeds.len() > 1 { format!(", seed {seed}") } else { String::new() };
            series.push(Series { name: format!("{case}{of}{seed}"), points, look: Look::Line });
            let (x, y) = (number(&rows[0][WANTED_SECONDS]), number(&rows[0][wanted]));
            let target = Point { x, y, label: format!("{case}{of}"), ring: false };
            if !targets.contains(&target) {
                targets.push(target);
            }
        }
    }
    series.push(Series { name: "wanted".into(), points: targets, look: Look::Marks });
    Chart {
        title: "What a budget of training gives".into(),
        subtitle: "one whole training a point, labelled with its share of the configured steps; ringed: all".into(),
        x: Axis::log("seconds of training"),
        y: Axis::linear("PSNR on held-out views, dB"),
        series,
        levels: Vec::new(),
    }
}

fn budget_point(row: &[String], measured: usize) -> Point {
    let label = row[SHARE].clone();
    Point { x: number(&row[SECONDS]), y: number(&row[measured]), ring: label == "1", label }
}

/// What a field says; a number that is none has no place on a chart.
fn number(field: &str) -> f64 {
    field.parse().unwrap_or(f64::NAN)
}

/// Rays a second against error, a line for everything that was varied.
fn tradeoff_chart(name: &str, found: &[Tradeoff], largest: bool) -> Chart {
    let lines = [
        (Varied::Step, "step, voxels"),
        (Varied::Transmittance, "stop at transmittance"),
        (Varied::Alpha, "least alpha"),
        (Varied::Storage, "storage"),
        (Varied::Nothing, "nothing left out"),
    ];
    let series = lines.map(|(varied, name)| {
        let points = found.iter().filter(|t| t.varied == varied).map(|t| {
            let error = if varied == Varied::Step { t.fine } else { t.own };
            let y = if largest { error.max } else { error.rms };
            Point { x: t.rays_per_s / 1e6, y, label: t.label.clone(), ring: t.shipped }
        });
        Series { name: name.into(), points: points.collect(), look: Look::Line }
    });
    let which = if largest { "largest error of a pixel" } else { "RMS error" };
    Chart {
        title: format!("{name}: rays a second against {which}"),
        subtitle: format!(
            "steps against f64 at {FINE_STEP} voxels, the rest against f64 at the same step; ringed: as shipped"
        ),
        x: Axis::log("million rays/s"),
        y: Axis::log(&format!("{which}, 8-bit levels")),
        series: series.into(),
        levels: vec![Level { y: 0.5, label: "half an 8-bit level".into() }],
    }
}
