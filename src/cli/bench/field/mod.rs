//! Suite `field`: what stage 1 makes of four captures at full size. Quality on
//! views that no training saw, seconds, rays a second, memory, and two curves:
//! what a smaller or larger budget gives, and what each limit of a render costs.
//!
//! Every training, scoring and timing runs in a process of its own (`parts`), so
//! that peak memory is that work's alone, and ends with this one (`children`).
//! Rows reach the ledger a case at a time, when it is whole.

mod adapter;
mod case;
pub(super) mod few;
mod outcome;
pub(super) mod own;
pub(super) mod progress;
mod report;
pub(super) mod score;
pub(super) mod serve;
pub(super) mod source;
mod tables;
pub(super) mod tradeoff;
pub(super) mod train;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use cairn_field::FieldConfig;

use super::super::connect::Where;
use super::super::files::{open, read};
use super::Args;
use super::children::Children;
use super::rows::Rows;
use cairn_service::config::{TrainingSettings, overlay_for, training_settings};
use case::{CASES, Case};
pub use case::{Name, SERVING_MIB};
use outcome::{Budget, Outcome, Share};
use source::Source;

/// What `--quick` lays over a kind's settings here: everything runs, nothing is good.
const QUICK_TOML: &str = "[field]\nsteps = 64\nrays_per_step = 512\nvoxels = 32768\nlevels = 2\n";
/// Pictures' longest side under `--quick`, px.
const QUICK_SIDE_PX: usize = 64;
/// Views to train on, and to score on, at most, under `--quick`.
const QUICK_VIEWS: usize = 24;
/// Views that a render's limits are varied on.
const TRADEOFF_VIEWS: usize = 2;

/// Measures the captures that were asked for and puts each one's rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let (captures, cases) = wanted(args)?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let children = Arc::new(Children::default());
    for case in cases {
        let run = Run::new(place, args, case, &captures)?;
        let work = tokio::task::spawn_blocking({
            let children = children.clone();
            move || run.outcome(&children)
        });
        let outcome = unless_stopped(work, &children).await?;
        let name = args.case_name(case.name.as_str());
        // Tables first: a folder that cannot be written leaves the ledger as it was.
        tables::save(&args.out, &name, args.seed, case, &outcome)?;
        report::rows(rows, &name, case, &outcome);
        rows.save(args)?;
    }
    println!("tables, charts and contact sheets in {}", args.out.display());
    Ok(())
}

/// The folder of captures, and those of them that were asked for: all are there.
fn wanted(args: &Args) -> anyhow::Result<(PathBuf, Vec<&'static Case>)> {
    let wanted = |case: &&Case| args.cases.is_empty() || args.cases.contains(&case.name);
    let cases: Vec<&'static Case> = CASES.iter().filter(wanted).collect();
    Ok((args.captures_with(cases.iter().map(|case| case.name))?, cases))
}

/// Waits for `work`; on Ctrl-C ends its process and says what is kept.
pub(super) async fn unless_stopped<T>(
    mut work: tokio::task::JoinHandle<anyhow::Result<T>>,
    children: &Children,
) -> anyhow::Result<T> {
    tokio::select! {
        done = &mut work => done.context("the measurement broke off")?,
        interrupt = tokio::signal::ctrl_c() => {
            interrupt?;
            children.stop();
            // Its error would only say that it was stopped.
            let _ = work.await;
            anyhow::bail!("stopped by Ctrl-C; the captures that were finished are in the ledger, this one is not")
        }
    }
}

/// One capture's measurements, as they are asked for.
struct Run {
    /// What the capture is called.
    name: String,
    /// As [`Case::right_half`]; `None` where the field says it: where views have appearances.
    right_half: Option<bool>,
    source: Source,
    config: FieldConfig,
    seed: u64,
    shares: Vec<Share>,
    /// Whether a render's limits are varied.
    curves: bool,
    out: PathBuf,
}

impl Run {
    fn new(place: &Where, args: &Args, case: &'static Case, captures: &Path) -> anyhow::Result<Self> {
        let folder = captures.join(case.name.as_str());
        Self::of(place, args, (case.name.as_str(), Some(case.right_half)), &folder, None)
    }

