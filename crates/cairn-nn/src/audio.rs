//! The audio head: from what the detector sees in a picture to a sound.
//!
//! The line is made longer by transposed convolutions; the last one writes
//! [`HOP`] samples a place, so that no layer has many channels at the full rate:
//! there a second of sound has as many places as a picture of 128 x 128.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::conv::{Window, conv_transpose1d};
use crate::error::{NnError, Result};
use crate::line::{After, Line};
use crate::params::{Init, Scope};
use crate::unet::{Memory, UNetConfig};

/// How an [`AudioHead`] is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AudioConfig {
    /// Samples a second of hidden sounds.
    pub sample_rate_hz: u32,
    /// Longest sound that may be hidden, seconds; the head is as long as the longest that is.
    pub longest_s: f64,
    /// Channels after each stage, coarsest first; every stage makes the line four times longer.
    pub channels: Vec<usize>,
    /// What it may know of the hidden sounds by heart.
    pub memory: Memory,
}

impl Default for AudioConfig {
    fn default() -> Self {
        Self { sample_rate_hz: 16_000, longest_s: 4.0, channels: vec![32, 16], memory: Memory::PerClass }
    }
}

/// Samples that the last layer writes a place.
const HOP: usize = 16;
/// How much longer a stage makes the line.
const STRETCH: usize = 4;

impl AudioConfig {
    /// Samples of a head that holds sounds of up to `longest`: a multiple of what a
    /// place of the coarsest line becomes.
    pub fn samples(&self, longest: usize) -> usize {
        longest.max(1).next_multiple_of(self.place())
    }

    /// Samples that a place of the coarsest line becomes.
    fn place(&self) -> usize {
        HOP * STRETCH.saturating_pow(self.channels.len() as u32)
    }
}

/// Coarsest features and class probabilities to hidden sounds.
#[derive(Debug, Clone)]
pub struct AudioHead {
    samples: usize,
    line: Line,
    stages: Vec<(Tensor, After)>,
    out: (Tensor, Tensor),
}

/// Unit of the memory, in levels of full scale 1.
const UNIT: f64 = 8.0;
const NETWORK: &str = "the audio head";

impl AudioHead {
    /// A head of `samples` samples (as [`AudioConfig::samples`] gives them) on the
    /// features of a detector of `encoder`, told of `classes` = M + 1 classes, with
    /// its parameters in `scope`.
    ///
    /// # Errors
    /// [`NnError::Setting`] for sizes out of range; when parameters of these names
    /// exist with other shapes.
    pub fn new(
        config: &AudioConfig,
        samples: usize,
        encoder: &UNetConfig,
        classes: usize,
        mut scope: Scope<'_>,
    ) -> Result<Self> {
        if config.channels.is_empty() || config.channels.len() > 4 || config.channels.contains(&0) {
            let (got, allowed) = (format!("{:?}", config.channels), "1 to 4 numbers of at least 1");
            return Err(NnError::Setting { key: "audio.channels", got, allowed });
        }
        if samples == 0 || !samples.is_multiple_of(config.place()) {
            let allowed = "a multiple of 16 times four to the power of stages";
            return Err(NnError::Setting { key: "audio.samples", got: samples.to_string(), allowed });
        }
        let sizes = [samples / config.place(), samples];
        let line = Line::new(encoder, classes, config.memory, sizes, &mut scope)?;
        let mut stages = Vec::with_capacity(config.channels.len());
        let mut inputs = line.channels();
        for (i, &outputs) in config.channels.iter().enumerate() {
            let mut scope = scope.sub(&format!("stage{i}"));
            // Every output sums over two taps of each input channel.
            let weight = scope.get("weight", &[inputs, outputs, 2 * STRETCH], Init::He { fan_in: 2 * inputs })?;
            stages.push((weight, After::new(outputs, encoder.groups, &mut scope)?));
            inputs = outputs;
        }
        // A small start, as the picture's: silence is nearer to any sound than noise is.
        let weight = scope.get("out.weight", &[inputs, 1, 2 * HOP], Init::He { fan_in: inputs * 2 * 64 })?;
        let out = (weight, scope.get("out.bias", &[1], Init::Constant(0.0))?);
        Ok(Self { samples, line, stages, out })
    }

    /// Samples of a hidden sound.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Hidden sounds, N x samples, neither squashed nor clamped, from the coarsest
    /// `features` and `probabilities`, N x (M + 1): softmax of the classifier's
    /// logits, or one-hot.
    ///
    /// # Errors
    /// [`NnError::Input`] for other shapes.
    pub fn forward(&self, features: &Tensor, probabilities: &Tensor) -> Result<Tensor> {
        let mut x = self.line.forward(NETWORK, features, probabilities)?;
        for (weight, after) in &self.stages {
            x = after.forward(&conv_transpose1d(&x, weight, None, Window::line(STRETCH, STRETCH / 2), 0)?)?;
        }
        let raw = conv_transpose1d(&x, &self.out.0, Some(&self.out.1), Window::line(HOP, HOP / 2), 0)?;
        self.line.finish(&raw.squeeze(1)?, probabilities, UNIT, 0.0)
    }
}
