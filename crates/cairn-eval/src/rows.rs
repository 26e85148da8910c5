//! The rows of a run: what they have in common, how they are shown, and their way into the results.

use std::fmt::Write as _;
use std::path::Path;

use cairn_scene::quoted;
use cairn_service::query::report::{Report, Right};

use crate::args::Args;
use crate::file;
use crate::origin::{commit, machine, today};
use crate::page::page;
use crate::results::{Results, Row, Target, TargetOp};

/// The command as anybody can give it again: without the folders and files of this machine.
fn command(arguments: impl Iterator<Item = String>) -> String {
    const LOCAL: [&str; 6] = ["--captures", "--results", "--page", "--out", "--signals", "--cairn"];
    let mut said = vec!["cargo run --release -p cairn-eval --".to_owned()];
    let mut value_follows = false;
    for argument in arguments {
        let name = argument.split('=').next().unwrap_or_default();
        if !std::mem::take(&mut value_follows) && !LOCAL.contains(&name) {
            said.push(quoted(&argument));
        } else if LOCAL.contains(&name) {
            value_follows = !argument.contains('=');
        }
    }
    said.join(" ")
}

/// Units of what other work on the machine changes.
const OF_TIME: [&str; 7] = ["s", "ms", "us", "/s", "rays/s", "%/s", "GFLOP/s"];

/// Rows with what they have in common.
pub struct Rows {
    rows: Vec<Row>,
    blank: Row,
    /// Whether times and rates are kept.
    times: bool,
}

impl Rows {
    /// None yet, of the suite, seed, commit, machine and day of this run.
    pub fn new(args: &Args) -> Self {
        let blank = Row {
            suite: args.suite.name().into(),
            case: String::new(),
            metric: String::new(),
            value: 0.0,
            unit: String::new(),
            target: None,
            met: None,
            // Without the program's own path, which says nothing elsewhere.
            command: command(std::env::args().skip(1)),
            seed: args.seed,
            commit: commit(Path::new(".")),
            machine: machine(),
            date: today(),
        };
        Self { rows: Vec::new(), blank, times: !args.no_times }
    }

    /// Shows the rows that are there. Those with a target go into the results and onto the page, all or none; all of
    /// them go into a file of their own among the work. They are taken; more may follow.
    ///
    /// # Errors
    /// For a figure that is not finite, and files that cannot be read or written.
    pub fn save(&mut self, args: &Args) -> anyhow::Result<()> {
        let (suite, all) = (args.suite.name(), args.out.join("rows"));
        let (mut results, mut kept) = (Results::load(&args.results)?, Results::load(&all)?);
        let mut case = None;
        for row in self.rows.drain(..) {
            if case.as_ref() != Some(&row.case) {
                println!("{}", row.case);
                case = Some(row.case.clone());
            }
            println!("  {}", shown(&row));
            if row.target.is_some() {
                results.record(row.clone())?;
            }
            kept.record(row)?;
        }
        kept.save(&all, suite)?;
        if results.rows().iter().any(|row| row.suite == suite) {
            results.save(&args.results, suite)?;
        }
        write_page(&results, &args.page)
    }

    /// Adds a figure; not a time or rate where they are left out.
    pub fn add(&mut self, case: &str, metric: &str, value: f64, unit: &str, target: Option<Target>) {
        if !self.times && OF_TIME.contains(&unit) {
            return;
        }
        let (case, metric, unit) = (case.to_owned(), metric.to_owned(), unit.to_owned());
        let met = target.map(|target| target.is_met_by(value));
        self.rows.push(Row { case, metric, value, unit, target, met, ..self.blank.clone() });
    }

    /// The rows that are there, in tests.
    #[cfg(test)]
    pub fn take(self) -> Vec<Row> {
        self.rows
    }

    /// Adds a share of right answers; nothing where none was asked for.
    pub fn share(&mut self, case: &str, metric: &str, right: Right, at_least: Option<f64>) {
        if right.asked > 0 {
            let value = right.right as f64 / right.asked as f64;
            self.add(case, metric, value, "", at_least.map(Target::at_least));
        }
    }

