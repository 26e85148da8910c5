//! From a camera's pixel to places in the grid: the scene's frame, lenses, and where along a ray samples lie.

pub mod distance;
pub mod frame;
pub mod lens;
pub mod march;
mod stretch;
