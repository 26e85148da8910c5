//! `cairn bench`: a suite's measurements, one row each, into the ledger, with the
//! command, seed, commit and machine that they come from.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_bench::{Ledger, Notes, Row, Target, commit, machine, today};

use super::connect::{Connection, Where};
use super::{demo, look, scene, train};
use crate::engine::report::{Report, Right};

/// `cairn bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to measure
    #[arg(value_enum)]
    suite: Suite,
    /// The folder of captures (suite `liberty`); else CAIRN_DATA
    #[arg(long, value_name = "DIR")]
    captures: Option<PathBuf>,
    /// The ledger, JSON; a row with the same suite, case, metric and seed is replaced
    #[arg(long, value_name = "FILE", default_value = "docs/benchmarks.json")]
    ledger: PathBuf,
    /// Also write the ledger as a page of Markdown
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// The seed of everything that is drawn
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Training settings that go over the defaults
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Fewer steps and smaller sizes
    #[arg(long)]
    quick: bool,
    /// Stop after the base field
    #[arg(long)]
    base_only: bool,
    /// Pictures to hide in `liberty`, in order of file name (drawn where not given)
    #[arg(long, value_name = "DIR")]
    signals: Option<PathBuf>,
    /// Resample `liberty` by this factor, above 0, to 1
    #[arg(long, value_name = "FACTOR", default_value_t = 0.5)]
    scale: f64,
    /// Where the work goes: a new folder
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Suite {
    /// The made-up landmark
    Demo,
    /// The statue photographed by a hundred visitors, three anchors of twenty views
    Liberty,
}

impl Args {
    /// What a row calls `case`: under other settings it is another case.
    fn case(&self, case: &str) -> String {
        let settings = self.settings.as_deref().and_then(Path::file_stem).map(|s| format!(", {}", s.to_string_lossy()));
        format!("{case}{}{}", if self.quick { ", quick" } else { "" }, settings.unwrap_or_default())
    }
}

/// Answers `cairn bench`.
pub async fn run(place: &Where, args: Args) -> anyhow::Result<()> {
    let mut ledger = Ledger::load(&args.ledger)?;
    let mut rows = Rows::new(&args);
    match args.suite {
        Suite::Demo => {
            let demo = demo::Args {
                json: None,
                out: args.out.clone(),
                seed: args.seed,
                contributors: 3,
                photographs: 14,
                settings: args.settings.clone(),
                base_only: args.base_only,
            };
            let results = demo::measure(place, &demo).await?;
            let case = args.case("made-up landmark");
            rows.of_report(&case, &results.evaluation);
            rows.share(&case, "owner records trusted", results.records_trusted, Some(1.0));
            rows.share(&case, "records found by pose", results.records_found, Some(1.0));
            for (step, seconds) in &results.seconds {
                let target = (step == demo::WHOLE).then(|| Target::at_most(180.0));
                rows.add(&case, step, *seconds, "s", target);
            }
        }
        Suite::Liberty => liberty(place, &args, &mut rows).await?,
    }
    for row in rows.rows {
        println!("{:28} {:10.4} {}", row.metric, row.value, row.unit);
        ledger.record(row)?;
    }
    ledger.save(&args.ledger)?;
    if let Some(page) = &args.page {
        let notes = Notes::read(&page.with_file_name("limits"))?;
        super::write(page, ledger.to_markdown(&notes).as_bytes())?;
    }
    println!("in {}; {} targets missed", args.ledger.display(), ledger.missed().count());
    Ok(())
}

async fn liberty(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let captures = args.captures.clone().or_else(|| std::env::var_os("CAIRN_DATA").map(PathBuf::from));
    let captures = captures.context("say where the captures are: --captures DIR or CAIRN_DATA")?;
    let from = captures.join("liberty");
    std::fs::create_dir(&args.out)
        .with_context(|| format!("cannot make the folder {}; choose a new one (--out)", args.out.display()))?;
    let line = Connection::open(&Where { connect: None, data: args.out.join("data"), ..place.clone() }).await?;
    let done = train_and_score(&line, args, &from, rows).await;
    line.close().await;
    done
}