    /// That of the capture in `folder`, pictures at most `longest_side_px` a side.
    fn of(
        place: &Where,
        args: &Args,
        (name, right_half): (&str, Option<bool>),
        folder: &Path,
        longest_side_px: Option<usize>,
    ) -> anyhow::Result<Self> {
        let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
        let (longest_side_px, most_views) =
            if args.quick { (Some(QUICK_SIDE_PX), Some(QUICK_VIEWS)) } else { (longest_side_px, None) };
        let source = Source { folder, longest_side_px, most_views, skip_missing: args.skip_missing };
        let overlay = overlay_for(source.open()?.kind());
        let settings = args.settings_text()?;
        let mut overlays = vec![overlay];
        if args.quick {
            overlays.push(("the quick settings", QUICK_TOML));
        }
        overlays.push(("--settings", settings.as_str()));
        let base = TrainingSettings::given(Default::default(), Default::default());
        let config = training_settings(&base, &overlays)?.field;
        eprintln!("{name}: {} and what goes over it, {} steps", overlay.0, config.steps);
        let shares = if args.no_curves { vec![Share::WHOLE] } else { Share::budgets(args.long) };
        let name = name.to_owned();
        let (seed, curves) = (args.seed, !args.no_curves);
        Ok(Self { name, right_half, source, config, seed, shares, curves, out: args.out.clone() })
    }

    /// All of a capture's measurements. The trained fields stay in the folder.
    fn outcome(&self, children: &Children) -> anyhow::Result<Outcome> {
        let cameras = self.source.open()?.held_out_cameras();
        anyhow::ensure!(!cameras.is_empty(), "{} holds no view out to score on", self.source.folder.display());
        let mut budgets = Vec::new();
        for share in &self.shares {
            budgets.push(self.budget(children, *share)?);
        }
        let field = self.field(Share::WHOLE);
        let name = self.name.as_str();
        let serve = serve::Task { field: field.clone(), cameras: cameras.clone(), label: format!("{name}, rendering") };
        let served = children.run(&serve)?;
        if !self.curves {
            return Ok(Outcome { budgets, served, tradeoffs: Vec::new() });
        }
        let few: Vec<_> = cameras.iter().step_by(cameras.len().div_ceil(TRADEOFF_VIEWS)).copied().collect();
        let tradeoffs = tradeoff::Task { field, cameras: few, label: format!("{name}, limits of a render") };
        let tradeoffs = children.run(&tradeoffs)?;
        Ok(Outcome { budgets, served, tradeoffs })
    }

    /// A whole training with its own schedule, and its score.
    fn budget(&self, children: &Children, share: Share) -> anyhow::Result<Budget> {
        let config = FieldConfig { steps: share.of(self.config.steps), ..self.config.clone() };
        let (trained, scored) = self.trained(children, config, self.field(share), &share.of_the_steps())?;
        Ok(Budget { share, trained, scored })
    }

    /// A training under `config` into the file `field`, and its score; `what` is what people are told.
    fn trained(
        &self,
        children: &Children,
        config: FieldConfig,
        field: PathBuf,
        what: &str,
    ) -> anyhow::Result<(train::Trained, score::Scored)> {
        let name = self.name.as_str();
        let train = train::Task {
            source: self.source.clone(),
            config,
            seed: self.seed,
            stego: None,
            field: field.clone(),
            label: format!("{name}, training, {what}"),
        };
        let trained = children.run(&train)?;
        let score = score::Task {
            source: self.source.clone(),
            sheet: field.with_extension("png"),
            field,
            right_half: self.right_half.unwrap_or(trained.appearances),
            label: format!("{name}, scoring, {what}"),
        };
        Ok((trained, children.run(&score)?))
    }

    fn field(&self, share: Share) -> PathBuf {
        self.out.join(format!("{}-field-{}-{}.field", self.name, self.seed, share.to_string().replace('/', "-")))
    }
}
