//! From samples to light, and back: compositing along rays, tiles of rays that share vertices, whole pictures.

pub mod composite;
pub mod patch;
pub(crate) mod picture;
pub(crate) mod tints;
