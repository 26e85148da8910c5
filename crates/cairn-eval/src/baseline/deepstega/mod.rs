//! A picture hidden in photographs by trained networks before a field is trained on them, as the paper compares with
//! (Baluja, "Hiding Images in Plain Sight: Deep Steganography", NeurIPS 2017; its table calls it DeepStega). Read from the
//! photographs it is there; what a field renders are means over many photographs.
//!
//! [`DeepTrainer`] trains, [`DeepStega`] hides and reveals. The networks see patches and no place in them, so that they
//! cannot learn a picture by heart, and half of what they hide in training are photographs.

mod networks;
mod patches;
mod planes;
mod train;

pub use networks::DeepStega;
pub use train::{DeepConfig, DeepStats, DeepTrainer};
