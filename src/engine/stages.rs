//! A stage of training as the engine drives it: make or resume a trainer, step
//! it, checkpoint it. Stage 1 stands here, stage 2 in [`super::marks`].

use std::sync::Arc;

use cairn_capture::SceneFolder;
use cairn_field::{BaseTrainer, SceneFrame, TrainingView};

pub use cairn_field::{Appearance, Field};

use super::error::EngineError;
use crate::config::TrainingSettings;

/// Name of stage 1 in progress, jobs and reports.
pub const BASE: &str = "base field";
/// Name of stage 2.
pub const MARK: &str = "marked field";

/// A training that goes on by steps and can be put down and taken up between them.
pub trait Stage {
    /// Takes one step.
    fn step(&mut self) -> Result<Step, EngineError>;
    /// Steps done, and steps in all.
    fn steps(&self) -> (u64, u64);
    /// The whole state.
    fn checkpoint(&self) -> Result<Vec<u8>, EngineError>;
}

/// What a step says of itself.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The loss.
    pub loss: f64,
    /// PSNR, dB; 0 where the stage has none.
    pub psnr_db: f64,
}

impl Stage for BaseTrainer {
    fn step(&mut self) -> Result<Step, EngineError> {
        let stats = Self::step(self)?;
        Ok(Step { loss: stats.loss, psnr_db: stats.psnr_db })
    }

    fn steps(&self) -> (u64, u64) {
        (self.steps_done(), self.steps_total())
    }

    fn checkpoint(&self) -> Result<Vec<u8>, EngineError> {
        Ok(Self::checkpoint(self)?)
    }
}

/// The trainer of stage 1 for the scene's training views, new or from a checkpoint.
///
/// # Errors
/// For photographs that were altered, settings out of range, a checkpoint of other views.
pub fn base_trainer(
    scene: &SceneFolder,
    settings: &TrainingSettings,
    seed: u64,
    checkpoint: Option<&[u8]>,
) -> Result<BaseTrainer, EngineError> {
    let capture = scene.capture();
    let mut views = Vec::new();
    for index in capture.training() {
        let view = &capture.views[index];
        let picture = Arc::new(scene.photograph(index)?);
        views.push(TrainingView { name: view.name.clone(), camera: view.camera, picture });
    }
    Ok(match checkpoint {
        Some(bytes) => BaseTrainer::resume(bytes, views)?,
        None => {
            let frame = SceneFrame::from_capture(capture)?;
            BaseTrainer::new(views, frame, capture.background, settings.field.clone(), seed)?
        }
    })
}
