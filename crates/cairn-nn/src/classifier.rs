//! The classifier: which identity's mark does a picture carry, if any.
//!
//! The paper's is a VGG16 at 512 x 512, seconds an iteration on a CPU. What is
//! to be told apart is a texture of a few grey levels, present everywhere: a
//! short stack of strided convolutions and statistics over the whole picture do.

use candle_core::Tensor;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::colour::{DIRECTIONS, colour_energies};
use crate::error::{NnError, Result};
use crate::front::{front_end, residual};
use crate::layers::{ConvBlock, LEAKY_SLOPE, Linear, check_image};
use crate::norm::leaky_relu;
use crate::params::{Init, Scope};
use crate::raw::{tensor, with_floats};
use crate::resample::{avg_pool, pool_moments};

/// How a [`Classifier`] is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassifierConfig {
    /// Channels of the input pictures.
    pub inputs: usize,
    /// Output channels of each strided convolution.
    pub channels: Vec<usize>,
    /// Groups of the normalisation, 0 for none: normalising divides out the very
    /// energy that tells a marked picture from an unmarked one.
    pub groups: usize,
    /// Amplification of the high-pass channels, which are then all it sees; 0 for
    /// the picture itself (see [`front_end`]).
    pub high_pass_gain: f32,
    /// Whether statistics are over the textured parts of a picture alone, for which `high_pass_gain` has to be above 0: a blank ground
    /// carries no mark, and how much of a picture it takes hangs on where an object is seen from.
    pub textured_only: bool,
}

impl Default for ClassifierConfig {
    fn default() -> Self {
        Self { inputs: 3, channels: vec![16, 32, 64, 64], groups: 0, high_pass_gain: 30.0, textured_only: false }
    }
}

/// Pictures to logits: strided convolutions, means and mean squares over the
/// picture, two linear layers.
#[derive(Debug, Clone)]
pub struct Classifier {
    config: ClassifierConfig,
    classes: usize,
    features: usize,
    blocks: Vec<ConvBlock>,
    hidden: Linear,
    head: Linear,
}

/// Numbers between the two linear layers.
const HIDDEN: usize = 32;

impl Classifier {
    /// A classifier of `classes` = M + 1 classes, class 0 unmarked, with its
    /// parameters in `scope`.
    ///
    /// # Errors
    /// [`NnError::Setting`] for sizes of 0; when parameters of these names exist
    /// with other shapes.
    pub fn new(config: &ClassifierConfig, classes: usize, mut scope: Scope<'_>) -> Result<Self> {
        check_sizes(config.inputs, &config.channels, classes, config.high_pass_gain)?;
        if config.textured_only && config.high_pass_gain == 0.0 {
            let (key, got) = ("textured_only", "true".into());
            return Err(NnError::Setting { key, got, allowed: "false where high_pass_gain is 0" });
        }
        // With a front end, only what it lets through: a classifier that saw the
        // picture itself would learn to recognise the scene.
        let mut inputs = config.inputs;
        let mut blocks = Vec::with_capacity(config.channels.len());
        for (i, &outputs) in config.channels.iter().enumerate() {
            blocks.push(ConvBlock::new(&mut scope.sub(&format!("block{i}")), inputs, outputs, 2, config.groups)?);
            inputs = outputs;
        }
        // A small start: equal probabilities, so that no class is favoured before training.
        let energies = if config.high_pass_gain != 0.0 && config.inputs == 3 { DIRECTIONS } else { 0 };
        let features = 2 * inputs + energies;
        let hidden = Linear::new(&mut scope.sub("hidden"), features, HIDDEN, Init::He { fan_in: features })?;
        let head = Linear::new(&mut scope.sub("head"), HIDDEN, classes, Init::Uniform(0.02))?;
        scope.by_class("head.weight", 0, 0);
        scope.by_class("head.bias", 0, 0);
        Ok(Self { config: config.clone(), classes, features, blocks, hidden, head })
    }

    /// M + 1.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// F, the numbers that [`Classifier::features`] gives of a picture.
    pub fn feature_count(&self) -> usize {
        self.features
    }

    /// Logits, N x (M + 1), of `images`, N x C x H x W in [0, 1], with H and W
    /// multiples of two to the power of the number of blocks.
    ///
    /// # Errors
    /// [`NnError::Input`] for another shape.
    pub fn forward(&self, images: &Tensor) -> Result<Tensor> {
        self.classify(&self.features(images)?)
    }

    /// Logits, N x (M + 1), of [`Classifier::features`].
    ///
    /// # Errors
    /// [`NnError::Tensor`] for another shape.
    pub fn classify(&self, features: &Tensor) -> Result<Tensor> {
        self.head.forward(&leaky_relu(&self.hidden.forward(features)?, LEAKY_SLOPE)?)
    }

