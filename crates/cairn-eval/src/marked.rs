//! Stage 2 as work: from a stored base field to marked field and detector, and both served by a fresh process.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use cairn_field::{Field, NamedView};
use cairn_mark::{Detector, Known, MarkPlan, MarkScene, MarkTrainer, MarkedField, PlannedView, Recipe, Signal};
use cairn_scene::Camera;
use cairn_scene::cluster::{ClusterConfig, Clusters, Grouping};
use cairn_service::query::evaluate::eight_bits;
use cairn_service::store::hidden::{Parts, decoded};
use cairn_service::train::marks::{JUDGE_EVERY, explained};
use serde::{Deserialize, Serialize};

use crate::children::Work;
use crate::file::{open, read, write};
use crate::memory::{peak_mib, processor_s};
use crate::progress::Progress;
use crate::source::{Opened, Source};
use crate::timing::{median, median_within};

/// Renders and readings of a view that are timed at most, and seconds after which no more are.
const LAPS: (usize, f64) = (3, 2.0);

/// Files of what one identity hides.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Files {
    /// A picture of any [`cairn_scene::ImageFormat`].
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
pub struct Mark {
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
    /// What is shown while it runs.
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

impl Work for Mark {
    const NAME: &'static str = "mark";
    type Result = Marked;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<Marked> {
        let base = Arc::new(Field::from_bytes(&read(&self.base)?)?);
        let opened = self.source.open()?;
        let signals = signals(&self.signals, &self.config)?;
        let planned = plan(&opened, &base, self.anchors, self.neighbours, signals, self.seed)?;
        drop(opened);
        let begun = Instant::now();
        let config = self.config.affording(planned.explained_db(&base));
        let (plan, budget_db) = (planned.plan, config.budget.then_some(config.budget_db));
        let mut weights = Progress::new(&format!("{}: ray weights", self.label), 1);
        let mut hear = |done: usize, total: usize| {
            weights.of(done as u64, total as u64);
            true
        };
        let mut trainer = match &self.earlier {
            None => MarkTrainer::new(base, plan, config, self.seed, &mut hear)?,
            Some(earlier) => going_on(earlier, MarkScene::new(base, plan), config, self.seed, &mut hear)?,
        };
        drop(weights);
        let prepared_s = begun.elapsed().as_secs_f64();
        let mut progress = Progress::new(&self.label, trainer.steps_total());
        while trainer.steps_done() < trainer.steps_total() {
            let stats = trainer.step()?;
            if stats.step.is_multiple_of(JUDGE_EVERY) || stats.step == stats.total {
                let judged = trainer.judge()?;
                let (right, attacked) = (100.0 * judged.accuracy, 100.0 * judged.attacked);
                let found = judged.recovered;
                eprintln!(
                    "{} step {}: cross-entropy {:.4}, kept {:.1} dB, {right:.0} % right, {attacked:.0} % attacked, {found:?}",
                    self.label, stats.step, stats.classify, stats.kept_db
                );
            }
            progress.at(stats.step, &format!("{:.1} dB, ", stats.kept_db));
        }
        drop(progress);
        let (steps, joined_at, most) = (trainer.steps_done(), trainer.joined_at(), trainer.config().steps);
        let (marked, detector) = trainer.finish()?;
        let seconds = begun.elapsed().as_secs_f64();
        write(&self.marked, &marked.to_bytes()?)?;
        write(&self.detector, &detector.to_bytes()?)?;
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
}

/// A training of `scene` that goes on from an `earlier` one of its first identities.
///
/// # Errors
/// For files that do not read, clusters that are others than then, and the trainer's.
fn going_on(
    earlier: &Earlier,
    scene: MarkScene,
    config: Recipe,
    seed: u64,
    hear: &mut dyn FnMut(usize, usize) -> bool,
) -> anyhow::Result<MarkTrainer> {
    let marked = MarkedField::from_bytes(&read(&earlier.marked)?)?;
    let detector = Detector::from_bytes(&read(&earlier.detector)?)?;
    let identities: Vec<_> = (1..=scene.plan.signals.len() as u32)
        .map(|number| marked.carrier(number).map(|carrier| Known { class: number as usize, carrier }))
        .collect();
    for number in (1..).take(identities.iter().flatten().count()) {
        let same = marked.clusters().anchor_pose(number) == scene.plan.clusters.anchor_pose(number);
        anyhow::ensure!(same, "identity {number} of {} has another anchor now", earlier.marked.display());
    }
    let earlier = cairn_mark::Earlier { detector: &detector, identities };
    Ok(MarkTrainer::growing(vec![scene], &earlier, config, seed, hear)?)
}

/// A capture's plan, and its photographs.
pub struct Planned {
    /// What is trained.
    pub plan: MarkPlan,
    /// Its views with their photographs.
    taken: Vec<NamedView>,
}

impl Planned {
    /// How well `base` explains the photographs, PSNR in dB: what marks may cost follows from it, as in the service.
    pub fn explained_db(&self, base: &Field) -> f64 {
        explained(base, &self.taken)
    }
}

/// A capture's plan: `anchors` clusters of so many `neighbours`, `None` for all views to train on.
///
/// # Errors
/// For photographs that do not read, and more clusters than views.
pub fn plan(
    opened: &Opened,
    base: &Field,
    anchors: usize,
    neighbours: Option<usize>,
    signals: Vec<Signal>,
    seed: u64,
) -> anyhow::Result<Planned> {
    let training = opened.training();
    // Over the training views alone, as the engine does: what is held out has no say in whose a pose is.
    let poses: Vec<_> = training.iter().map(|index| opened.camera(*index).pose).collect();
    let neighbours = neighbours.unwrap_or(poses.len()).min(poses.len() / anchors.max(1));
    let config = ClusterConfig { anchors, neighbours, ..ClusterConfig::default() };
    let clusters = Clusters::build(&poses, &Grouping::Anchors(config), &[], seed)?;
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
        let bytes = |path: &Option<PathBuf>| path.as_ref().map(|path| read(path)).transpose();
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

/// A fresh process that loads a stored marked field and its detector, renders views with their marks and reads them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ServeMarks {
    /// The stored marked field.
    pub marked: PathBuf,
    /// The stored detector.
    pub detector: PathBuf,
    /// From where.
    pub cameras: Vec<Camera>,
    /// What is shown while it runs.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ServedMarks {
    /// Rays a second of renders with a mark (without, where a pose is nobody's): the median over views.
    pub rays_per_s: f64,
    /// Seconds to say whose a picture is and what it hides: the median over views.
    pub reading_s: f64,
    /// The same of renders of the base field, which are looked at more closely.
    pub reading_unmarked_s: f64,
    /// The most memory held, MiB; `None` where the system does not say.
    pub peak_mib: Option<f64>,
}

impl Work for ServeMarks {
    const NAME: &'static str = "serve-marks";
    type Result = ServedMarks;

