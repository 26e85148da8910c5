//! Suite `scenes`: three captures marked in one training, with one detector and one
//! classifier for all (the paper's case II). *One for one*: each capture hides a picture of its
//! own; *one for all*: all of them the same.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use cairn_eval::Target;
use cairn_field::Field;
use cairn_mark::{Detector, MarkScene, MarkTrainer, MarkedField, Recipe, Signal};
use cairn_scene::metrics::psnr_db;
use serde::{Deserialize, Serialize};

use super::super::super::connect::Where;
use super::super::Args;
use super::super::children::Children;
use super::super::field::progress::Progress;
use super::super::field::source::Source;
use super::super::field::{Name, unless_stopped};
use super::super::memory::{peak_mib, processor_s};
use super::super::rows::Rows;
use super::ablations::AS_IT_IS;
use super::judge::{View, views};
use super::train::{Files, plan, signals};
use super::{Run, case, pictures};
use cairn_service::query::recovery::picture_ssim;
use cairn_service::query::report::PERFECT_DB;
use cairn_service::query::report::Right;
use cairn_service::train::marks::JUDGE_EVERY;

/// The captures that share a detector.
const CAPTURES: [Name; 3] = [Name::Fern, Name::Trex, Name::Lego];
/// Least hidden SSIM of each capture, one for one.
const HIDDEN_SSIM: f64 = 0.97;

/// What to mark together.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The captures, with their stored base fields, what each hides, and stage 2's settings of each.
    pub scenes: Vec<(Source, PathBuf, Files, Recipe)>,
    /// The seed.
    pub seed: u64,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Joined {
    /// Seconds from the loaded base fields to the finished detector.
    pub seconds: f64,
    /// Processor seconds, of all threads.
    pub processor_s: Option<f64>,
    /// Steps taken.
    pub steps: u64,
    /// The most memory held, MiB.
    pub peak_mib: Option<f64>,
    /// What was found of each capture's held-out views.
    pub scenes: Vec<Found>,
}

/// A capture's held-out views.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Found {
    /// Classes of all captures told right, of marked and base renders.
    pub classes: Right,
    /// Mean SSIM of what was recovered against what the capture hides.
    pub hidden_ssim: f64,
    /// Mean PSNR against the photographs: base, marked, dB.
    pub psnr_db: [f64; 2],
}

/// Trains and judges in this process.
///
/// # Errors
/// For files that do not read, settings out of range, and the trainer's.
pub fn run(task: &Task) -> anyhow::Result<Joined> {
    // As the engine does: one scene's networks, each scene's marks.
    let finest = Recipe::finest(task.scenes.iter().map(|(.., config)| config));
    let mut shared = task.scenes.get(finest).map(|(.., config)| config.clone()).unwrap_or_default();
    shared.min_confidence = Recipe::min_confidence_of(task.scenes.iter().map(|(.., config)| config));
    let (mut scenes, mut planned) = (Vec::new(), Vec::new());
    for (source, base, files, own) in &task.scenes {
        let field = Arc::new(Field::from_bytes(&super::read(base)?)?);
        let hidden = signals(std::slice::from_ref(files), &shared)?;
        planned.push((plan((&source.open()?, &field), (1, None), hidden, (task.seed, 0))?, field, own));
    }
    let begun = Instant::now();
    for (planned, field, own) in planned {
        let settings = Some(own.affording(planned.explained_db(&field)));
        scenes.push(MarkScene { field, plan: planned.plan, settings });
    }
    let mut weights = Progress::new(&format!("{}: ray weights", task.label), 1);
    let mut hear = |done: usize, total: usize| {
        weights.of(done as u64, total as u64);
        true
    };
    let mut trainer = MarkTrainer::joint(scenes, shared.clone(), task.seed, &mut hear)?;
    drop(weights);
    let mut progress = Progress::new(&task.label, trainer.steps_total());
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        if stats.step.is_multiple_of(JUDGE_EVERY) || stats.step == stats.total {
            trainer.judge()?;
        }
        progress.at(stats.step, &format!("{:.1} dB, ", stats.kept_db));
    }
    drop(progress);
    let steps = trainer.steps_done();
    let (fields, detector) = trainer.finish_joint(&mut |_, _| true)?;
    let seconds = begun.elapsed().as_secs_f64();
    let mut found = Vec::new();
    for (at, (marked, (source, _, files, _))) in fields.iter().zip(&task.scenes).enumerate() {
        let hidden = signals(std::slice::from_ref(files), &shared)?;
        found.push(judged(&detector, (at as u32, marked), &hidden[0], &views(&source.open()?, marked, false)?)?);
    }
    Ok(Joined { seconds, processor_s: processor_s(), steps, peak_mib: peak_mib(), scenes: found })
}