async fn train_and_score(line: &Connection, args: &Args, from: &Path, rows: &mut Rows) -> anyhow::Result<()> {
    let import = scene::ImportArgs {
        name: "liberty".into(),
        from: from.to_path_buf(),
        contributors: Some(from.join("contributors.csv")),
        kind: None,
        hold_every: 8,
        width: None,
        height: None,
        scale: (args.scale < 1.0).then_some(args.scale),
    };
    scene::import(line, &import).await?;
    let train = train::Args {
        name: "liberty".into(),
        anchors: 3,
        neighbours: 20,
        by_contributor: false,
        least_views: 2,
        seed: args.seed,
        signals: args.signals.clone(),
        settings: args.settings.clone(),
        quick: args.quick,
        base_only: args.base_only,
        resume: None,
        detach: false,
        keys: None,
    };
    let job = train::run_to_end(line, &train).await?;
    let case = args.case("liberty");
    for stage in &job.stages {
        rows.add(&case, &stage.stage, stage.seconds, "s", None);
    }
    let report = look::report(line, "liberty", None, Some(&args.out.join("contact-sheet.png"))).await?;
    rows.of_report(&case, &report);
    Ok(())
}

/// The command as anybody can give it again: without the folders and files of this machine.
fn command(arguments: impl Iterator<Item = String>) -> String {
    const LOCAL: [&str; 7] = ["--captures", "--connect", "--data", "--ledger", "--page", "--out", "--signals"];
    let mut said = vec!["cairn".to_owned()];
    let mut value_follows = false;
    for argument in arguments {
        let name = argument.split('=').next().unwrap_or_default();
        if !std::mem::take(&mut value_follows) && !LOCAL.contains(&name) {
            said.push(argument);
        } else if LOCAL.contains(&name) {
            value_follows = !argument.contains('=');
        }
    }
    said.join(" ")
}

/// Rows with what they have in common.
struct Rows {
    rows: Vec<Row>,
    blank: Row,
}

impl Rows {
    fn new(args: &Args) -> Self {
        let suite = match args.suite {
            Suite::Demo => "demo",
            Suite::Liberty => "liberty",
        };
        let blank = Row {
            suite: suite.into(),
            case: String::new(),
            metric: String::new(),
            value: 0.0,
            unit: String::new(),
            target: None,
            // Without the program's own path, which says nothing elsewhere.
            command: command(std::env::args().skip(1)),
            seed: args.seed,
            commit: commit(Path::new(".")),
            machine: machine(),
            date: today(),
        };
        Self { rows: Vec::new(), blank }
    }

    fn add(&mut self, case: &str, metric: &str, value: f64, unit: &str, target: Option<Target>) {
        let (case, metric, unit) = (case.to_owned(), metric.to_owned(), unit.to_owned());
        self.rows.push(Row { case, metric, value, unit, target, ..self.blank.clone() });
    }

    fn share(&mut self, case: &str, metric: &str, right: Right, at_least: Option<f64>) {
        if right.asked > 0 {
            let value = right.right as f64 / right.asked as f64;
            self.add(case, metric, value, "", at_least.map(Target::at_least));
        }
    }

    fn of_report(&mut self, case: &str, report: &Report) {
        self.add(case, "base field PSNR", report.base.psnr_db, "dB", None);
        self.add(case, "base field SSIM", report.base.ssim, "", None);
        if let Some(who) = report.who_by_pose {
            self.share(case, "who contributed, by pose", who, None);
        }
        let Some(mark) = &report.mark else { return };
        self.add(case, "marked field PSNR", mark.pictures.psnr_db, "dB", None);
        self.add(case, "marked field SSIM", mark.pictures.ssim, "", None);
        self.add(case, "marked against base PSNR", mark.against_base_psnr_db, "dB", None);
        let change = mark.pictures.psnr_db - report.base.psnr_db;
        self.add(case, "PSNR change by the mark", change, "dB", Some(Target::at_least(-0.2)));
        self.share(case, "classes right", mark.classes, Some(0.95));
        self.share(case, "who contributed, by picture", mark.who_by_picture, None);
        self.share(case, "photographs unmarked", mark.photographs_unmarked, Some(1.0));
        for r in &mark.identities {
            let name = format!("identity {}", r.number);
            if let Some(ssim) = r.hidden_ssim {
                self.add(case, &format!("hidden SSIM, {name}"), ssim, "", Some(Target::at_least(0.9)));
            }
            if let Some(ssim) = r.forced_base_ssim {
                self.add(case, &format!("forced on base, {name}"), ssim, "", None);
            }
            self.add(case, &format!("forced on grey, {name}"), r.forced_grey_ssim, "", None);
            self.add(case, &format!("forced on noise, {name}"), r.forced_noise_ssim, "", None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::command;

    #[test]
    fn a_recorded_command_names_no_folder_of_this_machine() {
        let given = ["bench", "liberty", "--captures", "/mnt/c", "--seed", "2", "--ledger=/x.json", "--quick"];
        assert_eq!(command(given.map(String::from).into_iter()), "cairn bench liberty --seed 2 --quick");
    }
}
