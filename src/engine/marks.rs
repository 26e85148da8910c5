//! Stage 2 at the engine's seam: the marked field's trainer and the detector.

use cairn_capture::{Camera, Picture};

use super::error::EngineError;
use super::stages::{Appearance, MarkPlan, Stage, Step};

/// The field after stage 2.
pub enum MarkedField {}

/// Reads marks out of pictures.
pub enum Detector {}

/// Trains both together.
pub enum MarkTrainer {}

/// What a detector says of a picture.
pub struct Detection {
    /// The identity; `None` for unmarked.
    pub identity: Option<u32>,
    /// Probability of each class; class 0 is `unmarked`.
    pub probabilities: Vec<f32>,
    /// The recovered hidden signal.
    pub recovered: Picture,
}

fn absent() -> EngineError {
    EngineError::Internal("this build cannot mark fields; train with --base-only".into())
}

impl MarkedField {
    /// Reads what training wrote.
    pub fn from_bytes(_bytes: &[u8]) -> Result<Self, EngineError> {
        Err(absent())
    }

    /// Renders; colours are not clamped.
    pub fn render(&self, _camera: &Camera, _appearance: &Appearance) -> Picture {
        match *self {}
    }
}

impl Detector {
    /// Reads what training wrote.
    pub fn from_bytes(_bytes: &[u8]) -> Result<Self, EngineError> {
        Err(absent())
    }

    /// Recovers and classifies.
    pub fn detect(&self, _picture: &Picture) -> Result<Detection, EngineError> {
        match *self {}
    }

    /// What it recovers when told that the picture is `identity`'s, whatever it
    /// shows: how much of a signal it knows by heart.
    pub fn recover_as(&self, _picture: &Picture, _identity: u32) -> Result<Picture, EngineError> {
        match *self {}
    }
}

impl MarkTrainer {
    /// New, or from a checkpoint.
    pub fn start(_plan: MarkPlan<'_>, _checkpoint: Option<&[u8]>) -> Result<Self, EngineError> {
        Err(absent())
    }

    /// The marked field's and the detector's bytes.
    pub fn finish(self) -> Result<(Vec<u8>, Vec<u8>), EngineError> {
        match self {}
    }
}

impl Stage for MarkTrainer {
    fn step(&mut self) -> Result<Step, EngineError> {
        match *self {}
    }

    fn steps(&self) -> (u64, u64) {
        match *self {}
    }

    fn checkpoint(&self) -> Result<Vec<u8>, EngineError> {
        match *self {}
    }
}
