//! Layers on candle that train fast on a few CPU cores.
//!
//! candle brings tensors and the backward graph; this crate brings what its CPU
//! side lacks: convolution and normalisation with fast backward passes
//! ([`conv2d`], [`conv1d`], [`conv_transpose2d`], [`group_norm_leaky`],
//! [`upsample_add`]), parameters that follow from a seed and keep an order ([`Params`]), an optimiser that can be saved
//! and refuses numbers that are not finite ([`Adam`]), and the networks of
//! stage 2: [`Classifier`], and the detector, [`UNet`] with an [`AudioHead`] and a
//! [`TextHead`] where they are wanted.
//!
//! Everything is f32 on the CPU and runs on rayon's current pool. The same
//! inputs give the same bytes, however many threads there are.
//!
//! ```
//! use cairn_nn::{Adam, AdamConfig, Classifier, ClassifierConfig, Params, Rate, cross_entropy};
//! use candle_core::{Device, Var};
//!
//! # fn main() -> cairn_nn::Result<()> {
//! let mut params = Params::new(7);
//! let config = ClassifierConfig { channels: vec![4, 4], ..ClassifierConfig::default() };
//! let classifier = Classifier::new(&config, 2, params.scope("classifier"))?;
//! let mut adam = Adam::new(AdamConfig::default(), Rate::constant(1e-3))?;
//! let images = Var::from_vec(vec![0.5_f32; 2 * 3 * 16 * 16], (2, 3, 16, 16), &Device::Cpu)?;
//! let loss = cross_entropy(&classifier.forward(&images)?, &[0, 1])?;
//! let grads = loss.backward()?;
//! assert!(grads.get(&images).is_some(), "the gradient reaches the picture");
//! adam.step(&params, &grads)?;
//! # Ok(())
//! # }
//! ```

mod adam;
mod audio;
mod average;
mod block;
mod classifier;
mod colour;
mod conv;
mod error;
mod front;
mod layers;
mod line;
mod loss;
mod measure;
mod norm;
mod params;
mod raw;
mod resample;
mod sum;
mod text;
mod unet;

pub use adam::{Adam, AdamConfig, Rate};
pub use audio::{AudioConfig, AudioHead};
pub use average::Average;
pub use classifier::{Classifier, ClassifierConfig};
pub use conv::{Window, conv_transpose1d, conv_transpose2d, conv1d, conv2d};
pub use error::{NnError, Result};
pub use front::front_end;
pub use layers::{ConvBlock, LEAKY_SLOPE, Linear};
pub use loss::{binary_cross_entropy, cross_entropy, mean_absolute, mean_squared, softmax};
pub use measure::{ConvShape, Pass};
pub use norm::{group_norm_leaky, leaky_relu};
pub use params::{Init, Params, Scope};
pub use resample::{avg_pool, pool_moments, upsample_add};
pub use text::{TextConfig, TextHead, text_bits, text_bytes};
pub use unet::{Features, Memory, UNet, UNetConfig};
