//! Convolution, normalisation and rectifier as one operation of candle's graph.
//!
//! For every operation candle's backward pass makes a tensor of zeros the size of the input and adds the
//! gradient to it: more traffic through memory than a normalisation or a
//! rectifier itself. One operation a block halves that.

use std::sync::Mutex;

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};

use crate::conv::{Geometry, Isa, Window, passes};
use crate::norm::{GroupNorm, leaky_gradient, leaky_in_place};
use crate::raw::{floats, tensor, with_floats};

const NAME: &str = "cairn-conv-block";

/// [`conv2d`](crate::conv2d) without bias, then
/// [`group_norm_leaky`](crate::group_norm_leaky); to the same bytes.
pub(crate) fn conv_norm_leaky(
    x: &Tensor,
    weight: &Tensor,
    [scale, shift]: [&Tensor; 2],
    window: Window,
    groups: usize,
    slope: f32,
) -> Result<Tensor> {
    let norm = Some(GroupNorm { groups, slope });
    let affine = Tensor::cat(&[scale, shift], 0)?;
    x.contiguous()?.apply_op3(&weight.contiguous()?, &affine, Block { window, norm, slope, saved: Mutex::default() })
}

/// [`conv2d`](crate::conv2d) with `bias`, then [`leaky_relu`](crate::leaky_relu); to the same bytes.
pub(crate) fn conv_leaky(x: &Tensor, weight: &Tensor, bias: &Tensor, window: Window, slope: f32) -> Result<Tensor> {
    let block = Block { window, norm: None, slope, saved: Mutex::default() };
    x.contiguous()?.apply_op3(&weight.contiguous()?, &bias.contiguous()?, block)
}

struct Block {
    window: Window,
    /// None: the third operand is the convolution's bias, otherwise scales, then shifts.
    norm: Option<GroupNorm>,
    slope: f32,
    /// The convolution's result, which the normalisation's gradient needs.
    saved: Mutex<Option<Vec<f32>>>,
}

impl Block {
    fn geometry(&self, x: &Shape, w: &Shape) -> Result<Geometry> {
        Geometry::new(x.dims(), w.dims(), self.window).map_err(|e| candle_core::Error::Msg(format!("{NAME}: {e}")))
    }

    /// The gradient of the convolution's result, and of the third operand.
    fn outer_gradients(
        &self,
        g: &Geometry,
        [x, w, affine]: [&[f32]; 3],
        [out, grad]: [&[f32]; 2],
        shape: &Shape,
    ) -> Result<[Vec<f32>; 2]> {
        let Some(norm) = self.norm else {
            let dy = leaky_gradient(out, grad, self.slope);
            let db = passes::bias_gradient(&dy, g.outputs, g.output[0] * g.output[1]);
            return Ok([dy, db]);
        };
        let sizes = norm.sizes(shape, affine.len() / 2, affine.len() / 2)?;
        let saved = self.saved.lock().ok().and_then(|mut saved| saved.take());
        // A second backward pass over the same graph computes it again.
        let y = saved.unwrap_or_else(|| passes::forward(Isa::best(), g, x, w, None));
        let [dy, mut dscale, dshift] = norm.gradients(&sizes, [&y, out, grad], &affine[..g.outputs]);
        dscale.extend(dshift);
        Ok([dy, dscale])
    }
}

impl CustomOp3 for Block {
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
        let g = self.geometry(l1.shape(), l2.shape())?;
        let (x, w, affine) = (floats(NAME, s1, l1)?, floats(NAME, s2, l2)?, floats(NAME, s3, l3)?);
        let shape = Shape::from((g.batch, g.outputs, g.output[0], g.output[1]));
        let Some(norm) = self.norm else {
            if affine.len() != g.outputs {
                candle_core::bail!("{NAME}: {} outputs need as many biases, got {}", g.outputs, affine.len());
            }
            let mut out = passes::forward(Isa::best(), &g, x, w, Some(affine));
            leaky_in_place(&mut out, self.slope);
            return Ok((CpuStorage::F32(out), shape));
        };
        let sizes = norm.sizes(&shape, affine.len() / 2, affine.len().div_ceil(2))?;
        let y = passes::forward(Isa::best(), &g, x, w, None);
        let out = norm.normalised(&sizes, &y, &affine[..g.outputs], &affine[g.outputs..]);
        if let Ok(mut saved) = self.saved.lock() {
            *saved = Some(y);
        }
        Ok((CpuStorage::F32(out), shape))
    }

    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        affine: &Tensor,
        res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let g = self.geometry(x.shape(), w.shape())?;
        let grad = grad.contiguous()?;
        with_floats(NAME, x, |xs| {
            with_floats(NAME, w, |ws| {
                let [dy, daffine] = with_floats(NAME, affine, |affine| {
                    with_floats(NAME, res, |out| {
                        with_floats(NAME, &grad, |grad| {
                            self.outer_gradients(&g, [xs, ws, affine], [out, grad], res.shape())
                        })
                    })
                })????;
                let dx = match x.track_op() {
                    true => Some(tensor(passes::input_gradient(Isa::best(), &g, &dy, ws, None), x.shape())?),
                    false => None,
                };
                let dw = tensor(passes::weight_gradient(Isa::best(), &g, xs, &dy), w.shape())?;
                Ok((dx, Some(dw), Some(tensor(daffine, affine.shape())?)))
            })
        })??
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raw::bits;
    use crate::{conv2d, group_norm_leaky, leaky_relu};
    use candle_core::{Device, Var};

    fn wave(shape: &[usize], phase: f32) -> Result<Var> {
        let count = shape.iter().product::<usize>();
        let data = (0..count).map(|i| (i as f32 * 0.739 + phase).sin()).collect();
        Var::from_tensor(&Tensor::from_vec(data, shape, &Device::Cpu)?)
    }

    #[test]
    fn a_block_gives_the_bytes_of_its_parts_also_backwards_and_twice() -> Result<()> {
        let (x, w) = (wave(&[2, 3, 9, 7], 0.0)?, wave(&[6, 3, 3, 3], 1.0)?);
        let (scale, shift) = (wave(&[6], 2.0)?, wave(&[6], 3.0)?);
        let window = Window::square(2, 1);
        let parts = group_norm_leaky(&conv2d(&x, &w, None, window)?, &scale, &shift, 2, 0.1)?;
        let block = conv_norm_leaky(&x, &w, [&scale, &shift], window, 2, 0.1)?;
        same(&parts, &block, &[&x, &w, &scale, &shift])?;
        let parts = leaky_relu(&conv2d(&x, &w, Some(&shift), window)?, 0.1)?;
        same(&parts, &conv_leaky(&x, &w, &shift, window, 0.1)?, &[&x, &w, &shift])
    }

    fn same(parts: &Tensor, block: &Tensor, inputs: &[&Var]) -> Result<()> {
        assert_eq!(bits(parts)?, bits(block)?);
        let weight = wave(parts.dims(), 5.0)?;
        let expected = (parts * weight.as_tensor())?.backward()?;
        let loss = (block * weight.as_tensor())?;
        for _ in 0..2 {
            let got = loss.backward()?;
            for (i, input) in inputs.iter().enumerate() {
                let [a, b] = [&expected, &got].map(|grads| bits(grads.get(input).expect("a gradient")));
                assert_eq!(a?, b?, "gradient {i}");
            }
        }
        Ok(())
    }
}
