//! Stage 2 as a part: from a stored base field to marked field and detector.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use cairn_field::{Field, NamedView};
use cairn_mark::{Detector, Known, MarkPlan, MarkScene, MarkTrainer, MarkedField, PlannedView, Recipe, Signal};
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use serde::{Deserialize, Serialize};

use super::super::field::progress::Progress;
use super::super::field::source::{Opened, Source};
use super::super::memory::{peak_mib, processor_s};
use cairn_service::store::hidden::{Parts, decoded};
use cairn_service::train::marks::{JUDGE_EVERY, explained};

/// Files of what one identity hides.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Files {
    /// PNG or JPEG.
    pub picture: Option<PathBuf>,
    /// WAV.
    pub audio: Option<PathBuf>,
    /// UTF-8.
    pub text: Option<PathBuf>,
}

/// What an earlier training stored. Its identities are the first of those that are trained now.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Earlier {
    /// The marked field.
    pub marked: PathBuf,
    /// The detector.
    pub detector: PathBuf,
}

/// What to mark, and where the result goes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The capture.
    pub source: Source,
    /// The stored base field.
    pub base: PathBuf,
    /// Stage 2's settings.
    pub config: Recipe,
    /// M.
    pub anchors: usize,
    /// K; `None` for all views.
    pub neighbours: Option<usize>,
    /// By how many identities the clusters' owners are permuted, counted round; 0 leaves them.
    pub permuted: usize,
    /// Files of what each identity hides.
    pub signals: Vec<Files>,
    /// What is gone on from, if anything.
    pub earlier: Option<Earlier>,
    /// The seed.
    pub seed: u64,
    /// The file for the marked field.
    pub marked: PathBuf,
    /// The file for the detector.
    pub detector: PathBuf,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Marked {
    /// Seconds from the loaded base field to the finished detector.
    pub seconds: f64,
    /// Processor seconds, of all threads; loading and storing are in them.
    pub processor_s: Option<f64>,
    /// Of the seconds, those before the first step: ray weights, and what marks may cost.
    pub prepared_s: f64,
    /// How far below the base field's renders marks were kept, PSNR in dB; `None` without a budget.
    pub budget_db: Option<f64>,
    /// Steps taken.
    pub steps: u64,
    /// After how many of them the detector joined.
    pub joined_at: Option<u64>,
    /// Whether training ended before its last step.
    pub converged: bool,
    /// The most memory held, MiB.
    pub peak_mib: Option<f64>,
}

/// Trains and stores.
///
/// # Errors
/// For files that do not read, settings out of range, and the trainer's.
pub fn run(task: &Task) -> anyhow::Result<Marked> {
    let base = Arc::new(Field::from_bytes(&super::read(&task.base)?)?);
    let opened = task.source.open()?;
    let signals = signals(&task.signals, &task.config)?;
    let planned = plan((&opened, &base), (task.anchors, task.neighbours), signals, (task.seed, task.permuted))?;
    drop(opened);
    let begun = Instant::now();
    let config = task.config.affording(planned.explained_db(&base));
    let (plan, budget_db) = (planned.plan, config.budget.then_some(config.budget_db));
    let mut weights = Progress::new(&format!("{}: ray weights", task.label), 1);
    let mut hear = |done: usize, total: usize| {
        weights.of(done as u64, total as u64);
        true
    };
    let mut trainer = match &task.earlier {
        None => MarkTrainer::new(base, plan, config, task.seed, &mut hear)?,
        Some(earlier) => going_on(earlier, (base, plan), (config, task.seed), &mut hear)?,
    };
    drop(weights);
    let prepared_s = begun.elapsed().as_secs_f64();
    let mut progress = Progress::new(&task.label, trainer.steps_total());
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        if stats.step.is_multiple_of(JUDGE_EVERY) || stats.step == stats.total {
            let judged = trainer.judge()?;
            let (right, attacked) = (100.0 * judged.accuracy, 100.0 * judged.attacked);
            let found = judged.recovered;
            eprintln!(
                "{} step {}: cross-entropy {:.4}, kept {:.1} dB, {right:.0} % right, {attacked:.0} % attacked, {found:?}",
                task.label, stats.step, stats.classify, stats.kept_db
            );
        }
        progress.at(stats.step, &format!("{:.1} dB, ", stats.kept_db));
    }
    drop(progress);
    let (steps, joined_at, most) = (trainer.steps_done(), trainer.joined_at(), trainer.config().steps);
    let (marked, detector) = trainer.finish()?;
    let seconds = begun.elapsed().as_secs_f64();
    crate::cli::files::write(&task.marked, &marked.to_bytes()?)?;
    crate::cli::files::write(&task.detector, &detector.to_bytes()?)?;
    Ok(Marked {
        seconds,
        processor_s: processor_s(),
        prepared_s,
        budget_db,
        steps,
        joined_at,
        converged: steps < most,
        peak_mib: peak_mib(),
    })
}

