//! Suite `scenes`: three captures marked in one training, with one detector and one
//! classifier for all (the paper's case II). *One for one*: each capture hides a picture of its
//! own; *one for all*: all of them the same.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use cairn_field::Field;
use cairn_mark::{Detector, MarkScene, MarkTrainer, MarkedField, Recipe, Signal};
use cairn_scene::metrics::psnr_db;
use cairn_service::query::recovery::picture_ssim;
use cairn_service::query::report::PERFECT_DB;
use cairn_service::query::report::Right;
use cairn_service::train::marks::JUDGE_EVERY;
use serde::{Deserialize, Serialize};

use crate::args::Args;
use crate::captures::Name;
use crate::children::{Children, Work};
use crate::file::{self, read};
use crate::marked::{Files, plan, signals};
use crate::marks::judge::views;
use crate::marks::judged::View;
use crate::marks::run::{AS_IT_IS, Run, cases};
use crate::memory::{peak_mib, processor_s};
use crate::progress::Progress;
use crate::results::Target;
use crate::rows::Rows;
use crate::source::Source;

/// The captures that share a detector.
const CAPTURES: [Name; 3] = [Name::Fern, Name::Trex, Name::Lego];
/// Least hidden SSIM of each capture, one for one.
const MIN_HIDDEN_SSIM: f64 = 0.97;

/// What to mark together.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Join {
    /// The captures.
    pub scenes: Vec<Scene>,
    /// The seed.
    pub seed: u64,
    /// What is shown while it runs.
    pub label: String,
}

/// A capture that is marked together with others.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scene {
    /// Where it lies.
    pub source: Source,
    /// Its stored base field.
    pub base: PathBuf,
    /// What it hides.
    pub files: Files,
    /// Stage 2's settings of it.
    pub config: Recipe,
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
    /// Classes predicted right, of marked and base renders.
    pub classes: Right,
    /// Mean SSIM of what was recovered against what the capture hides.
    pub hidden_ssim: f64,
    /// Mean PSNR against the photographs: base, marked, dB.
    pub psnr_db: [f64; 2],
}

impl Work for Join {
    const NAME: &'static str = "join";
    type Result = Joined;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Joined> {
        join(self)
    }
}

fn join(task: &Join) -> anyhow::Result<Joined> {
    // As the engine does: one scene's networks, each scene's marks.
    let finest = Recipe::finest(task.scenes.iter().map(|scene| &scene.config));
    let mut shared = task.scenes.get(finest).map(|scene| scene.config.clone()).unwrap_or_default();
    shared.min_confidence = Recipe::min_confidence_of(task.scenes.iter().map(|scene| &scene.config));
    let (mut scenes, mut planned) = (Vec::new(), Vec::new());
    for scene in &task.scenes {
        let field = Arc::new(Field::from_bytes(&read(&scene.base)?)?);
        let hidden = signals(std::slice::from_ref(&scene.files), &shared)?;
        planned.push((plan(&scene.source.open()?, &field, 1, None, hidden, task.seed)?, field, &scene.config));
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
    for (number, (marked, scene)) in (1..).zip(fields.iter().zip(&task.scenes)) {
        let hidden = signals(std::slice::from_ref(&scene.files), &shared)?;
        found.push(judged(&detector, number, marked, &hidden[0], &views(&scene.source.open()?, marked, false)?)?);
    }
    Ok(Joined { seconds, processor_s: processor_s(), steps, peak_mib: peak_mib(), scenes: found })
}

/// What the shared detector says of capture `number`, from 1.
fn judged(
    detector: &Detector,
    number: u32,
    marked: &MarkedField,
    hidden: &Signal,
    views: &[View],
) -> anyhow::Result<Found> {
    anyhow::ensure!(marked.clusters().clusters.len() == 1, "a capture of one identity was asked for");
    let (mut found, mut count) = (Found::default(), 0.0);
    for view in views {
        let said = detector.detect(&view.marked)?;
        // One identity a capture: its class is the capture's number.
        let truth = (view.truth > 0).then_some(number);
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

/// Measures both ways of hiding.
///
/// # Errors
/// For captures that are not there, and whatever goes wrong in a training.
pub async fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let (captures, pictures) = (args.captures_with(&CAPTURES)?, args.pictures()?);
    file::make_folder(&args.out)?;
    let children = Children::default();
    let mut runs = Vec::new();
    for case in cases(&CAPTURES) {
        runs.push(Run::new(args, case, &captures, &pictures, &AS_IT_IS)?);
    }
    let names: Vec<String> = runs.iter().map(|run| run.name.clone()).collect();
    for (how, same, target) in [("one for one", false, Some(MIN_HIDDEN_SSIM)), ("one for all", true, None)] {
        let (runs, pictures, seed) = (runs.clone(), pictures.clone(), args.seed);
        let label = format!("{}, {how}", names.join(", "));
        let work = move |children: &Children| {
            let mut scenes = Vec::new();
            for (at, run) in runs.iter().enumerate() {
                let picture = pictures[if same { 0 } else { at % pictures.len() }].clone();
                let files = Files { picture: Some(picture), ..Files::default() };
                let base = run.base(children)?.file;
                scenes.push(Scene { source: run.source.clone(), base, files, config: run.mark.clone() });
            }
            children.run(&Join { scenes, seed, label })
        };
        let joined = children.unless_stopped(work).await?;
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