    fn label(&self) -> &str {
        &self.label
    }

    /// Renders in the field's own appearance.
    fn run(&self) -> anyhow::Result<ServedMarks> {
        let marked =
            MarkedField::read_from(&mut open(&self.marked)?).with_context(|| self.marked.display().to_string())?;
        let detector = Detector::from_bytes(&read(&self.detector)?)?;
        let appearance = marked.base().canonical_appearance().clone();
        let mut progress = Progress::new(&self.label, self.cameras.len() as u64);
        let (mut rates, mut reading, mut reading_unmarked) = (Vec::new(), Vec::new(), Vec::new());
        for camera in &self.cameras {
            progress.at(rates.len() as u64, "");
            let seconds = median_within(LAPS.0, LAPS.1, || marked.render(camera, &appearance));
            rates.push((camera.intrinsics.width * camera.intrinsics.height) as f64 / seconds.max(1e-9));
            let renders = [marked.render(camera, &appearance), marked.base().render(camera, &appearance)];
            for (render, seconds) in renders.iter().zip([&mut reading, &mut reading_unmarked]) {
                let picture = eight_bits(render)?;
                detector.detect(&picture)?;
                seconds.push(median_within(LAPS.0, LAPS.1, || detector.detect(&picture)));
            }
        }
        let no_view = "there is no view to render";
        let [rays_per_s, reading_s, reading_unmarked_s] = [&rates, &reading, &reading_unmarked].map(|all| median(all));
        Ok(ServedMarks {
            rays_per_s: rays_per_s.context(no_view)?,
            reading_s: reading_s.context(no_view)?,
            reading_unmarked_s: reading_unmarked_s.context(no_view)?,
            peak_mib: peak_mib(),
        })
    }
}
