//! `cairn bench`: a suite's measurements, one row each, into the ledger, with the
//! command, seed, commit and machine that they come from.

mod baseline;
mod children;
mod conv;
mod field;
mod liberty;
mod mark;
mod memory;
mod parts;
mod registry;
mod rows;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_eval::{Ledger, Target};
use cairn_scene::{Limits, Picture, decode_picture};

use super::connect::Where;
use super::demo;
pub use parts::part;
use rows::Rows;

/// `cairn bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to measure
    #[arg(value_enum)]
    suite: Suite,
    /// The folder of captures (all suites that read any); else CAIRN_DATA
    #[arg(long, value_name = "DIR")]
    captures: Option<PathBuf>,
    /// The capture to measure (suite `own`)
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Leave out the views whose photographs are not there (suite `own`)
    #[arg(long)]
    skip_missing: bool,
    /// Make pictures smaller whose longer side is over this (suite `own`; else they stay as they are)
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..))]
    longest_side: Option<u32>,
    /// The ledger, JSON; a row with the same suite, case, metric and seed is replaced
    #[arg(long, value_name = "FILE", default_value = "docs/benchmarks.json")]
    ledger: PathBuf,
    /// Also write the ledger as a page of Markdown, with the suites' notes from `limits` beside it (suite
    /// `page`: beside the ledger where not given)
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// The seed of everything that is drawn
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Training settings that go over the defaults (suites `field`, `few` and `own`, and the marks' own: and over those for the capture's kind)
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Fewer steps and smaller sizes
    #[arg(long)]
    quick: bool,
    /// Stop after the base field (suites `demo` and `liberty`)
    #[arg(long)]
    base_only: bool,
    /// M, the number of clusters around anchors (suite `liberty`; else three, of twenty views). Their rows are another case than without
    #[arg(long, value_name = "M", value_parser = clap::value_parser!(u32).range(1..))]
    anchors: Option<u32>,
    /// K, the views of a cluster (suite `liberty`, with --anchors; else as many as there are, twenty at most)
    #[arg(long, value_name = "K", requires = "anchors", value_parser = clap::value_parser!(u32).range(1..))]
    neighbours: Option<u32>,
    /// Pictures to hide, in order of file name (suite `liberty`: drawn where not given; `mark`
    /// and `baseline`: else the captures' folder `signals`)
    #[arg(long, value_name = "DIR")]
    signals: Option<PathBuf>,
    /// Resample by this factor, above 0, to 1 (suite `liberty`; `field` and `few` measure at full size)
    #[arg(long, value_name = "FACTOR", default_value_t = 0.5)]
    scale: f64,
    /// Measure this capture only; may be given several times (suites `field`, `few`,
    /// `mark` and `baseline`)
    #[arg(long = "case", value_name = "NAME", value_enum)]
    cases: Vec<field::Name>,
    /// Train this row only, by its name in the ledger; may be given several times (suite `ablation`)
    #[arg(long = "row", value_name = "NAME")]
    rows: Vec<String>,
    /// How many trainings each capture gets, with seeds from `--seed` on (suites `mark` and `honesty`; else three, or one
    /// with `--quick`). Their rows are another case than without
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100))]
    trainings: Option<u64>,
    /// Also train for twice the configured steps (suite `field`); measure the log of ten million records, alone (suite
    /// `registry`: a quarter of an hour to grow it)
    #[arg(long)]
    long: bool,
    /// Leave times and rates out of the ledger: the machine has other work
    #[arg(long)]
    no_times: bool,
    /// Only what the configured steps give: neither the curve of budgets nor that of a render's limits (suite `field`)
    #[arg(long, conflicts_with = "long")]
    no_curves: bool,
    /// A Python that has PyTorch, to be measured beside (suite `conv`)
    #[arg(long, value_name = "PROGRAM")]
    torch: Option<PathBuf>,
    /// Where the work goes: a new folder, except for suites `field`, `few` and `own`, of which the first adds to its tables there, and `mark`, which takes
    /// base fields from there
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Suite {
    /// The made-up landmark
    Demo,
    /// The statue photographed by a hundred visitors, three anchors of twenty views
    Liberty,
    /// Four captures' fields: quality, seconds, rays/s, memory, and what each limit of a render costs
    Field,
    /// Four captures' fields from ten photographs each, with and without what is done where views look far apart
    Few,
    /// The field of a capture of yours (--folder), with and without the finer grid that its photographs may ask for
    Own,
    /// Four captures' marks, three times each: pictures kept, signals recovered, false owners, what marks outlast
    Mark,
    /// Of suite `mark` what says whether answers come from the mark: strangers' marks, pictures without one, calibration
    Honesty,
    /// Fern, or what is named, marked with a part of the method switched off at a time
    Ablation,
    /// Three captures marked together with one detector, each with a picture of its own and all with one
    Scenes,
    /// What is left of a picture hidden in photographs, in their lowest bits and by networks, once a field was trained on them
    Baseline,
    /// The networks' convolutions: each pass in milliseconds, and beside PyTorch's with --torch
    Conv,
    /// The log of owner records: throughput, waits, cost by size, and two hundred kills; ten million records with --long
    Registry,
    /// Nothing: only write the ledger's page again, after its notes were changed
    Page,
}

impl Suite {
    /// What the ledger calls it.
    fn name(self) -> &'static str {
        match self {
            Self::Demo => "demo",
            Self::Liberty => "liberty",
            Self::Field => "field",
            Self::Few => "few",
            Self::Own => "own",
            Self::Mark => "mark",
            Self::Honesty => "honesty",
            Self::Ablation => "ablation",
            Self::Scenes => "scenes",
            Self::Baseline => "baseline",
            Self::Conv => "conv",
            Self::Registry => "registry",
            Self::Page => "page",
        }
    }
}

