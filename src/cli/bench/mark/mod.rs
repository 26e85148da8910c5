//! Suites `mark`, `honesty` and `ablation`: what stage 2 makes of captures' base fields. Each capture is
//! marked three times (or `--trainings`), with other seeds and other hidden pictures, and judged on
//! views that no training saw: pictures kept, hidden pictures recovered, classes
//! told, false owners on pictures of anything else, and what outlasts the ways
//! that pictures travel.
//!
//! Every training and judging runs in a process of its own, as in suite `field`.
//! Base fields stay in the folder and are taken again by a later run with the same
//! settings and seed: with marks made to last and without they are the same. So do their renders by the same program, in its folder `unmarked`.

mod ablations;
mod case;
mod harm;
mod judge;
mod kept;
mod laid;
mod permuted;
mod report;
pub mod scenes;
mod scored;
mod serve;
mod sheet;
mod skips;
mod train;
mod unmarked;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use cairn_field::FieldConfig;
use cairn_mark::Recipe;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::super::connect::Where;
use super::super::files::{open, read};
use super::Args;
use super::children::Children;
use super::field::source::Source;
use super::field::{Name, train as base, unless_stopped};
use super::rows::Rows;
use ablations::{Owners, Training};
use cairn_service::config::{TrainingSettings, overlay_for, training_settings};
use case::Case;

pub use judge::{Judged, Task as Judge, run as judge};
pub use serve::{Served, Task as Serve, run as serve};
use train::{Earlier, Files};
pub use train::{Marked, Task as Mark, run as mark};
use unmarked::Foreign;

/// What `--quick` lays over the settings: everything runs, nothing is good.
const QUICK_TOML: &str = "[field]\nsteps = 64\nrays_per_step = 512\nvoxels = 32768\nlevels = 2\n\
    [mark]\nsteps = 40\nvirtual_views = 1\nlongest_side_px = 64\nfiner = 1\nclassifier.channels = [16, 32, 64, 64]\n\
    classify_until = 10.0\n";
/// Pictures' longest side under `--quick`, px.
const QUICK_SIDE_PX: usize = 64;
/// Views of each split, at most, under `--quick`.
const QUICK_VIEWS: usize = 12;
/// Trainings of each capture, where it is not said how many: seeds from the one that was asked for on, and each its own hidden pictures.
const RUNS: u64 = 3;

/// Which of the marks' suites.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum What {
    /// Everything about a mark.
    Marks,
    /// Only what says whether answers come from the mark: strangers' marks, pictures
    /// without one, how sure the answers are.
    Honesty,
    /// One training each with a part of the method switched off (`ablations`).
    Ablation,
}

/// Measures the captures that were asked for and puts each one's rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows, what: What) -> anyhow::Result<()> {
    let trainings = ablations::wanted(what, &args.rows)?;
    let fern = [Name::Fern];
    let cases = case::wanted(if what == What::Ablation && args.cases.is_empty() { &fern } else { &args.cases });
    let captures = args.captures_with(cases.iter().map(|case| case.name))?;
    let pictures = pictures(args.signals.as_deref().unwrap_or(&captures.join("signals")))?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let unmarked = kept::of_this_program(&args.out.join("unmarked"))?;
    let children = Arc::new(Children::default());
    let mut runs = Vec::new();
    for case in cases {
        for training in &trainings {
            let mut run = Run::new(place, args, case, (&captures, &pictures), *training)?;
            (run.what, run.unmarked) = (what, unmarked.clone());
            // All base fields before any mark: other captures' renders are among what a detector is to be silent on.
            let work = tokio::task::spawn_blocking({
                let (run, children) = (run.clone(), children.clone());
                move || run.base(&children)
            });
            let base = unless_stopped(work, &children).await?;
            runs.push((run, training.name, base));
        }
    }
    let mut ablated: Vec<(&Case, &str, Outcome)> = Vec::new();
    for (run, ablation, base) in runs {
        let (name, case) = (run.name.clone(), run.case);
        let work = tokio::task::spawn_blocking({
            let children = children.clone();
            move || run.outcome(base, &children)
        });
        let outcome = unless_stopped(work, &children).await?;
        report::rows(rows, &name, (case, what), &outcome);
        if what == What::Ablation {
            ablated.push((case, ablation, outcome));
            let of_case = ablated.iter().filter(|(of, ..)| of.name == case.name);
            let of_case: Vec<_> = of_case.map(|(_, ablation, outcome)| (*ablation, outcome)).collect();
            skips::rows(rows, &format!("{}, skips", args.case_name(case.name.as_str())), &of_case);
        }
        rows.save(args)?;
    }
    println!("contact sheets and reliability tables in {}", args.out.display());
    Ok(())
}

