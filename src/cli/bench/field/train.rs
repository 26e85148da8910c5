//! A training as a part: from decoded photographs to the stored field.

use std::path::PathBuf;
use std::time::Instant;

use cairn_field::{BaseTrainer, FieldConfig};
use cairn_scene::Camera;
use serde::{Deserialize, Serialize};

use super::super::baseline::Stego;
use super::super::memory::peak_mib;
use super::progress::Progress;
use super::source::Source;
use super::tradeoff::{self, Error};

/// Views, at most, whose pictures are compared for what storing does.
const MOST_VIEWS: usize = 4;
/// Bytes of a MiB.
const MIB: f64 = 1024.0 * 1024.0;

/// What to train, and where its field goes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The capture.
    pub source: Source,
    /// Its settings; the schedule is that of `steps`.
    pub config: FieldConfig,
    /// The seed.
    pub seed: u64,
    /// How a picture is hidden in the photographs (suite `baseline`).
    pub stego: Option<Stego>,
    /// The file to store the field in.
    pub field: PathBuf,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trained {
    /// Seconds from decoded photographs to the finished field; neither decoding
    /// nor storing is in them.
    pub seconds: f64,
    /// Steps taken.
    pub steps: u64,
    /// Rays a second over those seconds.
    pub rays_per_s: f64,
    /// Rows of the grid at the end.
    pub rows: usize,
    /// Vertices of its lattice.
    pub vertices: usize,
    /// Whether those are more than configured, because the photographs asked for them.
    pub finer: bool,
    /// Whether views have appearances of their own.
    pub appearances: bool,
    /// The stored field, MiB.
    pub stored_mib: f64,
    /// The most memory held, photographs and storing included, MiB; `None` where
    /// the system does not tell.
    pub peak_mib: Option<f64>,
    /// What rounding colours as they are stored does to pictures of a few held-out views; `None` where none is held out.
    pub stored_error: Option<Error>,
}

/// Trains and stores.
///
/// # Errors
/// For photographs that do not decode, settings out of range, and the trainer's.
pub fn run(task: &Task) -> anyhow::Result<Trained> {
    let opened = task.source.open()?;
    let stego = task.stego.as_ref().map(Stego::open).transpose()?;
    let view = |index: usize| {
        let mut view = opened.view(index)?;
        if let Some(stego) = &stego {
            view.picture = stego.hide(&view.picture)?;
        }
        Ok(view.named())
    };
    let views = opened.training().into_iter().map(view).collect::<anyhow::Result<Vec<_>>>()?;
    let held_out = opened.held_out_cameras();
    let looked_at: Vec<Camera> = held_out.iter().step_by(held_out.len().div_ceil(MOST_VIEWS).max(1)).copied().collect();
    let (frame, background, rays) = (opened.frame()?, opened.background(), task.config.rays_per_step);
    drop(opened);
    let begun = Instant::now();
    let mut trainer = BaseTrainer::new(views, frame, background, task.config.clone(), task.seed)?;
    let mut progress = Progress::new(&task.label, trainer.steps_total());
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        progress.at(stats.step, &format!("{:.1} dB, ", stats.psnr_db));
    }
    drop(progress);
    let steps = trainer.steps_done();
    let (vertices, appearances) = (trainer.size().1.iter().product(), trainer.has_appearance());
    let finer = trainer.finer().is_some();
    let exact = trainer.finish_in_f32();
    let field = exact.clone().with_stored_colours();
    let seconds = begun.elapsed().as_secs_f64();
    let bytes = field.to_bytes()?;
    crate::cli::files::write(&task.field, &bytes)?;
    let peak_mib = peak_mib();
    let stored_error = (!looked_at.is_empty()).then(|| tradeoff::storing(&exact, &field, &looked_at));
    Ok(Trained {
        seconds,
        steps,
        rays_per_s: steps as f64 * rays as f64 / seconds.max(1e-9),
        // The first is the empty one.
        rows: field.grid().rows().saturating_sub(1),
        vertices,
        finer,
        appearances,
        stored_mib: bytes.len() as f64 / MIB,
        peak_mib,
        stored_error,
    })
}
