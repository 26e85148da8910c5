//! Convolution that is fast both ways.
//!
//! candle's own backward pass runs a transposed convolution and a convolution
//! over the batch axis, several times slower than the forward pass; stage 2
//! would spend most of its time there. These operations give candle's graph the same
//! numbers from direct kernels (see `kernel`), to rounding: two-dimensional,
//! one-dimensional (images of one row) and transposed.

mod frame;
mod geometry;
mod kernel;
mod lanes;
mod outer;
pub(crate) mod passes;
pub(crate) mod scratch;
#[cfg(test)]
mod tests;

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};

pub(crate) use geometry::Geometry;
pub use geometry::Window;
pub(crate) use lanes::Isa;

use crate::raw::{floats, tensor, with_floats};

/// Two-dimensional convolution (cross-correlation, as in PyTorch) of `x`,
/// N x C x H x W, with `weight`, O x C x kH x kW, and `bias`, O, all f32:
/// N x O x H' x W' with `H' = (H + 2 padding - dilation (kH - 1) - 1) / stride + 1`,
/// rounded down.
///
/// Not-a-number propagates to every output whose window holds it, and to the
/// gradients of all weights of its channel. The result depends neither on the
/// number of threads nor on the machine's vector instructions.
///
/// # Errors
/// When shapes do not fit together, a size is 0 or a tensor is not f32 on the CPU.
pub fn conv2d(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, window: Window) -> Result<Tensor> {
    apply(x, weight, bias, Conv { window, transposed: None })
}

/// Transposed convolution of `x`, N x C x H x W, with `weight`, C x O x kH x kW,
/// and `bias`, O: N x O x H' x W' with `H' = (H - 1) stride - 2 padding +
/// dilation (kH - 1) + 1 + extra`. As a linear map the transpose of [`conv2d`]
/// with the same weight and window. `extra` rows and columns at the far sides
/// (PyTorch's `output_padding`), below the stride, choose among the sizes which
/// that convolution maps to the same one. Otherwise as [`conv2d`].
///
/// # Errors
/// As [`conv2d`]; when `extra` is not below the stride, or nothing is left of the output.
pub fn conv_transpose2d(
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    window: Window,
    extra: [usize; 2],
) -> Result<Tensor> {
    apply(x, weight, bias, Conv { window, transposed: Some(extra) })
}

/// One-dimensional convolution of `x`, N x C x L, with `weight`, O x C x k, and
/// `bias`, O: N x O x L'. Of the window the columns' part is taken, see
/// [`Window::line`]. Otherwise as [`conv2d`].
///
/// # Errors
/// As [`conv2d`].
pub fn conv1d(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, window: Window) -> Result<Tensor> {
    conv2d(&x.unsqueeze(2)?, &weight.unsqueeze(2)?, bias, line(window))?.squeeze(2)
}

/// One-dimensional transposed convolution of `x`, N x C x L, with `weight`,
/// C x O x k, and `bias`, O: N x O x L'. Otherwise as [`conv_transpose2d`] and [`conv1d`].
///
/// # Errors
/// As [`conv_transpose2d`].
pub fn conv_transpose1d(
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    window: Window,
    extra: usize,
) -> Result<Tensor> {
    conv_transpose2d(&x.unsqueeze(2)?, &weight.unsqueeze(2)?, bias, line(window), [0, extra])?.squeeze(2)
}

/// The columns' part of a window, for images of one row.
fn line(window: Window) -> Window {
    let [stride, padding, dilation] = [window.stride[1], window.padding[1], window.dilation[1]];
    Window { stride: [1, stride], padding: [0, padding], dilation: [1, dilation] }
}

fn apply(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>, op: Conv) -> Result<Tensor> {
    let (x, weight) = (x.contiguous()?, weight.contiguous()?);
    match bias {
        None => x.apply_op2(&weight, op),
        Some(bias) => x.apply_op3(&weight, &bias.contiguous()?, op),
    }
}

