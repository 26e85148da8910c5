//! The ledger as a page for people: one table a suite, missed targets first.

use std::fmt::Write as _;

use crate::ledger::{Ledger, Row, TargetOp};
use crate::notes::Notes;

const HEAD: &str = "# Benchmarks\n\nGenerated from `benchmarks.json`; do not edit by hand. Every row states the command that measures it\nagain, and the commit and machine it was measured on.\n";

impl Ledger {
    /// The page, in Markdown, with the suites' notes. The same rows and notes give
    /// the same text.
    pub fn to_markdown(&self, notes: &Notes) -> String {
        let mut page = HEAD.to_owned();
        summary(&mut page, self);
        let mut suite = None;
        for row in self.rows() {
            if suite != Some(&row.suite) {
                suite = Some(&row.suite);
                let _ = write!(page, "\n## {}\n\n", escaped(&row.suite));
                if let Some(note) = notes.of(&row.suite) {
                    let _ = write!(page, "{note}\n\n");
                }
                page.push_str("| case | metric | value | target | met | seed | command | commit | machine | date |\n");
                page.push_str("|---|---|---:|---:|---|---:|---|---|---|---|\n");
            }
            line(&mut page, row);
        }
        page
    }
}

fn summary(page: &mut String, ledger: &Ledger) {
    let judged = ledger.rows().iter().filter(|r| r.met().is_some()).count();
    let missed: Vec<&Row> = ledger.missed().collect();
    if judged == 0 {
        page.push_str("\nNo row has a target.\n");
        return;
    }
    let _ = writeln!(page, "\n{} of {judged} targets are met.", judged - missed.len());
    if missed.is_empty() {
        return;
    }
    page.push_str("\n**Missed targets:**\n\n");
    for row in missed {
        let (suite, case, metric) = (escaped(&row.suite), escaped(&row.case), escaped(&row.metric));
        let (value, target) = (with_unit(row.value, &row.unit), target(row));
        let _ = writeln!(page, "- {suite}, {case}, {metric} (seed {}): {value}, wanted {target}", row.seed);
    }
}

fn line(page: &mut String, row: &Row) {
    let met = match row.met() {
        Some(true) => "yes",
        Some(false) => "**NO**",
        None => "",
    };
    let _ = writeln!(
        page,
        "| {} | {} | {} | {} | {met} | {} | `{}` | {} | {} | {} |",
        escaped(&row.case),
        escaped(&row.metric),
        with_unit(row.value, &row.unit),
        target(row),
        row.seed,
        row.command.replace(['`', '\n'], " ").replace('|', "\\|"),
        escaped(&row.commit),
        escaped(&row.machine),
        escaped(&row.date),
    );
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

/// Four significant digits are what a measurement is worth; a whole number
/// keeps all of its own.
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