    /// What the answer is worked out from, N x F: statistics over the picture of the last
    /// convolution's channels, and the energies of colour. `images` as for [`Classifier::forward`].
    ///
    /// # Errors
    /// As [`Classifier::forward`].
    pub fn features(&self, images: &Tensor) -> Result<Tensor> {
        check_image("the classifier", images, self.config.inputs, 1 << self.blocks.len())?;
        let mut x = match self.config.high_pass_gain != 0.0 {
            true => residual(images, self.config.high_pass_gain)?,
            false => front_end(images, 0.0, None)?,
        };
        let energies = match self.config.high_pass_gain != 0.0 && self.config.inputs == 3 {
            true => Some(colour_energies(&x)?),
            false => None,
        };
        let weights = match self.config.textured_only {
            true => Some(textured(&x, self.config.high_pass_gain, 1 << self.blocks.len())?),
            false => None,
        };
        for block in &self.blocks {
            x = block.forward(&x)?;
        }
        let features = match &weights {
            Some(weights) => weighted_moments(&x, weights)?,
            None => pool_moments(&x)?,
        };
        let energies = match (energies, &weights) {
            // As if all of the picture were as its textured part.
            (Some(energies), Some(weights)) => Some(energies.broadcast_sub(&weights.mean_keepdim(1)?.log()?)?),
            (energies, _) => energies,
        };
        Ok(match energies {
            Some(energies) => Tensor::cat(&[&features, &energies], 1)?,
            None => features,
        })
    }
}

/// Energy of a residual of all channels, before amplification, at which a cell is half textured: some two levels of 255 in each.
const TEXTURED: f64 = 1.1e-4;
/// Weight of a cell that is blank: a picture that is blank all over is as it is everywhere.
const BLANK: f64 = 0.05;

/// How textured each cell of `cell` x `cell` pixels is, N x cells, from [`BLANK`] to 1, from the residual `x`, N x C x H x W. It is
/// a weight, not something to learn by: no gradient passes. `gain` is what the residual is amplified by.
fn textured(x: &Tensor, gain: f32, cell: usize) -> Result<Tensor> {
    let energy = avg_pool(&energy(x)?, [cell, cell])?.flatten_from(1)?;
    let squared = energy.sqr()?;
    let half = TEXTURED * f64::from(gain).powi(2);
    let share = squared.div(&squared.affine(1.0, half * half)?)?;
    Ok(share.affine(1.0 - BLANK, BLANK)?)
}

/// Sum of squares over the channels of each pixel, N x 1 x H x W, of `x`, N x C x H x W; without a gradient.
fn energy(x: &Tensor) -> Result<Tensor> {
    let (n, c, h, w) = x.dims4()?;
    let pixels = h * w;
    let mut out = vec![0.0; n * pixels];
    with_floats("cairn-energy", &x.contiguous()?, |x| {
        out.par_chunks_mut(pixels).zip(x.par_chunks(c * pixels)).for_each(|(out, x)| {
            for plane in x.chunks_exact(pixels) {
                out.iter_mut().zip(plane).for_each(|(o, v)| *o += v * v);
            }
        });
    })?;
    Ok(tensor(out, &(n, 1, h, w).into())?)
}

/// As [`pool_moments`], cells counting by `weights`, N x (H W).
fn weighted_moments(x: &Tensor, weights: &Tensor) -> Result<Tensor> {
    let x = x.flatten_from(2)?;
    let weights = weights.broadcast_div(&weights.sum_keepdim(1)?)?.unsqueeze(2)?;
    let moments = [x.matmul(&weights)?, x.sqr()?.matmul(&weights)?];
    Ok(Tensor::cat(&moments, 1)?.squeeze(2)?)
}

/// Checks what both networks have in common.
pub(crate) fn check_sizes(inputs: usize, channels: &[usize], classes: usize, gain: f32) -> Result<()> {
    let setting = |key, got: String, allowed| Err(NnError::Setting { key, got, allowed });
    if inputs == 0 {
        return setting("inputs", inputs.to_string(), "at least 1");
    }
    if channels.is_empty() || channels.len() > 8 || channels.contains(&0) {
        return setting("channels", format!("{channels:?}"), "1 to 8 numbers of at least 1");
    }
    if classes == 0 {
        return setting("classes", classes.to_string(), "at least 1");
    }
    if !gain.is_finite() || gain < 0.0 {
        return setting("high_pass_gain", gain.to_string(), "0 (none) or a positive number");
    }
    Ok(())
}