#[derive(Clone, Copy)]
struct Conv {
    window: Window,
    /// For a transposed convolution its extra rows and columns.
    transposed: Option<[usize; 2]>,
}

impl Conv {
    fn label(&self) -> &'static str {
        if self.transposed.is_some() { "cairn-conv-transpose2d" } else { "cairn-conv2d" }
    }

    fn geometry(&self, x: &Shape, w: &Shape) -> Result<Geometry> {
        let geometry = match self.transposed {
            None => Geometry::new(x.dims(), w.dims(), self.window),
            Some(extra) => Geometry::transposed(x.dims(), w.dims(), self.window, extra),
        };
        geometry.map_err(|e| candle_core::Error::Msg(format!("{}: {e}", self.label())))
    }

    fn forward(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        w: &CpuStorage,
        w_layout: &Layout,
        bias: Option<(&CpuStorage, &Layout)>,
    ) -> Result<(CpuStorage, Shape)> {
        let (g, name) = (self.geometry(x_layout.shape(), w_layout.shape())?, self.label());
        let (results, [h, width]) = match self.transposed {
            None => (g.outputs, g.output),
            Some(_) => (g.inputs, g.input),
        };
        let bias = bias.map(|(b, layout)| floats(name, b, layout)).transpose()?;
        if let Some(b) = bias.filter(|b| b.len() != results) {
            candle_core::bail!("{name}: {results} outputs need as many biases, got {}", b.len());
        }
        let (x, w) = (floats(name, x, x_layout)?, floats(name, w, w_layout)?);
        let out = match self.transposed {
            None => passes::forward(Isa::best(), &g, x, w, bias),
            Some(_) => passes::input_gradient(Isa::best(), &g, x, w, bias),
        };
        Ok((CpuStorage::F32(out), (g.batch, results, h, width).into()))
    }

    /// Gradients of input, weight and bias; none where nothing upstream asks.
    fn backward(
        &self,
        x: &Tensor,
        w: &Tensor,
        bias: Option<&Tensor>,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (g, name, isa) = (self.geometry(x.shape(), w.shape())?, self.label(), Isa::best());
        let grad = grad.contiguous()?;
        let dx = |gy: &[f32], w: &[f32]| match self.transposed {
            None => passes::input_gradient(isa, &g, gy, w, None),
            Some(_) => passes::forward(isa, &g, gy, w, None),
        };
        let dw = |gy: &[f32], x: &[f32]| match self.transposed {
            None => passes::weight_gradient(isa, &g, x, gy),
            Some(_) => passes::weight_gradient(isa, &g, gy, x),
        };
        let dx = match x.track_op() {
            true => Some(tensor(with_floats(name, &grad, |gy| with_floats(name, w, |w| dx(gy, w)))??, x.shape())?),
            false => None,
        };
        let dw = match w.track_op() {
            true => Some(tensor(with_floats(name, &grad, |gy| with_floats(name, x, |x| dw(gy, x)))??, w.shape())?),
            false => None,
        };
        let (_, results, h, width) = grad.dims4()?;
        let db = |gy: &[f32]| passes::bias_gradient(gy, results, h * width);
        let db = match bias.filter(|b| b.track_op()) {
            Some(b) => Some(tensor(with_floats(name, &grad, db)?, b.shape())?),
            None => None,
        };
        Ok((dx, dw, db))
    }
}

impl CustomOp2 for Conv {
    fn name(&self) -> &'static str {
        self.label()
    }

    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        self.forward(s1, l1, s2, l2, None)
    }

    fn bwd(&self, x: &Tensor, w: &Tensor, _: &Tensor, grad: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        self.backward(x, w, None, grad).map(|(dx, dw, _)| (dx, dw))
    }
}

impl CustomOp3 for Conv {
    fn name(&self) -> &'static str {
        self.label()
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
        self.forward(s1, l1, s2, l2, Some((s3, l3)))
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
