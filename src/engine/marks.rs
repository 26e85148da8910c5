//! Stage 2 as the engine drives it: the plan from a scene, judging at fixed
//! steps, and what comes out.

use std::sync::Arc;

use cairn_capture::SceneFolder;
use cairn_cluster::Clusters;
use cairn_stega::{Earlier, Known, MarkConfig, MarkError, MarkPlan, MarkScene, MarkTrainer, PlannedView, Signal};

pub use cairn_stega::{Detector, MarkedField};

use super::error::EngineError;
use super::stages::{self, Field, Preparing, Stage, Step};

/// Steps between judgements of a state on poses it was not trained on; fixed, so
/// that every run of a job judges at the same steps.
pub const JUDGE_EVERY: u64 = 50;

/// Trains the marked fields and the detector, and keeps the best state judged.
pub struct Marking(MarkTrainer);

/// A scene to mark.
pub struct ToMark<'a> {
    /// The scene with the views to train on.
    pub scene: &'a SceneFolder,
    /// theta_0.
    pub base: Field,
    /// Over the scene's training views.
    pub clusters: &'a Clusters,
    /// What each identity hides.
    pub signals: Vec<Signal>,
}

/// What is gone on from. Identities are counted through all scenes.
pub struct Grown {
    /// What reads the earlier marks.
    pub detector: Detector,
    /// The earlier marked fields.
    pub fields: Vec<MarkedField>,
    /// Of each identity where it was: which field, its number there, its class; `None` for a new one.
    pub known: Vec<Option<(usize, u32, usize)>>,
    /// What each known identity hides.
    pub signals: Vec<Option<Signal>>,
}

impl Grown {
    fn earlier(&self) -> Earlier<'_> {
        let known = |(field, number, class): (usize, u32, usize)| {
            // None where marks have no carrier each: the trainer says so.
            let carrier = self.fields[field].carrier(number).unwrap_or_default();
            Known { class, carrier }
        };
        Earlier { detector: &self.detector, identities: self.known.iter().map(|k| k.map(known)).collect() }
    }
}

impl Marking {
    /// Stage 2 for the scenes' training views, new, from earlier models or from a checkpoint. Works
    /// out every view's ray weights first; `None` when `preparing` did not want to
    /// go on.
    ///
    /// # Errors
    /// For photographs that were altered, settings out of range, a cluster without
    /// views, a checkpoint of another plan, earlier models that do not fit.
    pub fn start(
        scenes: Vec<ToMark<'_>>,
        grown: Option<&Grown>,
        (settings, seed): (&MarkConfig, u64),
        checkpoint: Option<&[u8]>,
        preparing: Preparing<'_>,
    ) -> Result<Option<Self>, EngineError> {
        let mut planned = Vec::with_capacity(scenes.len());
        for ToMark { scene, base, clusters, signals } in scenes {
            let capture = scene.capture();
            // Photographs carry no mark: the detector has to stay silent on them.
            let Some(negatives) = stages::photographs(scene, preparing)? else { return Ok(None) };
            let views = scene.training().map(|index| {
                let view = &capture.views[index];
                PlannedView { camera: view.camera, appearance: base.appearance_of(&view.name).clone() }
            });
            let plan = MarkPlan { clusters: clusters.clone(), views: views.collect(), signals, negatives };
            planned.push(MarkScene { field: Arc::new(base), plan });
        }
        let progress = &mut |done, total| preparing(stages::RAY_WEIGHTS, done, total);
        let made = match (checkpoint, grown) {
            (Some(bytes), _) => MarkTrainer::resume_joint(bytes, planned, progress),
            (None, Some(grown)) => MarkTrainer::growing(planned, &grown.earlier(), settings.clone(), seed, progress),
            (None, None) => MarkTrainer::joint(planned, settings.clone(), seed, progress),
        };
        match made {
            Ok(trainer) => Ok(Some(Self(trainer))),
            Err(MarkError::Stopped) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// The marked fields' bytes, a scene each, and the detector's, at the best state judged.
    ///
    /// # Errors
    /// When they cannot be written out.
    pub fn finish(self) -> Result<(Vec<Vec<u8>>, Vec<u8>), EngineError> {
        if let Some(best) = self.0.best() {
            let (step, accuracy, recovered) = (best.step, best.accuracy, best.recovered);
            tracing::info!(step, accuracy, ?recovered, "best state on virtual poses");
        }
        let (fields, detector) = self.0.finish_joint()?;
        let fields = fields.iter().map(MarkedField::to_bytes).collect::<Result<_, _>>()?;
        Ok((fields, detector.to_bytes()?))
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