impl Args {
    /// What a row calls `case`: under other settings it is another case.
    fn case_name(&self, case: &str) -> String {
        let settings = self.settings.as_deref().and_then(Path::file_stem).map(|s| format!(", {}", s.to_string_lossy()));
        let trainings =
            self.trainings.map(|n| if n == 1 { ", one training".into() } else { format!(", {n} trainings") });
        let quick = if self.quick { ", quick" } else { "" };
        format!("{case}{quick}{}{}", settings.unwrap_or_default(), trainings.unwrap_or_default())
    }

    /// What stands in the file of settings; nothing where there is none.
    fn settings_text(&self) -> anyhow::Result<String> {
        let Some(path) = &self.settings else { return Ok(String::new()) };
        String::from_utf8(super::files::read(path)?).with_context(|| format!("{} is no text", path.display()))
    }

    /// The folder that holds the captures.
    fn captures(&self) -> anyhow::Result<PathBuf> {
        let captures = self.captures.clone().or_else(|| std::env::var_os("CAIRN_DATA").map(PathBuf::from));
        captures.context("say where the captures are: --captures DIR or CAIRN_DATA")
    }

    /// As [`Args::captures`], where those of `names` are all there.
    fn captures_with(&self, names: impl Iterator<Item = field::Name>) -> anyhow::Result<PathBuf> {
        let captures = self.captures()?;
        for name in names {
            let folder = captures.join(name.as_str());
            anyhow::ensure!(
                folder.is_dir(),
                "there is no capture {}; bring it, or name those to measure (--case NAME)",
                folder.display()
            );
        }
        Ok(captures)
    }
}

/// Answers `cairn bench`.
pub async fn run(place: &Where, args: Args) -> anyhow::Result<()> {
    let many = matches!(args.suite, Suite::Mark | Suite::Honesty);
    let only = args.suite == Suite::Liberty || args.anchors.is_none();
    anyhow::ensure!(only, "--anchors and --neighbours are for suite `liberty`; leave them out");
    anyhow::ensure!(many || args.trainings.is_none(), "--trainings is for suites `mark` and `honesty`; leave it out");
    let curves = args.suite == Suite::Field || !args.no_curves;
    anyhow::ensure!(curves, "--no-curves is for suite `field`; leave it out");
    // Read now: an unreadable one is better found before the work than after it.
    Ledger::load(&args.ledger)?;
    let mut rows = Rows::new(&args);
    match args.suite {
        Suite::Demo => of_demo(place, &args, &mut rows).await?,
        Suite::Liberty => liberty::measure(place, &args, &mut rows).await?,
        Suite::Field => field::measure(place, &args, &mut rows).await?,
        Suite::Few => field::few::measure(place, &args, &mut rows).await?,
        Suite::Own => field::own::measure(place, &args, &mut rows).await?,
        Suite::Mark => mark::measure(place, &args, &mut rows, mark::What::Marks).await?,
        Suite::Honesty => mark::measure(place, &args, &mut rows, mark::What::Honesty).await?,
        Suite::Ablation => mark::measure(place, &args, &mut rows, mark::What::Ablation).await?,
        Suite::Scenes => mark::scenes::measure(place, &args, &mut rows).await?,
        Suite::Baseline => baseline::measure(place, &args, &mut rows).await?,
        Suite::Conv => tokio::task::block_in_place(|| conv::measure(&args, &mut rows))?,
        Suite::Registry => tokio::task::block_in_place(|| registry::measure(&args, &mut rows))?,
        Suite::Page => return write_page_again(&args),
    }
    rows.save(&args)?;
    let ledger = Ledger::load(&args.ledger)?;
    println!("in {}; {} targets missed", args.ledger.display(), ledger.missed().count());
    Ok(())
}

/// Decodes a picture file.
///
/// # Errors
/// For a file that does not read or decode.
fn decoded(path: &Path) -> anyhow::Result<Picture> {
    let bytes = super::files::read(path)?;
    decode_picture(&bytes, &Limits::default(), None).with_context(|| format!("{} does not decode", path.display()))
}

/// A count with thousands apart.
fn with_units(count: u64) -> String {
    let digits = count.to_string();
    let mut grouped = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            grouped.push(' ');
        }
        grouped.push(digit);
    }
    grouped
}

/// The page of a ledger that is there; an absent one would give an empty page.
fn write_page_again(args: &Args) -> anyhow::Result<()> {
    let ledger = &args.ledger;
    anyhow::ensure!(ledger.is_file(), "there is no ledger {}; name the one to show (--ledger FILE)", ledger.display());
    let page = args.page.clone().unwrap_or_else(|| ledger.with_extension("md"));
    rows::write_page(&Ledger::load(ledger)?, &page)?;
    println!("in {}", page.display());
    Ok(())
}

async fn of_demo(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let demo = demo::Args {
        json: None,
        out: args.out.clone(),
        seed: args.seed,
        contributors: 3,
        photographs: 14,
        quality: crate::cli::train::Quality::Draft,
        base_only: args.base_only,
    };
    let results = demo::measure(place, &demo).await?;
    let case = args.case_name("made-up landmark");
    rows.of_report(&case, &results.evaluation);
    rows.share(&case, "owner records trusted", results.records_trusted, Some(1.0));
    rows.share(&case, "records found by pose", results.records_found, Some(1.0));
    for (step, seconds) in &results.seconds {
        let target = (step == demo::WHOLE).then(|| Target::at_most(180.0));
        rows.add(&case, step, *seconds, "s", target);
    }
    Ok(())
}