/// The first sound and the first text beside a picture.
fn beside(picture: &Path) -> anyhow::Result<Files> {
    let folder = picture.parent().unwrap_or(Path::new("."));
    let first = |ending: &str| {
        let all = files(folder, &[ending])?;
        let problem =
            || format!("{} has no .{ending} to hide; say where there is one (--signals DIR)", folder.display());
        all.into_iter().next().with_context(problem)
    };
    Ok(Files { audio: Some(first("wav")?), text: Some(first("txt")?), picture: None })
}

/// The pictures of a folder, in order of file name.
pub(super) fn pictures(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let files = files(folder, &["png", "jpg"]).context("say where pictures to hide are (--signals DIR)")?;
    let problem = "has no PNG or JPEG; say where pictures to hide are (--signals DIR)";
    anyhow::ensure!(!files.is_empty(), "{} {problem}", folder.display());
    Ok(files)
}

/// Files with one of some endings, in order of file name.
fn files(folder: &Path, endings: &[&str]) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    files.retain(|path| path.extension().is_some_and(|e| endings.iter().any(|wanted| e.eq_ignore_ascii_case(wanted))));
    files.sort();
    Ok(files)
}

/// A capture's trainings.
#[derive(Default)]
pub struct Outcome {
    /// Stage 1, where it was trained in this run.
    pub base: Option<base::Trained>,
    /// Whether marks were trained to last.
    pub robust: bool,
    /// Each training and its judgement.
    pub runs: Vec<(Marked, Judged)>,
    /// The first training again with permuted identities, where it was asked for.
    pub permuted: Option<(Marked, Judged)>,
    /// The first training's marks, served; in suite `mark`.
    pub served: Option<Served>,
}

/// One capture's measurements, as they are asked for.
#[derive(Clone)]
struct Run {
    case: &'static Case,
    source: Source,
    /// Other captures, to be silent on.
    foreign: Vec<Foreign>,
    pictures: Vec<PathBuf>,
    /// A sound and a text, where the case hides them.
    others: Files,
    field: FieldConfig,
    mark: Recipe,
    owners: Owners,
    seed: u64,
    runs: u64,
    /// For which suite.
    what: What,
    name: String,
    out: PathBuf,
    /// Where renders without a mark are kept.
    unmarked: PathBuf,
}

impl Run {
    fn new(
        place: &Where,
        args: &Args,
        case: &'static Case,
        (captures, pictures): (&Path, &[PathBuf]),
        Training { name: ablation, over, owners }: Training,
    ) -> anyhow::Result<Self> {
        let sized = |folder: PathBuf| {
            let (longest_side_px, most_views) =
                if args.quick { (Some(QUICK_SIDE_PX), Some(QUICK_VIEWS)) } else { (None, None) };
            Source { folder, longest_side_px, most_views, skip_missing: false }
        };
        let folder = captures.join(case.name.as_str());
        let source = sized(folder.canonicalize().with_context(|| format!("cannot find {}", folder.display()))?);
        let overlay = overlay_for(source.open()?.kind());
        let settings = args.settings_text()?;
        let mut overlays = vec![overlay];
        if args.quick {
            overlays.push(("the quick settings", QUICK_TOML));
        }
        overlays.push(("--settings", settings.as_str()));
        overlays.push((ablation, over));
        let base = TrainingSettings::given(Default::default(), Default::default());
        let training = training_settings(&base, &overlays)?;
        let others = case::ALL.iter().filter(|name| **name != case.name).map(|name| captures.join(name.as_str()));
        let foreign = |folder: PathBuf| {
            let source = sized(folder);
            overlays[0] = overlay_for(source.open()?.kind());
            let field = field_of(&args.out, &source, &training_settings(&base, &overlays)?.field, args.seed)?;
            Ok(Foreign { source, field: Some(field) })
        };
        let foreign = others.filter(|folder| folder.is_dir()).map(foreign).collect::<anyhow::Result<_>>()?;
        Ok(Self {
            case,
            source,
            foreign,
            pictures: pictures.to_vec(),
            others: if case.all_kinds { beside(&pictures[0])? } else { Files::default() },
            field: training.field,
            mark: training.mark,
            owners,
            seed: args.seed,
            runs: args.trainings.unwrap_or(if args.quick || !ablation.is_empty() { 1 } else { RUNS }),
            what: What::Marks,
            name: match ablation {
                "" => args.case_name(case.name.as_str()),
                ablation => format!("{}, {ablation}", args.case_name(case.name.as_str())),
            },
            out: args.out.clone(),
            unmarked: args.out.join("unmarked"),
        })
    }

    /// All trainings on the base field that [`Run::base`] gave.
    fn outcome(
        mut self,
        (field, base): (PathBuf, Option<base::Trained>),
        children: &Children,
    ) -> anyhow::Result<Outcome> {
        self.leave_out_missing();
        let mut outcome = Outcome { base, robust: self.mark.robust.enabled, ..Outcome::default() };
        for run in 0..self.runs {
            outcome.runs.push(self.training(children, &field, (run, 0))?);
        }
        if self.what == What::Honesty && self.case.anchors > 1 {
            outcome.permuted = Some(self.training(children, &field, (0, 1))?);
        }
        if self.what == What::Marks {
            let [marked, detector] = ["marked", "detector"].map(|what| self.file((0, 0), what));
            let (cameras, label) = (self.source.open()?.held_out_cameras(), format!("{}, serving", self.name));
            outcome.served = Some(children.run(&Serve { marked, detector, cameras, label })?);
        }
        Ok(outcome)
    }

