//! Stage 1: from photographs to a field.

mod batch;
pub(crate) mod checkpoint;
mod codes;
pub(crate) mod light;
mod mean;
mod optimise;
mod resolution;
#[cfg(test)]
mod rounding_tests;
mod sampling;
pub(crate) mod shown;
pub mod spacing;
pub(crate) mod trainer;
pub(crate) mod views;
