//! A stage of training as the engine drives it: make or resume a trainer, step
//! it, checkpoint it. Stage 1 stands here, stage 2 in [`crate::train::marks`].
//!
//! Making a trainer takes long where photographs or poses are many. It therefore
//! tells how far it is, part by part, and hears between them that it has to stop.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use cairn_field::{BaseTrainer, FieldConfig, LightVerdict, NamedView, SceneFrame, Screening, Spacing};
use cairn_scene::{SceneFolder, TrainView};

use crate::config::TrainingSettings;
use crate::error::EngineError;

/// Name of stage 1 in progress, jobs and reports.
pub const BASE: &str = "base field";
/// Name of screening, before stage 1.
pub const SCREENING: &str = "screening";
/// Name of working out which photograph taught what, after stage 1.
pub const SHARE_TABLE: &str = "share table";
/// Name of finding the keypoints that places have, after that.
pub const PLACES: &str = "index of places";
/// Name of stage 2.
pub const MARK: &str = "marked field";
/// Name of decoding the training views' photographs, before each stage.
pub const PHOTOGRAPHS: &str = "photographs";
/// Name of working out views as linear maps, before stage 2.
pub const RAY_WEIGHTS: &str = "ray weights";
/// Name of learning what marked renders look like, after stage 2.
pub const MARKED_RENDERS: &str = "marked renders";

/// Hears what is being prepared, how many parts of it are done and how many there
/// are; answers whether to go on.
pub type Preparing<'a> = &'a mut dyn FnMut(&'static str, usize, usize) -> bool;

/// A training that goes on by steps and can be put down and taken up between them.
pub trait Stage {
    /// Takes one step. One that fails and does not count MUST leave the state as it was: it is kept.
    ///
    /// # Errors
    /// What stopped the step, a number that is not finite among it.
    fn step(&mut self) -> Result<Step, EngineError>;
    /// Steps done, and steps in all.
    fn steps(&self) -> (u64, u64);
    /// The whole state.
    ///
    /// # Errors
    /// Where the state cannot be encoded.
    fn checkpoint(&self) -> Result<Vec<u8>, EngineError>;
    /// What was found out about the scene so far, each thing by itself.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
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

    fn notes(&self) -> Vec<String> {
        let light = match self.light() {
            LightVerdict::Settled | LightVerdict::Open => None,
            LightVerdict::OneLight { spread } => Some(format!(
                "the photographs share one light: appearances of their own were left out (they would explain errors of {:.1} % of the range, RMS)",
                100.0 * spread
            )),
            LightVerdict::ManyLights { spread } => Some(format!(
                "the photographs differ in light: every view has an appearance of its own (they explain errors of {:.1} % of the range, RMS)",
                100.0 * spread
            )),
        };
        let Spacing { apart_deg, smoothing } = self.spacing();
        let far = (smoothing > 1.0).then(|| {
            format!("the photographs look {apart_deg:.0} degrees apart: smoothness weighs {smoothing:.1} times as much")
        });
        let FieldConfig { voxels, voxel_px, min_voxel_px, .. } = self.config();
        let finer = self.finer().map(|vertices| {
            format!(
                "the last grid has {:.1} times the configured vertices, so that a voxel is {voxel_px} px wide or as near as may be",
                vertices as f64 / *voxels as f64
            )
        });
        let coarser = self.coarser().map(|vertices| {
            format!(
                "the photographs are small: the last grid has {:.2} of the configured vertices, so that no voxel is narrower than {min_voxel_px} px",
                vertices as f64 / *voxels as f64
            )
        });
        far.into_iter().chain(light).chain(finer).chain(coarser).collect()
    }
}

impl Stage for Screening {
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

/// The trainer of stage 1 for the scene's training views, new or from a checkpoint;
/// `None` when `preparing` did not want to go on.
///
/// # Errors
/// For photographs that were altered, settings out of range, a checkpoint of other views.
pub fn base_trainer(
    scene: &SceneFolder,
    photographs: &Photographs,
    settings: &TrainingSettings,
    seed: u64,
    checkpoint: Option<&[u8]>,
    preparing: Preparing<'_>,
) -> Result<Option<BaseTrainer>, EngineError> {
    let Some(views) = photographs.views(scene, preparing)? else { return Ok(None) };
    Ok(Some(match checkpoint {
        Some(bytes) => BaseTrainer::resume(bytes, views)?,
        None => {
            let (frame, background) = place(scene)?;
            BaseTrainer::new(views, frame, background, settings.field.clone(), seed)?
        }
    }))
}

/// Screening of the scene's training views, where those named in `trusted` are taken to be good; new
/// or from a checkpoint. `None` when `preparing` did not want to go on.
///
/// # Errors
/// As [`base_trainer`].
pub fn screening(
    scene: &SceneFolder,
    photographs: &Photographs,
    settings: &TrainingSettings,
    seed: u64,
    trusted: &BTreeSet<String>,
    checkpoint: Option<&[u8]>,
    preparing: Preparing<'_>,
) -> Result<Option<Screening>, EngineError> {
    let Some(views) = photographs.views(scene, preparing)? else { return Ok(None) };
    Ok(Some(match checkpoint {
        Some(bytes) => Screening::resume(bytes, views)?,
        None => {
            let (frame, background) = place(scene)?;
            Screening::new(views, trusted, frame, background, &settings.field, seed)?
        }
    }))
}

/// Where the scene lies, and what is behind it.
fn place(scene: &SceneFolder) -> Result<(SceneFrame, Option<[f32; 3]>), EngineError> {
    let capture = scene.capture();
    Ok((SceneFrame::from_views(capture, scene.kept())?, capture.background))
}

/// The photographs of one scene of a job: each is decoded once, for screening and for both stages.
#[derive(Default)]
pub struct Photographs {
    /// By name.
    decoded: Mutex<BTreeMap<String, Arc<TrainView>>>,
}

impl Photographs {
    /// The views to train on, decoded one after another where they are not yet; `None` when `preparing` did not want to
    /// go on.
    ///
    /// # Errors
    /// For photographs that were altered.
    pub fn views(&self, scene: &SceneFolder, preparing: Preparing<'_>) -> Result<Option<Vec<NamedView>>, EngineError> {
        let training: Vec<usize> = scene.training().collect();
        let mut decoded = self.decoded.lock().unwrap_or_else(PoisonError::into_inner);
        let mut views = Vec::with_capacity(training.len());
        for index in &training {
            if !preparing(PHOTOGRAPHS, views.len(), training.len()) {
                return Ok(None);
            }
            let name = scene.capture().views[*index].name.clone();
            let view = match decoded.get(&name) {
                Some(view) => view.clone(),
                None => Arc::new(scene.train_view(*index)?),
            };
            decoded.insert(name.clone(), view.clone());
            views.push(NamedView { name, view });
        }
        Ok(Some(views))
    }

    /// Lets them go: nothing that comes needs them.
    pub fn forget(&self) {
        self.decoded.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}
