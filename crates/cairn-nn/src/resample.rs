//! Changes of resolution: repeat, average, and pool to moments.
//!
//! candle's backward pass of an upsampling is a grouped convolution; these are
//! plain loops both ways.

use candle_core::{CpuStorage, CustomOp1, CustomOp2, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use crate::raw::{floats, tensor, with_floats};
use crate::sum::{sum, sum_by};

/// Repeats each pixel of `x`, N x C x H x W, twice down and across, plus `skip`, N x C x 2H x 2W.
///
/// # Errors
/// When shapes do not fit or a tensor is not f32 on the CPU.
pub fn upsample_add(x: &Tensor, skip: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op2(&skip.contiguous()?, UpsampleAdd)
}

/// Averages blocks of `factor` = [down, across] pixels of `x`, N x C x H x W.
///
/// # Errors
/// When a factor does not divide its side or `x` is not a f32 CPU tensor of rank 4.
pub fn avg_pool(x: &Tensor, factor: [usize; 2]) -> Result<Tensor> {
    x.contiguous()?.apply_op1(AvgPool { factor })
}

/// Mean and mean of squares over all pixels of `x`, N x C x any: N x 2C, means first.
///
/// # Errors
/// When `x` is not f32 on the CPU or has no pixels.
pub fn pool_moments(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(PoolMoments)
}

struct UpsampleAdd;

struct AvgPool {
    factor: [usize; 2],
}

struct PoolMoments;

/// Adds each of the `width`-wide `small` planes, repeated and scaled, to `large`.
fn spread(small: &[f32], width: usize, [fy, fx]: [usize; 2], scale: f32, large: &mut [f32]) {
    let rows = large.par_chunks_mut(fy * width * fx).zip(small.par_chunks(width));
    rows.with_min_len(16).for_each(|(block, row)| {
        for line in block.chunks_exact_mut(width * fx) {
            for (to, v) in line.chunks_exact_mut(fx).zip(row) {
                for t in to {
                    *t += v * scale;
                }
            }
        }
    });
}

/// Sums of blocks of `large`, scaled: planes of rows `width` wide.
fn gather(large: &[f32], width: usize, [fy, fx]: [usize; 2], scale: f32) -> Vec<f32> {
    let mut small = vec![0.0; large.len() / (fy * fx)];
    let rows = small.par_chunks_mut(width).zip(large.par_chunks(fy * width * fx));
    rows.with_min_len(16).for_each(|(row, block)| {
        for line in block.chunks_exact(width * fx) {
            for (to, from) in row.iter_mut().zip(line.chunks_exact(fx)) {
                *to += from.iter().sum::<f32>();
            }
        }
        for v in row {
            *v *= scale;
        }
    });
    small
}

const TWICE: [usize; 2] = [2, 2];

impl CustomOp2 for UpsampleAdd {
    fn name(&self) -> &'static str {
        "cairn-upsample-add"
    }

    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, c, h, w) = l1.shape().dims4()?;
        let shape = Shape::from((n, c, 2 * h, 2 * w));
        if shape.elem_count() == 0 || *l2.shape() != shape {
            candle_core::bail!("{}: {:?} doubled does not fit {:?}", self.name(), l1.shape(), l2.shape());
        }
        let mut out = floats(self.name(), s2, l2)?.to_vec();
        spread(floats(self.name(), s1, l1)?, w, TWICE, 1.0, &mut out);
        Ok((CpuStorage::F32(out), shape))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, _: &Tensor, grad: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let width = x.dim(3)?;
        let dx = with_floats(self.name(), &grad.contiguous()?, |g| gather(g, width, TWICE, 1.0))?;
        Ok((Some(tensor(dx, x.shape())?), Some(grad.clone())))
    }
}

impl CustomOp1 for AvgPool {
    fn name(&self) -> &'static str {
        "cairn-avg-pool"
    }

    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, c, h, w) = l.shape().dims4()?;
        let [fy, fx] = self.factor;
        if fy * fx * l.shape().elem_count() == 0 || !h.is_multiple_of(fy) || !w.is_multiple_of(fx) {
            candle_core::bail!("cairn-avg-pool: factors {:?} must divide the sides of {:?}", self.factor, l.shape());
        }
        let out = gather(floats("cairn-avg-pool", s, l)?, w / fx, self.factor, 1.0 / (fy * fx) as f32);
        Ok((CpuStorage::F32(out), (n, c, h / fy, w / fx).into()))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let [fy, fx] = self.factor;
        let width = grad.dim(3)?;
        let mut dx = vec![0.0; x.elem_count()];
        with_floats("cairn-avg-pool", &grad.contiguous()?, |g| {
            spread(g, width, self.factor, 1.0 / (fy * fx) as f32, &mut dx);
        })?;
        Ok(Some(tensor(dx, x.shape())?))
    }
}

impl CustomOp1 for PoolMoments {
    fn name(&self) -> &'static str {
        "cairn-pool-moments"
    }

    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let dims = l.shape().dims();
        if dims.len() < 3 || l.shape().elem_count() == 0 {
            candle_core::bail!("cairn-pool-moments: N x C x pixels are needed, got {dims:?}");
        }
        let (n, c) = (dims[0], dims[1]);
        let x = floats("cairn-pool-moments", s, l)?;
        let pixels = x.len() / (n * c);
        let mut out = vec![0.0; n * c * 2];
        for (i, plane) in x.chunks_exact(pixels).enumerate() {
            let at = i / c * 2 * c + i % c;
            out[at] = sum(plane) / pixels as f32;
            out[at + c] = sum_by(plane, |v| v * v) / pixels as f32;
        }
        Ok((CpuStorage::F32(out), (n, 2 * c).into()))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let c = x.dim(1)?;
        let pixels: usize = x.dims()[2..].iter().product();
        let grad = with_floats(NAME_MOMENTS, &grad.contiguous()?, <[f32]>::to_vec)?;
        let mut dx = with_floats(NAME_MOMENTS, x, <[f32]>::to_vec)?;
        for (i, plane) in dx.chunks_exact_mut(pixels).enumerate() {
            let at = i / c * 2 * c + i % c;
            let (mean, square) = (grad[at] / pixels as f32, 2.0 * grad[at + c] / pixels as f32);
            for v in plane {
                *v = mean + square * *v;
            }
        }
        Ok(Some(tensor(dx, x.shape())?))
    }
}

const NAME_MOMENTS: &str = "cairn-pool-moments";
