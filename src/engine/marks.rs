//! Stage 2 as the engine drives it: the plan from a scene, judging at fixed
//! steps, and what comes out.

use std::sync::Arc;

use cairn_capture::SceneFolder;
use cairn_cluster::Clusters;
use cairn_stega::{MarkError, MarkPlan, MarkTrainer, PlannedView, Signal};

pub use cairn_stega::{Detection, Detector, MarkedField};

use super::error::EngineError;
use super::stages::{self, Field, Preparing, Stage, Step};
use crate::config::TrainingSettings;

/// Steps between judgements of a state on poses it was not trained on; fixed, so
/// that every run of a job judges at the same steps.
pub const JUDGE_EVERY: u64 = 50;

/// Trains the marked field and the detector, and keeps the best state judged.
pub struct Marking(MarkTrainer);

impl Marking {
    /// Stage 2 for the scene's training views, new or from a checkpoint. Works
    /// out every view's ray weights first; `None` when `preparing` did not want to
    /// go on.
    ///
    /// # Errors
    /// For photographs that were altered, settings out of range, a cluster without
    /// views, a checkpoint of another plan.
    pub fn start(
        scene: &SceneFolder,
        base: Field,
        (clusters, signals): (&Clusters, Vec<Signal>),
        (settings, seed): (&TrainingSettings, u64),
        checkpoint: Option<&[u8]>,
        preparing: Preparing<'_>,
    ) -> Result<Option<Self>, EngineError> {
        let capture = scene.capture();
        // Photographs carry no mark: the detector has to stay silent on them.
        let Some(negatives) = stages::photographs(scene, preparing)? else { return Ok(None) };
        let views = scene.training().map(|index| {
            let view = &capture.views[index];
            PlannedView { camera: view.camera, appearance: base.appearance_of(&view.name).clone() }
        });
        let plan = MarkPlan { clusters: clusters.clone(), views: views.collect(), signals, negatives };
        let base = Arc::new(base);
        let progress = &mut |done, total| preparing(stages::RAY_WEIGHTS, done, total);
        let made = match checkpoint {
            Some(bytes) => MarkTrainer::resume(bytes, base, plan, progress),
            None => MarkTrainer::new(base, plan, settings.mark.clone(), seed, progress),
        };
        match made {
            Ok(trainer) => Ok(Some(Self(trainer))),
            Err(MarkError::Stopped) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// The marked field's and the detector's bytes, at the best state judged.
    ///
    /// # Errors
    /// When they cannot be written out.
    pub fn finish(self) -> Result<(Vec<u8>, Vec<u8>), EngineError> {
        if let Some(best) = self.0.best() {
            let (step, accuracy, recovered) = (best.step, best.accuracy, best.recovered);
            tracing::info!(step, accuracy, ?recovered, "best state on virtual poses");
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
