//! The results as one page for people: a table a suite, of the rows with a target, and the run that each comes from.

use std::fmt::Write as _;

use crate::results::{Results, Row, TargetOp};

const HEAD: &str = "# Results\n\nGenerated from `bench/results` by `cargo run --release -p cairn-eval -- page`; \
    do not edit it by hand.\nEach row names its run; the runs stand below each table, with command, commit, machine and day.\n";

/// The page, in Markdown. The same rows give the same text.
pub fn page(results: &Results) -> String {
    let mut page = HEAD.to_owned();
    let judged: Vec<&Row> = results.rows().iter().filter(|row| row.target.is_some()).collect();
    let missed = results.missed().count();
    let _ = writeln!(page, "\n{} of {} targets are met.", judged.len() - missed, judged.len());
    for of_suite in judged.chunk_by(|a, b| a.suite == b.suite) {
        table(&mut page, of_suite);
    }
    page
}

fn table(page: &mut String, rows: &[&Row]) {
    let _ = write!(page, "\n## {}\n\n", escaped(&rows[0].suite));
    page.push_str("| case | metric | value | target | met | run |\n|---|---|---:|---:|---|---|\n");
    let mut runs: Vec<[&str; 4]> = Vec::new();
    for row in rows {
        let run: [&str; 4] = [&row.command, &row.commit, &row.machine, &row.date];
        let at = runs.iter().position(|other| *other == run).unwrap_or_else(|| {
            runs.push(run);
            runs.len() - 1
        });
        let met = if row.met == Some(true) { "yes" } else { "**no**" };
        let (case, metric) = (escaped(&row.case), escaped(&row.metric));
        let value = with_unit(row.value, &row.unit);
        let _ = writeln!(page, "| {case} | {metric} | {value} | {} | {met} | {} |", target(row), at + 1);
    }
    page.push('\n');
    for (at, [command, commit, machine, date]) in runs.into_iter().enumerate() {
        let (commit, machine, date) = (escaped(commit), escaped(machine), escaped(date));
        let command = command.replace(['`', '\n'], " ");
        let _ = writeln!(page, "{}. `{command}`: {commit}, {machine}, {date}", at + 1);
    }
}

fn target(row: &Row) -> String {
    row.target.map_or(String::new(), |t| {
        let op = match t.op {
            TargetOp::AtLeast => "≥",
            TargetOp::AtMost => "≤",
        };
        format!("{op} {}", with_unit(t.value, &row.unit))
    })
}

/// Four significant digits are what a measurement is worth; a whole number keeps all of its own.
fn with_unit(value: f64, unit: &str) -> String {
    let digits = if value == 0.0 { 0 } else { 3 - value.abs().log10().floor() as i64 };
    let mut text = format!("{value:.*}", digits.clamp(0, 12) as usize);
    if text.contains('.') {
        text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    }
    if unit.is_empty() { text } else { format!("{text} {}", escaped(unit)) }
}

/// Text that cannot break out of a table's cell.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('|', "\\|").replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_keep_four_digits() {
        for (value, text) in [
            (27.716_4, "27.72"),
            (0.983_04, "0.983"),
            (12_345.6, "12346"),
            (0.0, "0"),
            (-0.054_32, "-0.05432"),
            (3.0, "3"),
        ] {
            assert_eq!(with_unit(value, ""), text);
        }
        assert_eq!(with_unit(1.5, "dB"), "1.5 dB");
    }
}
