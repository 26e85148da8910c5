//! The radiance field: a sparse voxel grid with spherical harmonics, rendered and
//! differentiated by ray marching on the CPU, with per-view appearance.
//!
//! Follow a picture through the files: [`SceneFrame`] bends a camera's rays into
//! the unit cube, `march` finds the samples, `composite` turns them into light
//! and walks back, `patch` sums what a tile's rays owe, `optimise` moves the grid, [`Appearance`] tints
//! the result as a view's day and camera had it; `picture` renders whole views. [`BaseTrainer`] drives them
//! (stage 1), [`Field`] is the outcome. Before it, [`Screening`] asks of each photograph whether the others explain it. What stage 2 needs is in [`operator`], and in [`marched`] where densities move as well.
//!
//! The renderer is generic over [`Real`]: the same source is checked in f64
//! against finite differences and shipped in f32.

pub mod appearance;
mod batch;
mod checkpoint;
mod cholesky;
mod codes;
pub mod composite;
mod config;
mod error;
mod field;
mod frame;
pub mod grid;
mod light;
pub mod lights;
mod lit;
pub mod march;
pub mod marched;
mod mean;
mod memory;
mod occupancy;
pub mod operator;
mod optimise;
mod overlay;
pub mod patch;
mod picture;
mod prepared;
mod prior;
pub mod rays;
mod real;
pub mod registration;
mod resolution;
mod sampling;
pub mod screening;
pub mod sh;
mod spacing;
mod stretch;
mod survey;
mod table;
mod tensors;
mod tints;
mod trainer;
mod watermark;
mod weights;

pub use appearance::Appearance;
pub use composite::Thresholds;
pub use config::{AppearanceMode, FieldConfig};
pub use error::FieldError;
pub use field::{FIELD_FORMAT, Field, LIT_FIELD_FORMAT, Rendering};
pub use frame::{RayPath, SceneFrame, contract};
pub use light::LightVerdict;
pub use lights::Colours;
pub use prepared::{KeptView, ToLearn, TrainingView};
pub use real::Real;
pub use screening::{QuarantineConfig, Screened, Screening, ScreeningOutcome, ViewFit};
pub use spacing::Spacing;
pub use tensors::TensorFile;
pub use trainer::{BaseTrainer, StepStats};
pub use watermark::{VisibleWatermark, watermarks};
