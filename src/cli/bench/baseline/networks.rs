//! DeepStega's networks as a part: trained on the photographs that stage 1 learns from.

use std::path::PathBuf;
use std::time::Instant;

use cairn_mark::{DeepConfig, DeepTrainer};
use serde::{Deserialize, Serialize};

use super::super::decoded;
use super::super::field::progress::Progress;
use super::super::field::source::Source;
use super::super::memory::peak_mib;

/// What to train on, and where the networks go.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The capture; its held-out photographs are not looked at.
    pub source: Source,
    /// Files of the pictures that are hidden in training, among others.
    pub hidden: Vec<PathBuf>,
    /// The networks' settings.
    pub config: DeepConfig,
    /// The seed.
    pub seed: u64,
    /// The file for the networks.
    pub networks: PathBuf,
    /// What people are told.
    pub label: String,
}

/// How it went.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Networks {
    /// Seconds from decoded photographs to trained networks.
    pub seconds: f64,
    /// Steps taken.
    pub steps: u64,
    /// The most memory held, photographs and storing included, MiB; `None` where the system does not tell.
    pub peak_mib: Option<f64>,
}

/// Trains and stores.
///
/// # Errors
/// For photographs that do not decode, and the trainer's.
pub fn run(task: &Task) -> anyhow::Result<Networks> {
    let opened = task.source.open()?;
    let photograph = |index: usize| Ok(opened.view(index)?.picture);
    let photographs = opened.training().into_iter().map(photograph).collect::<anyhow::Result<Vec<_>>>()?;
    let hidden = task.hidden.iter().map(|path| decoded(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let begun = Instant::now();
    let mut trainer = DeepTrainer::new(photographs, &hidden, task.config.clone(), task.seed)?;
    let mut progress = Progress::new(&task.label, trainer.steps_total());
    while trainer.steps_done() < trainer.steps_total() {
        let stats = trainer.step()?;
        progress.at(stats.step, &format!("kept {:.1} dB, revealed {:.1} dB, ", stats.cover_db, stats.revealed_db));
    }
    drop(progress);
    let steps = trainer.steps_done();
    let networks = trainer.finish();
    let seconds = begun.elapsed().as_secs_f64();
    crate::cli::files::write(&task.networks, &networks.to_bytes()?)?;
    Ok(Networks { seconds, steps, peak_mib: peak_mib() })
}