/// What the shared detector says of capture number `at`.
fn judged(
    detector: &Detector,
    (at, marked): (u32, &MarkedField),
    hidden: &Signal,
    views: &[View],
) -> anyhow::Result<Found> {
    anyhow::ensure!(marked.clusters().clusters.len() == 1, "a capture of one identity was asked for");
    let (mut found, mut count) = (Found::default(), 0.0);
    for view in views {
        let said = detector.detect(&view.marked)?;
        // One identity a capture: its class is the capture's number.
        let truth = (view.truth > 0).then_some(at + 1);
        found.classes.count(said.identity == truth);
        found.classes.count(detector.detect(&view.base)?.identity.is_none());
        found.psnr_db[0] += psnr_db(&view.photograph, &view.base)?.min(PERFECT_DB);
        found.psnr_db[1] += psnr_db(&view.photograph, &view.marked)?.min(PERFECT_DB);
        found.hidden_ssim += picture_ssim(hidden, &said)?.unwrap_or_default();
        count += 1.0;
    }
    anyhow::ensure!(count > 0.0, "a capture holds no view out to judge on");
    found.hidden_ssim /= count;
    found.psnr_db = found.psnr_db.map(|sum| sum / count);
    Ok(found)
}

/// Measures both ways of hiding and puts their rows into the ledger.
pub async fn measure(place: &Where, args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let captures = args.captures()?;
    let pictures = pictures(args.signals.as_deref().unwrap_or(&captures.join("signals")))?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let children = Arc::new(Children::default());
    let mut runs = Vec::new();
    for case in case::wanted(&CAPTURES) {
        runs.push(Run::new(place, args, case, (&captures, &pictures), AS_IT_IS)?);
    }
    for (how, same, target) in [("one for one", false, Some(HIDDEN_SSIM)), ("one for all", true, None)] {
        let (names, seed): (Vec<String>, u64) = (runs.iter().map(|run| run.name.clone()).collect(), args.seed);
        let work = tokio::task::spawn_blocking({
            let (children, pictures, label) =
                (children.clone(), pictures.clone(), format!("{}, {how}", names.join(", ")));
            let runs: Vec<Run> = runs.clone();
            move || {
                let mut scenes = Vec::new();
                for (at, run) in runs.iter().enumerate() {
                    let picture = pictures[if same { 0 } else { at % pictures.len() }].clone();
                    let files = Files { picture: Some(picture), ..Files::default() };
                    scenes.push((run.source.clone(), run.base(&children)?.0, files, run.mark.clone()));
                }
                children.run(&Task { scenes, seed, label })
            }
        });
        let joined = unless_stopped(work, &children).await?;
        for (name, found) in names.iter().zip(&joined.scenes) {
            let case = format!("{name}, of three scenes, {how}");
            rows.share(&case, "accuracy", found.classes, Some(1.0));
            rows.add(&case, "hidden SSIM", found.hidden_ssim, "", target.map(Target::at_least));
            rows.add(&case, "PSNR change by the mark", found.psnr_db[1] - found.psnr_db[0], "dB", None);
        }
        let case = args.case_name(&format!("three scenes, {how}"));
        rows.add(&case, "stage 2", joined.seconds, "s", None);
        rows.add(&case, "stage 2, steps", joined.steps as f64, "", None);
        for (metric, value, unit) in
            [("stage 2, processor time", joined.processor_s, "s"), ("stage 2, peak memory", joined.peak_mib, "MiB")]
        {
            if let Some(value) = value {
                rows.add(&case, metric, value, unit, None);
            }
        }
        rows.save(args)?;
    }
    Ok(())
}