    /// Adds what an evaluation says.
    pub fn of_report(&mut self, case: &str, report: &Report) {
        self.add(case, "base field PSNR", report.base.psnr_db, "dB", None);
        self.add(case, "base field SSIM", report.base.ssim, "", None);
        if let Some(who) = report.who_by_pose {
            self.share(case, "who contributed, by pose", who, None);
        }
        let Some(mark) = &report.mark else { return };
        self.add(case, "marked field PSNR", mark.pictures.psnr_db, "dB", None);
        self.add(case, "marked field SSIM", mark.pictures.ssim, "", None);
        if let Some(db) = mark.against_base_psnr_db {
            self.add(case, "marked against base PSNR", db, "dB", None);
        }
        let change = mark.pictures.psnr_db - report.base.psnr_db;
        self.add(case, "PSNR change by the mark", change, "dB", Some(Target::at_least(-0.2)));
        self.share(case, "classes right", mark.classes, Some(0.95));
        self.share(case, "who contributed, by picture", mark.who_by_picture, None);
        self.share(case, "photographs unmarked", mark.photographs_unmarked, Some(1.0));
        for r in &mark.identities {
            let name = format!("identity {}", r.number);
            // Pictures' rows have the names that they always had.
            for (hidden, forced, unit, measured, target) in [
                ("hidden SSIM", "", "", r.picture_ssim, Some(Target::at_least(0.9))),
                ("hidden sound, SNR", "sound SNR, ", "dB", r.audio_snr_db, Some(Target::at_least(25.0))),
                ("hidden sound, LSD", "sound LSD, ", "dB", r.audio_lsd_db, None),
                ("hidden text, characters", "text characters, ", "", r.text_characters, Some(Target::at_least(1.0))),
                ("hidden text, bits", "text bits, ", "", r.text_bits, None),
            ] {
                let Some(m) = measured else { continue };
                if let Some(value) = m.recovered {
                    self.add(case, &format!("{hidden}, {name}"), value, unit, target);
                }
                if let Some(value) = m.forced_base {
                    self.add(case, &format!("{forced}forced on base, {name}"), value, unit, None);
                }
                self.add(case, &format!("{forced}forced on grey, {name}"), m.forced_grey, unit, None);
                self.add(case, &format!("{forced}forced on noise, {name}"), m.forced_noise, unit, None);
            }
        }
    }
}

/// Writes the page of results.
///
/// # Errors
/// For a page that cannot be written.
pub fn write_page(results: &Results, path: &Path) -> anyhow::Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        file::make_folder(folder)?;
    }
    file::write(path, page(results).as_bytes())
}

/// A figure as the terminal shows it; a missed target is not to be overlooked.
fn shown(row: &Row) -> String {
    let mut line = format!("{:56} {:>12} {:8}", row.metric, figure(row.value), row.unit);
    if let Some(target) = row.target {
        let side = match target.op {
            TargetOp::AtLeast => "at least",
            TargetOp::AtMost => "at most",
        };
        let verdict = if target.is_met_by(row.value) { "met:" } else { "MISSED:" };
        let _ = write!(line, " {verdict} {side} {} {}", figure(target.value), row.unit);
    }
    line.trim_end().to_owned()
}

/// Four decimals, none for large figures, and the power of ten for tiny ones.
fn figure(value: f64) -> String {
    match value.abs() {
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size < 1e-3 && size > 0.0 => format!("{value:.2e}"),
        _ => format!("{value:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_target_is_said_with_figure_and_target() {
        let row = |value| Row {
            suite: "s".into(),
            case: "c".into(),
            metric: "training".into(),
            value,
            unit: "s".into(),
            target: Some(Target::at_most(180.0)),
            met: None,
            command: "cairn".into(),
            seed: 1,
            commit: String::new(),
            machine: String::new(),
            date: String::new(),
        };
        let missed = shown(&row(200.5));
        assert!(missed.contains("200.5000 s") && missed.ends_with("MISSED: at most 180.0000 s"), "{missed}");
        assert!(shown(&row(100.0)).contains(" met: at most"));
        assert!(shown(&Row { target: None, ..row(1.0) }).ends_with("1.0000 s"));
    }

    #[test]
    fn times_and_rates_are_left_out_where_the_machine_has_other_work() {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            args: Args,
        }
        let kept = |more: &[&str]| {
            let args = <Given as clap::Parser>::parse_from([&["cairn-eval", "mark"], more].concat()).args;
            let mut rows = Rows::new(&args);
            for (metric, unit) in [("seconds", "s"), ("rate", "rays/s"), ("memory", "MiB"), ("share", "")] {
                rows.add("case", metric, 1.0, unit, None);
            }
            rows.rows.into_iter().map(|row| row.metric).collect::<Vec<_>>()
        };
        assert_eq!(kept(&[]), ["seconds", "rate", "memory", "share"]);
        assert_eq!(kept(&["--no-times"]), ["memory", "share"]);
    }

    #[test]
    fn a_recorded_command_names_no_folder_of_this_machine() {
        let given = ["liberty", "--captures", "/mnt/c", "--seed", "2", "--results=/x", "--quick"];
        assert_eq!(
            command(given.map(String::from).into_iter()),
            "cargo run --release -p cairn-eval -- liberty --seed 2 --quick"
        );
    }

    #[test]
    fn a_recorded_command_can_be_given_again() {
        let given = ["ablation", "--row", "alpha 5", "--row", "it's", "--seed", "1"];
        let said = command(given.map(String::from).into_iter());
        assert_eq!(said, r"cargo run --release -p cairn-eval -- ablation --row 'alpha 5' --row 'it'\''s' --seed 1");
    }
}
