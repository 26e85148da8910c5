//! From a picture's features to a line: what the one-dimensional heads share.
//!
//! A sound has no rows and columns. The places of the coarsest level are mapped to
//! places of the line by a learned matrix, the same for all channels, and the told
//! class shifts the channels; what the line then becomes is each head's own.

use candle_core::{D, Tensor};

use crate::conv::{Window, conv1d};
use crate::error::{NnError, Result};
use crate::layers::{LEAKY_SLOPE, Linear, common_divisor};
use crate::norm::{group_norm_leaky, leaky_relu};
use crate::params::{Init, Scope};
use crate::unet::{Memory, UNetConfig};

/// Features of the coarsest level, N x C x h x w, to a line, N x C x `length`.
#[derive(Debug, Clone)]
pub(crate) struct Line {
    classes: usize,
    channels: usize,
    /// Rows and columns of the coarsest level.
    from: [usize; 2],
    length: usize,
    gated: bool,
    /// h w x length.
    place: Tensor,
    class: Linear,
    /// 1 x C x length, shared by all classes ([`Memory::Coarsest`]).
    shared: Option<Tensor>,
    /// M x outputs, a signal a class ([`Memory::PerClass`]).
    memory: Option<Tensor>,
}

impl Line {
    /// For the features of a detector of `encoder` and `classes`: a line of `length`
    /// places from which a head makes `outputs` numbers.
    pub(crate) fn new(
        encoder: &UNetConfig,
        classes: usize,
        memory: Memory,
        [length, outputs]: [usize; 2],
        scope: &mut Scope<'_>,
    ) -> Result<Self> {
        let (channels, from) = encoder.coarsest();
        let places = from[0] * from[1];
        scope.by_class("class.weight", 1, 0);
        scope.by_class("memory", 0, -1);
        Ok(Self {
            classes,
            channels,
            from,
            length,
            gated: encoder.gated,
            place: scope.get("place", &[places, length], Init::He { fan_in: places })?,
            class: Linear::new(&mut scope.sub("class"), classes, channels, Init::Uniform(0.1))?,
            shared: match memory {
                Memory::Coarsest => Some(scope.get("positional", &[1, channels, length], Init::Uniform(0.1))?),
                Memory::None | Memory::PerClass => None,
            },
            memory: match memory {
                Memory::PerClass if classes > 1 => {
                    Some(scope.get("memory", &[classes - 1, outputs], Init::Constant(0.0))?)
                }
                Memory::None | Memory::Coarsest | Memory::PerClass => None,
            },
        })
    }

    /// Channels of the line.
    pub(crate) fn channels(&self) -> usize {
        self.channels
    }

    /// The line, N x C x length.
    pub(crate) fn forward(&self, network: &'static str, features: &Tensor, probabilities: &Tensor) -> Result<Tensor> {
        let [h, w] = self.from;
        let n = features.dims()[0];
        if features.dims() != [n, self.channels, h, w] || probabilities.dims() != [n, self.classes] {
            let expected =
                format!("N x {} x {h} x {w} features and N x {} class probabilities", self.channels, self.classes);
            return Err(NnError::Input { network, expected, got: features.dims().to_vec() });
        }
        let flat = features.reshape((n * self.channels, h * w))?;
        let line = flat.matmul(&self.place)?.reshape((n, self.channels, self.length))?;
        let line = line.broadcast_add(&self.class.forward(probabilities)?.unsqueeze(D::Minus1)?)?;
        Ok(match &self.shared {
            Some(shared) => line.broadcast_add(shared)?,
            None => line,
        })
    }

    /// `raw`, N x any, with what is known by heart of the told classes added, times
    /// the gate; where that is shut, `empty` is put in the place of every number.
    ///
    /// Memory is kept in units of `unit`: Adam moves every number by about the learning
    /// rate a step, so that this is how much faster a memory is learnt than by itself.
    pub(crate) fn finish(&self, raw: &Tensor, probabilities: &Tensor, unit: f64, empty: f64) -> Result<Tensor> {
        let raw = match &self.memory {
            Some(memory) => {
                let told = (probabilities.narrow(1, 1, self.classes - 1)? * unit)?;
                (told.matmul(memory)? + raw)?
            }
            None => raw.clone(),
        };
        if !self.gated {
            return Ok(raw);
        }
        let shut = probabilities.narrow(1, 0, 1)?;
        let open = raw.broadcast_mul(&shut.affine(-1.0, 1.0)?)?;
        Ok(if empty == 0.0 { open } else { open.broadcast_add(&shut.affine(empty, 0.0)?)? })
    }
}

/// A one-dimensional convolution or its transpose, normalisation or none, and a leaky rectifier.
#[derive(Debug, Clone)]
pub(crate) struct After {
    scale: Tensor,
    shift: Tensor,
    groups: usize,
}

impl After {
    /// What follows a convolution to `channels`, in groups as [`crate::ConvBlock`] has them.
    pub(crate) fn new(channels: usize, groups: usize, scope: &mut Scope<'_>) -> Result<Self> {
        let scale = scope.get("norm.scale", &[channels], Init::Constant(1.0))?;
        let shift = scope.get("norm.shift", &[channels], Init::Constant(0.0))?;
        Ok(Self { scale, shift, groups: common_divisor(channels, groups) })
    }

    /// Normalisation (none for 0 groups) and rectifier.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        if self.groups > 0 {
            return Ok(group_norm_leaky(x, &self.scale, &self.shift, self.groups, LEAKY_SLOPE)?);
        }
        let c = self.scale.elem_count();
        let x = x.broadcast_mul(&self.scale.reshape((1, c, 1))?)?;
        Ok(leaky_relu(&x.broadcast_add(&self.shift.reshape((1, c, 1))?)?, LEAKY_SLOPE)?)
    }
}

/// A convolution of three taps that keeps the length.
pub(crate) fn conv3(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>) -> Result<Tensor> {
    Ok(conv1d(x, weight, bias, Window::line(1, 1))?)
}
