//! Layers with parameters, from the operations of this crate.

use candle_core::Tensor;

use crate::block::{conv_leaky, conv_norm_leaky};
use crate::conv::Window;
use crate::error::{NnError, Result};
use crate::params::{Init, Scope};

/// Slope of every leaky rectifier for negative inputs.
pub const LEAKY_SLOPE: f32 = 0.1;

/// A 3 x 3 convolution with padding 1, group normalisation or none, and a leaky
/// rectifier: N x C x H x W to N x O x H/stride x W/stride, rounded up.
#[derive(Debug, Clone)]
pub struct ConvBlock {
    weight: Tensor,
    after: After,
    stride: usize,
}

/// What stands between convolution and rectifier.
#[derive(Debug, Clone)]
enum After {
    Bias(Tensor),
    Norm { scale: Tensor, shift: Tensor, groups: usize },
}

impl ConvBlock {
    /// A block named by `scope`; `groups` 0 for no normalisation. Groups that
    /// do not divide `outputs` are lowered to their greatest common divisor.
    ///
    /// # Errors
    /// When parameters of these names exist with other shapes.
    pub fn new(scope: &mut Scope<'_>, inputs: usize, outputs: usize, stride: usize, groups: usize) -> Result<Self> {
        let weight = scope.get("weight", &[outputs, inputs, 3, 3], Init::He { fan_in: inputs * 9 })?;
        let groups = common_divisor(outputs, groups);
        let after = if groups == 0 {
            After::Bias(scope.get("bias", &[outputs], Init::Constant(0.0))?)
        } else {
            let scale = scope.get("norm.scale", &[outputs], Init::Constant(1.0))?;
            After::Norm { scale, shift: scope.get("norm.shift", &[outputs], Init::Constant(0.0))?, groups }
        };
        Ok(Self { weight, after, stride })
    }

    /// Applies the block.
    ///
    /// # Errors
    /// When `x` does not have the block's input channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let window = Window::square(self.stride, 1);
        Ok(match &self.after {
            After::Bias(bias) => conv_leaky(x, &self.weight, bias, window, LEAKY_SLOPE)?,
            After::Norm { scale, shift, groups } => {
                conv_norm_leaky(x, &self.weight, [scale, shift], window, *groups, LEAKY_SLOPE)?
            }
        })
    }
}

/// Greatest common divisor of `channels` and `groups`; 0 groups stay 0.
pub(crate) fn common_divisor(channels: usize, groups: usize) -> usize {
    (1..=groups).rev().find(|g| channels.is_multiple_of(*g) && groups.is_multiple_of(*g)).unwrap_or(0)
}

/// `y = x W^T + b`: N x in to N x out.
#[derive(Debug, Clone)]
pub struct Linear {
    weight: Tensor,
    bias: Tensor,
}

impl Linear {
    /// A layer named by `scope`, its weights started by `init`, its bias 0.
    ///
    /// # Errors
    /// When parameters of these names exist with other shapes.
    pub fn new(scope: &mut Scope<'_>, inputs: usize, outputs: usize, init: Init) -> Result<Self> {
        let weight = scope.get("weight", &[outputs, inputs], init)?;
        Ok(Self { weight, bias: scope.get("bias", &[outputs], Init::Constant(0.0))? })
    }

    /// Applies the layer.
    ///
    /// # Errors
    /// When `x` is not N x in.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        Ok(x.matmul(&self.weight.t()?)?.broadcast_add(&self.bias)?)
    }
}

/// Refuses `got` unless it is N x `channels` x H x W with H and W multiples of `multiple`.
pub(crate) fn check_image(network: &'static str, x: &Tensor, channels: usize, multiple: usize) -> Result<()> {
    let ok = match x.dims() {
        &[n, c, h, w] => {
            n > 0 && c == channels && h * w > 0 && h.is_multiple_of(multiple) && w.is_multiple_of(multiple)
        }
        _ => false,
    };
    if ok {
        return Ok(());
    }
    let expected = format!("N x {channels} x H x W with H and W multiples of {multiple}");
    Err(NnError::Input { network, expected, got: x.dims().to_vec() })
}
