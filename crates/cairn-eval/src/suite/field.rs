//! Suite `field`: what stage 1 makes of four captures at full size. Quality on views that no training saw, seconds, rays
//! a second and memory; with `--curves` also what a smaller budget gives, and what each limit of a render costs.
//!
//! Every training, scoring and timing runs in a process of its own, so that peak memory is that work's alone.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_field::FieldConfig;

use super::tradeoff::{Tradeoff, Tradeoffs};
use crate::args::Args;
use crate::captures::Name;
use crate::chart::{self, Axis, Line};
use crate::children::Children;
use crate::file;
use crate::results::Target;
use crate::rows::Rows;
use crate::settings::{self, QUICK_SIDE_PX};
use crate::source::Source;
use crate::trained::{Score, Scored, Serve, Served, Train, Trained};

/// Views to train on, and to score on, at most, in a quick run.
const QUICK_VIEWS: usize = 24;
/// Views that a render's limits are varied on.
const TRADEOFF_VIEWS: usize = 2;
/// Shares of the configured steps that `--curves` measures, beside all of them.
const SHARES: [(u64, &str); 3] = [(8, "1/8"), (4, "1/4"), (2, "1/2")];
/// Most memory that a training may take, MiB.
const MAX_TRAINING_MIB: f64 = 2048.0;
/// Most memory that rendering a stored field may take, MiB.
pub const MAX_SERVING_MIB: f64 = 500.0;

/// A capture's targets on two cores.
#[derive(Clone, Debug)]
struct Case {
    name: Name,
    /// Whether a held-out view's light is fitted on its left half and its right half is scored.
    right_half: bool,
    min_psnr_db: f64,
    /// On the mask, where the capture has masks.
    min_mask_psnr_db: Option<f64>,
    max_seconds: f64,
    min_rays_per_s: Option<f64>,
}

/// The captures, in the order they are measured.
const CASES: [Case; 4] = [
    case(Name::Fern, 27.0, 180.0),
    case(Name::Trex, 28.0, 240.0),
    Case { min_rays_per_s: Some(3e6), ..case(Name::Lego, 33.0, 360.0) },
    Case {
        right_half: true,
        min_mask_psnr_db: Some(23.0),
        min_rays_per_s: Some(3e6),
        ..case(Name::Liberty, 21.0, 600.0)
    },
];

const fn case(name: Name, min_psnr_db: f64, max_seconds: f64) -> Case {
    Case { name, right_half: false, min_psnr_db, min_mask_psnr_db: None, max_seconds, min_rays_per_s: None }
}

/// Measures the captures that were asked for and keeps each one's rows when it is whole.
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let wanted = |case: &&Case| args.cases.is_empty() || args.cases.contains(&case.name);
    let cases: Vec<&'static Case> = CASES.iter().filter(wanted).collect();
    let captures = args.captures_with(&cases.iter().map(|case| case.name).collect::<Vec<_>>())?;
    file::make_folder(&args.out)?;
    let children = Children::default();
    for case in cases {
        let run = Run::new(args, case, &captures)?;
        let outcome = children.unless_stopped(move |children| run.outcome(children)).await?;
        let name = args.case_name(case.name.as_str());
        add(rows, &name, case, &outcome);
        if !outcome.tradeoffs.is_empty() {
            draw(&args.out, &name, &outcome)?;
        }
        rows.save(args)?;
    }
    println!("contact sheets in {}", args.out.display());
    Ok(())
}

/// One capture's measurements, as they are asked for.
struct Run {
    case: &'static Case,
    source: Source,
    config: FieldConfig,
    seed: u64,
    curves: bool,
    out: PathBuf,
}

/// A training with a share of the configured steps, and its score.
struct Budget {
    share: &'static str,
    trained: Trained,
    scored: Scored,
}

/// Everything about a capture.
struct Outcome {
    whole: Budget,
    /// With fewer steps, fewest first.
    shares: Vec<Budget>,
    served: Served,
    tradeoffs: Vec<Tradeoff>,
}

impl Run {
    fn new(args: &Args, case: &'static Case, captures: &Path) -> anyhow::Result<Self> {
        let folder = captures.join(case.name.as_str());
        let folder = folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?;
        let longest_side_px = args.quick.then_some(QUICK_SIDE_PX);
        let source = Source { folder, longest_side_px, max_views: args.quick.then_some(QUICK_VIEWS) };
        let config = settings::of(source.open()?.kind(), args.quick, false).field;
        Ok(Self { case, source, config, seed: args.seed, curves: args.curves, out: args.out.clone() })
    }

    /// All of a capture's measurements. The trained fields stay in the folder.
    fn outcome(&self, children: &Children) -> anyhow::Result<Outcome> {
        let cameras = self.source.open()?.held_out_cameras();
        anyhow::ensure!(!cameras.is_empty(), "{} holds no view out to score on", self.source.folder.display());
        let mut shares = Vec::new();
        for (part, share) in SHARES.into_iter().filter(|_| self.curves) {
            shares.push(self.budget(children, self.config.steps.div_ceil(part), share)?);
        }
        let whole = self.budget(children, self.config.steps, "1")?;
        let (field, name) = (self.field("1"), self.case.name.as_str());
        let label = format!("{name}, rendering");
        let served = children.run(&Serve { field: field.clone(), cameras: cameras.clone(), label })?;
        let tradeoffs = if self.curves {
            let cameras = cameras.iter().step_by(cameras.len().div_ceil(TRADEOFF_VIEWS)).copied().collect();
            children.run(&Tradeoffs { field, cameras, label: format!("{name}, limits of a render") })?
        } else {
            Vec::new()
        };
        Ok(Outcome { whole, shares, served, tradeoffs })
    }

