//! The text head: from what the detector sees in a picture to the bits of a text.
//!
//! A text is its bytes in UTF-8, eight bits each with the highest first, and zero
//! bytes to the head's length. No text holds a zero byte, so that its end is told
//! by the zeros behind it, and no text at all is all zeros.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::conv::{Window, conv1d};
use crate::error::{NnError, Result};
use crate::line::{After, Line, conv3};
use crate::params::{Init, Scope};
use crate::unet::{Memory, UNetConfig};

/// How a [`TextHead`] is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// Longest text that may be hidden, bytes of UTF-8; the head is as long as the longest that is.
    pub longest_bytes: usize,
    /// Channels of each convolution along the text.
    pub channels: Vec<usize>,
    /// What it may know of the hidden texts by heart.
    pub memory: Memory,
}

impl Default for TextConfig {
    fn default() -> Self {
        Self { longest_bytes: 256, channels: vec![32], memory: Memory::PerClass }
    }
}

/// Bits a byte.
const BITS: usize = 8;
/// A bit's logit where the gate is shut: it is 0 with 99.97 %.
const SHUT: f64 = -8.0;

/// Coarsest features and class probabilities to the bits of hidden texts.
#[derive(Debug, Clone)]
pub struct TextHead {
    bytes: usize,
    line: Line,
    stages: Vec<(Tensor, After)>,
    out: (Tensor, Tensor),
}

/// Unit of the memory, in logits.
const UNIT: f64 = 32.0;
const NETWORK: &str = "the text head";

impl TextHead {
    /// A head of `bytes` bytes on the features of a detector of `encoder`, told of
    /// `classes` = M + 1 classes, with its parameters in `scope`.
    ///
    /// # Errors
    /// [`NnError::Setting`] for sizes out of range; when parameters of these names
    /// exist with other shapes.
    pub fn new(
        config: &TextConfig,
        bytes: usize,
        encoder: &UNetConfig,
        classes: usize,
        mut scope: Scope<'_>,
    ) -> Result<Self> {
        if config.channels.is_empty() || config.channels.len() > 4 || config.channels.contains(&0) {
            let (got, allowed) = (format!("{:?}", config.channels), "1 to 4 numbers of at least 1");
            return Err(NnError::Setting { key: "text.channels", got, allowed });
        }
        if bytes == 0 {
            return Err(NnError::Setting { key: "text.bytes", got: "0".into(), allowed: "at least 1" });
        }
        let line = Line::new(encoder, classes, config.memory, [bytes, bytes * BITS], &mut scope)?;
        let mut stages = Vec::with_capacity(config.channels.len());
        let mut inputs = line.channels();
        for (i, &outputs) in config.channels.iter().enumerate() {
            let mut scope = scope.sub(&format!("stage{i}"));
            let weight = scope.get("weight", &[outputs, inputs, 3], Init::He { fan_in: 3 * inputs })?;
            stages.push((weight, After::new(outputs, encoder.groups, &mut scope)?));
            inputs = outputs;
        }
        let weight = scope.get("out.weight", &[BITS, inputs, 1], Init::He { fan_in: inputs * 4 })?;
        let out = (weight, scope.get("out.bias", &[BITS], Init::Constant(0.0))?);
        Ok(Self { bytes, line, stages, out })
    }

    /// Bytes of a hidden text, the zeros behind it included.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Logits of hidden texts' bits, N x 8 bytes, byte after byte, from the coarsest
    /// `features` and `probabilities`, N x (M + 1): softmax of the classifier's
    /// logits, or one-hot. A positive logit is a 1.
    ///
    /// # Errors
    /// [`NnError::Input`] for other shapes.
    pub fn forward(&self, features: &Tensor, probabilities: &Tensor) -> Result<Tensor> {
        let mut x = self.line.forward(NETWORK, features, probabilities)?;
        for (weight, after) in &self.stages {
            x = after.forward(&conv3(&x, weight, None)?)?;
        }
        let raw = conv1d(&x, &self.out.0, Some(&self.out.1), Window::line(1, 0))?;
        let raw = raw.transpose(1, 2)?.contiguous()?.flatten_from(1)?;
        self.line.finish(&raw, probabilities, UNIT, SHUT)
    }
}

/// The bits of `text`, 0 or 1 each, highest of a byte first, with zero bytes to
/// `bytes`; what is longer is cut.
pub fn text_bits(text: &str, bytes: usize) -> Vec<f32> {
    let padded = text.bytes().chain(std::iter::repeat(0)).take(bytes);
    padded.flat_map(|byte| (0..BITS).map(move |bit| f32::from(byte >> (BITS - 1 - bit) & 1))).collect()
}

/// The bytes that logits of bits stand for, without the zero bytes behind the last other one.
pub fn text_bytes(logits: &[f32]) -> Vec<u8> {
    let byte = |bits: &[f32]| bits.iter().fold(0u8, |byte, logit| byte << 1 | u8::from(*logit > 0.0));
    let mut bytes: Vec<u8> = logits.chunks_exact(BITS).map(byte).collect();
    bytes.truncate(bytes.iter().rposition(|b| *b != 0).map_or(0, |last| last + 1));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_its_bits_and_its_end_is_found() {
        assert_eq!(text_bits("A", 2), [0., 1., 0., 0., 0., 0., 0., 1., 0., 0., 0., 0., 0., 0., 0., 0.]);
        for text in ["", "A", "Ada Lovelace", "© 2026 Éva, 写真", "full"] {
            let logits: Vec<f32> = text_bits(text, 24).iter().map(|b| b * 6.0 - 3.0).collect();
            assert_eq!(text_bytes(&logits), text.as_bytes());
        }
        assert_eq!(text_bytes(&[-1.0; 16]), b"");
        assert_eq!(text_bits("cut", 2).len(), 16);
    }
}
