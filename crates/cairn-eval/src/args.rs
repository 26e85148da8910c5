//! The command line of a suite.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_scene::ImageFormat;

use crate::captures::Name;
use crate::file;

/// What to measure, and how.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// What to measure
    #[arg(value_enum)]
    pub suite: Suite,
    /// The folder of captures; else CAIRN_DATA
    #[arg(long, value_name = "DIR")]
    captures: Option<PathBuf>,
    /// The folder of results, a file a suite. A row with the same suite, case and metric is replaced
    #[arg(long, value_name = "DIR", default_value = "bench/results")]
    pub results: PathBuf,
    /// The page of results, written anew with every row
    #[arg(long, value_name = "FILE", default_value = "docs/results.md")]
    pub page: PathBuf,
    /// Where the work goes, and all rows of this run, also those without a target
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    pub out: PathBuf,
    /// The seed of everything that is drawn
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Few steps and small pictures: everything runs, nothing is good
    #[arg(long)]
    pub quick: bool,
    /// Leave out times and rates: the machine has other work
    #[arg(long)]
    pub no_times: bool,
    /// Measure this capture only; may be given several times (suites `field`, `mark`, `ablation`, `baseline`, `contribution`, `registration`, `woven`)
    #[arg(long = "case", value_name = "NAME", value_enum)]
    pub cases: Vec<Name>,
    /// Train this row only; may be given several times (suite `ablation`)
    #[arg(long = "row", value_name = "NAME")]
    pub rows: Vec<String>,
    /// Pictures to hide, in order of file name (else the captures' folder `signals`)
    #[arg(long, value_name = "DIR")]
    signals: Option<PathBuf>,
    /// How many trainings each capture gets, with seeds from `--seed` on (suite `mark`; else three, or one with `--quick`)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100))]
    pub trainings: Option<u64>,
    /// Train marks that outlast distortions (suite `mark`)
    #[arg(long)]
    pub robust: bool,
    /// Also measure what fewer steps give, and what each limit of a render costs (suite `field`)
    #[arg(long)]
    pub curves: bool,
    /// M, the number of anchors (suite `liberty`; else three, of twenty views)
    #[arg(long, value_name = "M", value_parser = clap::value_parser!(u32).range(1..))]
    pub anchors: Option<u32>,
    /// K, the views of a cluster (suite `liberty`, with --anchors)
    #[arg(long, value_name = "K", requires = "anchors", value_parser = clap::value_parser!(u32).range(1..))]
    pub neighbours: Option<u32>,
    /// Measure the log of ten million records, alone (suite `registry`: a quarter of an hour to grow it)
    #[arg(long)]
    pub long: bool,
    /// A Python that has PyTorch, to be measured beside (suite `conv`)
    #[arg(long, value_name = "PROGRAM")]
    pub torch: Option<PathBuf>,
    /// The program `cairn` (suites `demo` and `liberty`; else the one beside this program)
    #[arg(long, value_name = "PROGRAM")]
    cairn: Option<PathBuf>,
}

/// The suites.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Suite {
    /// The made-up landmark, by `cairn demo`
    Demo,
    /// The statue photographed by a hundred visitors, by `cairn train` and `cairn evaluate`
    Liberty,
    /// Four captures' fields: quality, seconds, rays/s, memory
    Field,
    /// Four captures' marks: pictures kept, signals recovered, false owners, distortions
    Mark,
    /// Fern, or what is named, marked with a part of the method switched off at a time
    Ablation,
    /// Three captures marked together with one detector
    Scenes,
    /// Shares against retraining without some of the contributors
    Contribution,
    /// Finding the cameras of pictures of four captures: placed, how near, wrong ones, other scenes' pictures, seconds
    Registration,
    /// Keyed marks woven into four captures' fields: found by share and distortion, controls, what is seen, seconds
    Woven,
    /// What is left of a picture hidden in photographs once a field was trained on them
    Baseline,
    /// The networks' convolutions: each pass in milliseconds, and beside PyTorch's with --torch
    Conv,
    /// The log of owner records: throughput, waits, cost by size, and two hundred kills
    Registry,
    /// Nothing: only write the page again
    Page,
}