    /// A whole training with its own schedule, and its score.
    fn budget(&self, children: &Children, steps: u64, share: &'static str) -> anyhow::Result<Budget> {
        let (name, field) = (self.case.name.as_str(), self.field(share));
        let trained = children.run(&Train {
            source: self.source.clone(),
            config: FieldConfig { steps, ..self.config.clone() },
            seed: self.seed,
            without: Vec::new(),
            stego: None,
            field: field.clone(),
            label: format!("{name}, training, {share} of the steps"),
        })?;
        let scored = children.run(&Score {
            source: self.source.clone(),
            sheet: field.with_extension("png"),
            field,
            right_half: self.case.right_half,
            label: format!("{name}, scoring, {share} of the steps"),
        })?;
        Ok(Budget { share, trained, scored })
    }

    fn field(&self, share: &str) -> PathBuf {
        let (name, share) = (self.case.name.as_str(), share.replace('/', "-"));
        self.out.join(format!("{name}-field-{}-{share}.field", self.seed))
    }
}

/// Adds the rows of `outcome` as case `name`.
fn add(rows: &mut Rows, name: &str, case: &Case, outcome: &Outcome) {
    let Budget { trained, scored, .. } = &outcome.whole;
    let half = if scored.right_half { ", right half" } else { "" };
    rows.add(name, &format!("PSNR{half}"), scored.psnr_db, "dB", Some(Target::at_least(case.min_psnr_db)));
    rows.add(name, &format!("SSIM{half}"), scored.ssim, "", None);
    match (&scored.mask, case.min_mask_psnr_db) {
        (Some(mask), wanted) => {
            if mask.views < scored.views {
                let without = scored.views - mask.views;
                println!(
                    "{name}: {without} of {} views have none of their mask in the part that is scored",
                    scored.views
                );
            }
            let wanted = wanted.map(Target::at_least);
            rows.add(name, &format!("PSNR on the mask{half}"), mask.psnr_db, "dB", wanted);
        }
        (None, Some(_)) => println!("{name}: SKIPPED PSNR on the mask: the capture has no folder `masks`"),
        (None, None) => {}
    }
    rows.add(name, "training", trained.seconds, "s", Some(Target::at_most(case.max_seconds)));
    rows.add(name, "training steps", trained.steps as f64, "", None);
    rows.add(name, "training rays/s", trained.rays_per_s, "rays/s", None);
    rows.add(name, "stored field", trained.stored_mib, "MiB", None);
    let wanted = case.min_rays_per_s.map(Target::at_least);
    rows.add(name, "rendering rays/s", outcome.served.rays_per_s, "rays/s", wanted);
    memory(rows, name, "peak memory, training", trained.peak_mib, MAX_TRAINING_MIB);
    memory(rows, name, "peak memory, serving", outcome.served.peak_mib, MAX_SERVING_MIB);
    for Budget { share, trained, scored } in &outcome.shares {
        rows.add(name, &format!("PSNR{half}, {share} of the steps"), scored.psnr_db, "dB", None);
        rows.add(name, &format!("training, {share} of the steps"), trained.seconds, "s", None);
    }
    for found in &outcome.tradeoffs {
        rows.add(name, &format!("{}: max error", found.name), found.error.max, "levels", None);
        rows.add(name, &format!("{}: RMS error", found.name), found.error.rms, "levels", None);
        rows.add(name, &format!("{}: rendering", found.name), found.rays_per_s, "rays/s", None);
    }
}

fn memory(rows: &mut Rows, name: &str, metric: &str, mib: Option<f64>, max_mib: f64) {
    match mib {
        Some(mib) => rows.add(name, metric, mib, "MiB", Some(Target::at_most(max_mib))),
        None => println!("{name}: SKIPPED {metric}: this system has no VmHWM in /proc/self/status"),
    }
}

/// Draws what a smaller budget gives, and what each limit of a render costs.
fn draw(out: &Path, name: &str, outcome: &Outcome) -> anyhow::Result<()> {
    let slug: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    let budgets = outcome.shares.iter().chain([&outcome.whole]);
    let points = budgets.map(|budget| [budget.trained.seconds, budget.scored.psnr_db]).collect();
    let seconds = Axis { name: "Training, s", is_log: true };
    let psnr = Axis { name: "PSNR on held-out views, dB", is_log: false };
    let lines = [Line { name: name.to_owned(), points }];
    chart::draw(&out.join(format!("budgets-{slug}.svg")), "What a budget of training gives", seconds, psnr, &lines)?;
    let of = |found: &[Tradeoff]| Line {
        name: found[0].varied.clone(),
        points: found.iter().map(|found| [found.rays_per_s / 1e6, found.error.rms]).collect(),
    };
    let lines: Vec<Line> = outcome.tradeoffs.chunk_by(|a, b| a.varied == b.varied).map(of).collect();
    let rate = Axis { name: "Million rays/s", is_log: true };
    let error = Axis { name: "RMS error, 8-bit levels", is_log: true };
    chart::draw(&out.join(format!("tradeoffs-{slug}.svg")), "What each limit of a render costs", rate, error, &lines)
}
