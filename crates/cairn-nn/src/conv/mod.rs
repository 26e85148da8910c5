//! Convolution that is fast both ways.
//!
//! candle's own backward pass runs a transposed convolution and a convolution
//! over the batch axis, several times slower than the forward pass; stage 2
//! would spend most of its time there. These operations give candle's graph the same
//! numbers from direct kernels (see `kernel`), to rounding.

mod geometry;
mod kernel;
mod lanes;
mod passes;

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};

use geometry::Geometry;
pub use geometry::Window;

use crate::raw::{floats, tensor, with_floats};

/// Two-dimensional convolution (cross-correlation, as in PyTorch) of `x`,
/// N x C x H x W, with `weight`, O x C x kH x kW, and `bias`, O, all f32:
/// N x O x H' x W' with `H' = (H + 2 padding - kH) / stride + 1`, rounded down.
///
/// Not-a-number propagates to every output whose window holds it. The result
/// does not depend on the number of threads.
///
/// # Errors
/// When shapes do not fit together or a tensor is not f32 on the CPU.
pub fn conv2d(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, window: Window) -> Result<Tensor> {
    let (x, weight) = (x.contiguous()?, weight.contiguous()?);
    let op = Conv2d { window };
    match bias {
        None => x.apply_op2(&weight, op),
        Some(bias) => x.apply_op3(&weight, &bias.contiguous()?, op),
    }
}

/// One-dimensional convolution of `x`, N x C x L, with `weight`, O x C x k, and
/// `bias`, O: N x O x L'. Otherwise as [`conv2d`].
///
/// # Errors
/// As [`conv2d`].
pub fn conv1d(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, stride: usize, padding: usize) -> Result<Tensor> {
    let window = Window { stride: [1, stride], padding: [0, padding] };
    conv2d(&x.unsqueeze(2)?, &weight.unsqueeze(2)?, bias, window)?.squeeze(2)
}

#[derive(Clone, Copy)]
struct Conv2d {
    window: Window,
}

const NAME: &str = "cairn-conv2d";

impl Conv2d {
    fn geometry(&self, x: &Shape, w: &Shape) -> Result<Geometry> {
        Geometry::new(x.dims(), w.dims(), self.window).map_err(|e| candle_core::Error::Msg(format!("{NAME}: {e}")))
    }

    fn forward(
        &self,
        (x, x_layout): (&CpuStorage, &Layout),
        (w, w_layout): (&CpuStorage, &Layout),
        bias: Option<(&CpuStorage, &Layout)>,
    ) -> Result<(CpuStorage, Shape)> {
        let g = self.geometry(x_layout.shape(), w_layout.shape())?;
        let bias = bias.map(|(b, layout)| floats(NAME, b, layout)).transpose()?;
        if let Some(b) = bias.filter(|b| b.len() != g.outputs) {
            candle_core::bail!("{NAME}: {} outputs need as many biases, got {}", g.outputs, b.len());
        }
        let out = passes::forward(&g, floats(NAME, x, x_layout)?, floats(NAME, w, w_layout)?, bias);
        Ok((CpuStorage::F32(out), (g.batch, g.outputs, g.output[0], g.output[1]).into()))
    }

    /// Gradients of input, weight and bias; none where nothing upstream asks.
    fn backward(
        &self,
        x: &Tensor,
        w: &Tensor,
        bias: Option<&Tensor>,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let g = self.geometry(x.shape(), w.shape())?;
        let grad = grad.contiguous()?;
        let dx = if x.track_op() {
            let dx = with_floats(NAME, &grad, |gy| with_floats(NAME, w, |w| passes::input_gradient(&g, gy, w)))??;
            Some(tensor(dx, x.shape())?)
        } else {
            None
        };
        let dw = if w.track_op() {
            let dw = with_floats(NAME, &grad, |gy| with_floats(NAME, x, |x| passes::weight_gradient(&g, x, gy)))??;
            Some(tensor(dw, w.shape())?)
        } else {
            None
        };
        let db = match bias.filter(|b| b.track_op()) {
            Some(b) => Some(tensor(with_floats(NAME, &grad, |gy| passes::bias_gradient(&g, gy))?, b.shape())?),
            None => None,
        };
        Ok((dx, dw, db))
    }
}

impl CustomOp2 for Conv2d {
    fn name(&self) -> &'static str {
        NAME
    }

    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        self.forward((s1, l1), (s2, l2), None)
    }

    fn bwd(&self, x: &Tensor, w: &Tensor, _: &Tensor, grad: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        self.backward(x, w, None, grad).map(|(dx, dw, _)| (dx, dw))
    }
}

impl CustomOp3 for Conv2d {
    fn name(&self) -> &'static str {
        NAME
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        self.forward((s1, l1), (s2, l2), Some((s3, l3)))
    }

    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        self.backward(x, w, Some(bias), grad)
    }
}