impl Suite {
    /// What the results call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Demo => "demo",
            Self::Liberty => "liberty",
            Self::Field => "field",
            Self::Mark => "mark",
            Self::Ablation => "ablation",
            Self::Scenes => "scenes",
            Self::Contribution => "contribution",
            Self::Registration => "registration",
            Self::Woven => "woven",
            Self::Baseline => "baseline",
            Self::Conv => "conv",
            Self::Registry => "registry",
            Self::Page => "page",
        }
    }
}

impl Args {
    /// What a row calls `case`: under other settings it is another case.
    pub fn case_name(&self, case: &str) -> String {
        let trainings = self.trainings.map(|n| match n {
            1 => ", one training".to_owned(),
            n => format!(", {n} trainings"),
        });
        let robust = if self.robust { ", robust" } else { "" };
        let quick = if self.quick { ", quick" } else { "" };
        format!("{case}{quick}{robust}{}", trainings.unwrap_or_default())
    }

    /// Refuses an option that the suite does not read.
    ///
    /// # Errors
    /// Naming the first one.
    pub fn check(&self) -> anyhow::Result<()> {
        for (option, given, suite) in [
            ("--anchors", self.anchors.is_some(), Suite::Liberty),
            ("--trainings", self.trainings.is_some(), Suite::Mark),
            ("--robust", self.robust, Suite::Mark),
            ("--curves", self.curves, Suite::Field),
            ("--row", !self.rows.is_empty(), Suite::Ablation),
            ("--long", self.long, Suite::Registry),
            ("--torch", self.torch.is_some(), Suite::Conv),
        ] {
            anyhow::ensure!(!given || self.suite == suite, "{option} is for suite `{}`; leave it out", suite.name());
        }
        Ok(())
    }

    /// The folder that holds the captures.
    ///
    /// # Errors
    /// Where nothing says which.
    pub fn captures(&self) -> anyhow::Result<PathBuf> {
        let captures = self.captures.clone().or_else(|| std::env::var_os("CAIRN_DATA").map(PathBuf::from));
        captures.context("say where the captures are: --captures DIR or CAIRN_DATA")
    }

    /// The folder of captures, of which those of `names` are all there.
    ///
    /// # Errors
    /// Naming the first that is not.
    pub fn captures_with(&self, names: &[Name]) -> anyhow::Result<PathBuf> {
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

    /// The pictures to hide, in order of file name.
    ///
    /// # Errors
    /// For a folder without any.
    pub fn pictures(&self) -> anyhow::Result<Vec<PathBuf>> {
        let folder = match &self.signals {
            Some(folder) => folder.clone(),
            None => self.captures()?.join("signals"),
        };
        let endings: Vec<&str> = ImageFormat::ALL.iter().flat_map(|format| format.endings()).copied().collect();
        let files = file::with_ending(&folder, &endings).context("say where pictures to hide are (--signals DIR)")?;
        let problem = "say where pictures to hide are (--signals DIR)";
        anyhow::ensure!(!files.is_empty(), "{} has no {}; {problem}", folder.display(), ImageFormat::names());
        Ok(files)
    }

    /// The folder of pictures that was named, if one was.
    pub fn signals(&self) -> Option<&std::path::Path> {
        self.signals.as_deref()
    }

    /// The program `cairn`.
    ///
    /// # Errors
    /// Where there is none beside this program.
    pub fn cairn(&self) -> anyhow::Result<PathBuf> {
        if let Some(program) = &self.cairn {
            return Ok(program.clone());
        }
        let own = std::env::current_exe().context("cannot find this program's own file")?;
        let program = own.with_file_name(format!("cairn{}", std::env::consts::EXE_SUFFIX));
        let problem = "build it (`cargo build --release`), or name it (--cairn PROGRAM)";
        anyhow::ensure!(program.is_file(), "there is no {}; {problem}", program.display());
        Ok(program)
    }
}