/// A training of `plan` that goes on from an `earlier` one of its first identities.
///
/// # Errors
/// For files that do not read, clusters that are others than then, and the trainer's.
fn going_on(
    earlier: &Earlier,
    (field, plan): (Arc<Field>, MarkPlan),
    (config, seed): (Recipe, u64),
    hear: &mut dyn FnMut(usize, usize) -> bool,
) -> anyhow::Result<MarkTrainer> {
    let marked = MarkedField::from_bytes(&super::read(&earlier.marked)?)?;
    let detector = Detector::from_bytes(&super::read(&earlier.detector)?)?;
    let identities: Vec<_> = (1..=plan.signals.len() as u32)
        .map(|number| marked.carrier(number).map(|carrier| Known { class: number as usize, carrier }))
        .collect();
    for number in (1..).take(identities.iter().flatten().count()) {
        let same = marked.clusters().anchor_pose(number) == plan.clusters.anchor_pose(number);
        anyhow::ensure!(same, "identity {number} of {} has another anchor now", earlier.marked.display());
    }
    let earlier = cairn_mark::Earlier { detector: &detector, identities };
    Ok(MarkTrainer::growing(vec![MarkScene::new(field, plan)], &earlier, config, seed, hear)?)
}

/// A capture's plan, and its photographs.
pub(super) struct Planned {
    /// What is trained.
    pub plan: MarkPlan,
    /// Its views with their photographs.
    taken: Vec<NamedView>,
}

impl Planned {
    /// How well `base` explains the photographs, PSNR in dB: what marks may cost hangs on it, here as in the engine.
    pub fn explained_db(&self, base: &Field) -> f64 {
        explained(base, &self.taken)
    }
}

/// A capture's plan: `anchors` clusters of so many `neighbours`, `None` for all views to train on; identities are `permuted`
/// by so many.
///
/// # Errors
/// For photographs that do not read, and more clusters than views.
pub(super) fn plan(
    (opened, base): (&Opened, &Field),
    (anchors, neighbours): (usize, Option<usize>),
    signals: Vec<Signal>,
    (seed, permuted): (u64, usize),
) -> anyhow::Result<Planned> {
    let training = opened.training();
    // Over the training views alone, as the engine does: what is held out has no say in whose a pose is.
    let poses: Vec<_> = training.iter().map(|index| opened.camera(*index).pose).collect();
    let neighbours = neighbours.unwrap_or(poses.len()).min(poses.len() / anchors.max(1));
    let config = ClusterConfig { anchors, neighbours, ..ClusterConfig::default() };
    let clusters = Clusters::build(&poses, &Grouping::Anchors(config), &[], seed)?.permuted(permuted);
    let views = training.iter().map(|index| {
        let view = opened.view(*index)?;
        let planned = PlannedView { camera: view.camera, appearance: base.appearance_of(&view.name).clone() };
        Ok((planned, view.named()))
    });
    let (views, taken): (_, Vec<_>) = views.collect::<anyhow::Result<Vec<_>>>()?.into_iter().unzip();
    let negatives = taken.iter().map(|view: &NamedView| view.view.rgb8.clone()).collect();
    Ok(Planned { plan: MarkPlan { clusters, views, signals, negatives }, taken })
}

/// Reads what identities hide.
///
/// # Errors
/// For files that do not read, decode or fit.
pub fn signals(files: &[Files], config: &Recipe) -> anyhow::Result<Vec<Signal>> {
    let signal = |(at, files): (usize, &Files)| {
        let bytes = |path: &Option<PathBuf>| path.as_ref().map(|path| super::read(path)).transpose();
        let parts = Parts { picture: bytes(&files.picture)?, audio: bytes(&files.audio)?, text: bytes(&files.text)? };
        let mut signal = decoded(&parts)?;
        if let Some(sound) = &signal.audio {
            signal.audio = Some(sound.resampled(config.audio.sample_rate_hz)?);
        }
        signal.check(at + 1, config)?;
        Ok(signal)
    };
    files.iter().enumerate().map(signal).collect()
}