    /// Says of which other captures there is no base field in the folder, so that nobody is asked about its renders.
    fn leave_out_missing(&mut self) {
        for other in self.foreign.iter_mut().filter(|_| self.what != What::Ablation) {
            if other.field.as_ref().is_none_or(|field| field.is_file()) {
                continue;
            }
            other.field = None;
            let (name, out) = (other.name(), self.out.display());
            println!(
                "{}: SKIPPED renders of {name}: {out} has no base field of it by these settings; measure it too (--case {name})",
                self.name
            );
        }
    }

    /// Training `run` on the base field `field`, with identities `permuted` by so many, and its judgement.
    fn training(
        &self,
        children: &Children,
        field: &Path,
        (run, permuted): (u64, usize),
    ) -> anyhow::Result<(Marked, Judged)> {
        let told = if permuted > 0 { ", identities permuted" } else { "" };
        let label = |what: &str| format!("{}, {what}{told}, {} of {}", self.name, run + 1, self.runs);
        let file = |what: &str| self.file((run, permuted), what);
        let (anchors, neighbours) = self.clusters()?;
        let signals = (0..anchors).map(|i| {
            let at = run as usize * anchors + i;
            Files { picture: Some(self.pictures[at % self.pictures.len()].clone()), ..self.others.clone() }
        });
        let mut mark = Mark {
            source: self.source.clone(),
            base: field.to_owned(),
            config: self.mark.clone(),
            anchors,
            neighbours,
            permuted,
            signals: signals.collect(),
            earlier: None,
            seed: self.seed + run,
            marked: file("marked"),
            detector: file("detector"),
            label: label("marking"),
        };
        if self.owners == Owners::OneAndAnother {
            let (marked, detector) = (file("first.marked"), file("first.detector"));
            mark.earlier = Some(Earlier { marked: marked.clone(), detector: detector.clone() });
            let signals = mark.signals[..1].to_vec();
            let label = label("marking for the first");
            children.run(&Mark { anchors: 1, signals, earlier: None, marked, detector, label, ..mark.clone() })?;
        }
        let judge = Judge {
            source: self.source.clone(),
            foreign: self.foreign.clone(),
            marked: mark.marked.clone(),
            detector: mark.detector.clone(),
            signals: mark.signals.clone(),
            config: self.mark.clone(),
            permuted,
            right_half: self.case.right_half,
            base: field.to_owned(),
            unmarked: self.unmarked.clone(),
            sheet: file("png"),
            reliability: file("csv"),
            what: self.what,
            label: label("judging"),
        };
        Ok((children.run(&mark)?, children.run(&judge)?))
    }

    /// M and K; `None` for all views.
    fn clusters(&self) -> anyhow::Result<(usize, Option<usize>)> {
        if self.owners == Owners::Case {
            return Ok((self.case.anchors, self.case.neighbours));
        }
        Ok((2, Some(self.source.open()?.training().len() / 2)))
    }

    /// Where a training's result goes.
    fn file(&self, (run, permuted): (u64, usize), what: &str) -> PathBuf {
        let slug: String = self.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        let tag = if permuted > 0 { "-permuted" } else { "" };
        self.out.join(format!("{slug}-{}{tag}.{what}", self.seed + run))
    }

    /// The stored base field, trained where it is not there yet.
    fn base(&self, children: &Children) -> anyhow::Result<(PathBuf, Option<base::Trained>)> {
        let field = field_of(&self.out, &self.source, &self.field, self.seed)?;
        if field.is_file() {
            eprintln!("{}: the base field {} is there", self.name, field.display());
            return Ok((field, None));
        }
        let train = base::Task {
            source: self.source.clone(),
            config: self.field.clone(),
            seed: self.seed,
            stego: None,
            field: field.clone(),
            label: format!("{}, base field", self.name),
        };
        let trained = children.run(&train)?;
        Ok((field, Some(trained)))
    }
}

/// Where a capture's base field lies in `out`. Settings, seed and pictures make a field; the folder's place does not.
fn field_of(out: &Path, source: &Source, config: &FieldConfig, seed: u64) -> anyhow::Result<PathBuf> {
    let key = serde_json::to_vec(&(config, seed, source.longest_side_px, source.most_views))?;
    let key: String = Sha256::digest(key).iter().take(6).map(|byte| format!("{byte:02x}")).collect();
    let name = source.folder.file_name().unwrap_or_default().to_string_lossy();
    Ok(out.join(format!("{name}-{key}.field")))
}
