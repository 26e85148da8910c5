//! A made-up landmark and its photographers, for machines without a capture.
//!
//! A stone beacon is rendered from its exact shape (not by a radiance field),
//! photographed by several contributors who each came on a day of their own,
//! with a camera of their own, and with passers-by in the way. What comes out is
//! an ordinary capture in an ordinary format, plus what no real capture has: the
//! true cameras, and every photograph without its passers-by.
//!
//! Entry points: [`Landmark::generate`] and [`LandmarkCapture::write`].

mod capture;
mod config;
mod light;
mod monument;
mod noise;
mod people;
mod render;
pub mod sounds;

pub use capture::{Landmark, LandmarkCapture, LandmarkError, LandmarkView};
pub use config::{ConfigError, LandmarkConfig};
