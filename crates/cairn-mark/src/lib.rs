//! Stage 2 (StegaNeRF, ICCV 2023, for several owners): hide a signal of each
//! identity (a picture, a sound, a text) in what the field renders, and train with it the detector and the
//! classifier that recover it and say `unmarked` where there is none.
//!
//! Rooms: [`stega`] trains a mark by the paper's method, `detect` reads one (from the picture alone, or informed by the
//! field), `attack` is what happens to pictures on their way, and `payload` what is hidden. The outcome of a training
//! is a [`MarkedField`] and a [`Detector`].

mod attack;
mod detect;
mod emblem;
mod error;
mod marked;
mod payload;
mod progress;
pub mod stega;
mod tensors;
pub mod weave;

pub use attack::{Distortion, RobustConfig};
pub use detect::blind::detector::{DETECTOR_FORMAT, Detection, Detector};
pub use detect::informed::{BELIEVED, NotRegistered, RegisteredReader, RegisteredReading};
pub use detect::keyed::{Evidence, WAYS, chance, threshold};
pub use emblem::emblem;
pub use error::MarkError;
pub use marked::{MARKED_FORMAT, MarkedField};
pub use payload::{HeadSizes, Signal};
pub use stega::{
    CarrierKind, DensityKind, Earlier, Guidance, Judgement, Known, LossKind, MarkPlan, MarkScene, MarkStats,
    MarkTrainer, MaskKind, OtherColours, PlannedView, Recipe, Recovered, Restarted, Weakest, at_most, between,
    virtual_views,
};
