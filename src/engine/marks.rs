//! Stage 2 as the engine drives it: the plan from a scene, judging at fixed
//! steps, and what comes out.

use std::sync::Arc;

use cairn_capture::{Picture, SceneFolder};
use cairn_cluster::Clusters;
use cairn_stega::{MarkPlan, MarkTrainer, PlannedView};

pub use cairn_stega::{Detection, Detector, MarkedField};

use super::error::EngineError;
use super::stages::{Field, Stage, Step};
use crate::config::TrainingSettings;

/// Steps between judgements of a state on poses it was not trained on; fixed, so
/// that every run of a job judges at the same steps.
const JUDGE_EVERY: u64 = 50;

/// Trains the marked field and the detector, and keeps the best state judged.
pub struct Marking(MarkTrainer);

impl Marking {
    /// Stage 2 for the scene's training views, new or from a checkpoint. Works
    /// out every view's ray weights first.
    ///
    /// # Errors
    /// For photographs that were altered, settings out of range, a cluster without
    /// views, a checkpoint of another plan.
    pub fn start(
        scene: &SceneFolder,
        base: Field,
        clusters: &Clusters,
        signals: Vec<Picture>,
        settings: &TrainingSettings,
        seed: u64,
        checkpoint: Option<&[u8]>,
    ) -> Result<Self, EngineError> {
        let capture = scene.capture();
        let (mut views, mut negatives) = (Vec::new(), Vec::new());
        for index in capture.training() {
            let view = &capture.views[index];
            views.push(PlannedView { camera: view.camera, appearance: base.appearance_of(&view.name).clone() });
            // Photographs carry no mark: the detector has to stay silent on them.
            negatives.push(scene.photograph(index)?);
        }
        let plan = MarkPlan { clusters: clusters.clone(), views, signals, negatives };
        let base = Arc::new(base);
        Ok(Self(match checkpoint {
            Some(bytes) => MarkTrainer::resume(bytes, base, plan)?,
            None => MarkTrainer::new(base, plan, settings.mark.clone(), seed)?,
        }))
    }

    /// The marked field's and the detector's bytes, at the best state judged.
    ///
    /// # Errors
    /// When they cannot be written out.
    pub fn finish(self) -> Result<(Vec<u8>, Vec<u8>), EngineError> {
        if let Some(best) = self.0.best() {
            let (step, accuracy, ssim) = (best.step, best.accuracy, best.hidden_ssim);
            tracing::info!(step, accuracy, hidden_ssim = ssim, "best state on virtual poses");
        }
        let (field, detector) = self.0.finish()?;
        Ok((field.to_bytes()?, detector.to_bytes()?))
    }
}

impl Stage for Marking {
    fn step(&mut self) -> Result<Step, EngineError> {
        let stats = self.0.step()?;
        if stats.step.is_multiple_of(JUDGE_EVERY) || stats.step == stats.total {
            self.0.judge()?;
        }
        Ok(Step { loss: stats.loss, psnr_db: stats.kept_db })
    }

    fn steps(&self) -> (u64, u64) {
        (self.0.steps_done(), self.0.steps_total())
    }

    fn checkpoint(&self) -> Result<Vec<u8>, EngineError> {
        Ok(self.0.checkpoint()?)
    }
}
