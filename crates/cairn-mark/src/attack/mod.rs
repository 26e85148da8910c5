//! What people and programs do to pictures: each distortion with its gradient, and what a training draws of them.

mod blur;
mod distortion;
mod jpeg;
mod robust;
mod stretch;
mod turn;

pub(crate) use blur::Blur;
pub use distortion::Distortion;
pub(crate) use distortion::{Cut, Gaussian};
pub use robust::RobustConfig;
pub(crate) use robust::{Attack, Attacked};
