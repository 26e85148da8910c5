//! The radiance field: a sparse voxel grid with spherical harmonics, rendered and
//! differentiated by ray marching on the CPU, with per-view appearance.
//!
//! Each folder uses those before it, never one behind:
//!
//! - [`grid`]: densities and colours at vertices, which cells hold anything
//! - [`rays`]: [`SceneFrame`] bends a camera's rays into the unit cube, `march` finds the samples
//! - [`render`]: `composite` turns samples into light and walks back, `patch` sums what a tile's rays owe,
//!   `picture` renders whole views
//! - [`appearance`]: [`Appearance`] tints what a ray gathered as a view's day and camera had it
//! - [`io`]: safetensors files, tensor by tensor
//! - [`field`]: [`Field`], the outcome; views as linear maps for stage 2, and as marches where densities move as well
//! - [`train`]: [`BaseTrainer`], stage 1
//! - [`screening`]: which photographs the others do not explain
//!
//! The renderer is generic over [`Real`]: the same source is checked in f64
//! against finite differences and shipped in f32.

pub mod appearance;
mod chance;
mod config;
mod error;
pub mod field;
pub mod grid;
pub mod io;
pub mod rays;
pub mod render;
pub mod screening;
pub mod stats;
pub mod train;

pub use appearance::code::Appearance;
pub use chance::mixed;
pub use config::{AppearanceMode, FieldConfig};
pub use error::FieldError;
pub use field::basis::CarrierBasis;
pub use field::coverage::{CHANNELS, Mixed, OfPixel, Pixel, RowWeights, VisibleField};
pub use field::linear::{LinearView, MarkableField};
pub use field::marched::MarchedView;
pub use field::model::{CHANGE, FIELD_FORMAT, Field, Rendering};
pub use field::survey::only_what_shows;
pub use grid::real::Real;
pub use io::tensors::{Part, TensorFile, packed, read_header};
pub use rays::distance::distance;
pub use rays::frame::{RayPath, SceneFrame, contract};
pub use render::composite::Thresholds;
pub use screening::{Doubt, Screened, Screening, ViewScore};
pub use train::light::LightVerdict;
pub use train::spacing::Spacing;
pub use train::trainer::{BaseTrainer, StepStats};
pub use train::views::NamedView;
