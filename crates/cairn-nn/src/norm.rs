//! Group normalisation and leaky rectifier in one operation.
//!
//! Written with candle's elementwise operations a layer's normalisation takes
//! a dozen passes over memory and as many allocations; here it is a few passes
//! and one allocation each way.

use std::mem::MaybeUninit;

use candle_core::{CpuStorage, CustomOp1, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use crate::conv::scratch::Scratch;
use crate::raw::{floats, tensor, with_floats, written};
use crate::sum::{sum, sum_by, sum_pairs};

/// Added to the variance, as in Wu and He 2018.
const EPSILON: f32 = 1e-5;
/// Numbers a task of [`leaky_relu`] takes.
const CHUNK: usize = 1 << 14;

/// Group normalisation (Wu and He 2018, arXiv 1803.08494) of `x`, N x C x any,
/// over `groups` groups of channels, scaled by `gamma` (C) and shifted by
/// `beta` (C), then `max(y, slope y)`; `slope` in (0, 1], 1 for none.
///
/// # Errors
/// When `groups` does not divide C, shapes do not fit, or a tensor is not f32 on the CPU.
pub fn group_norm_leaky(x: &Tensor, gamma: &Tensor, beta: &Tensor, groups: usize, slope: f32) -> Result<Tensor> {
    x.contiguous()?.apply_op3(&gamma.contiguous()?, &beta.contiguous()?, GroupNorm { groups, slope })
}

/// `max(x, slope x)`, `slope` in (0, 1].
///
/// # Errors
/// When `x` is not f32 on the CPU.
pub fn leaky_relu(x: &Tensor, slope: f32) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Leaky { slope })
}

#[inline(always)]
fn leaky(v: f32, slope: f32) -> f32 {
    if v > 0.0 { v } else { v * slope }
}

/// Group normalisation and rectifier over plain slices.
#[derive(Clone, Copy)]
pub(crate) struct GroupNorm {
    pub(crate) groups: usize,
    pub(crate) slope: f32,
}

const NAME: &str = "cairn-group-norm";

/// Channels, numbers a channel, and channels a group.
pub(crate) struct Sizes {
    channels: usize,
    pixels: usize,
    per_group: usize,
}

impl GroupNorm {
    pub(crate) fn sizes(&self, x: &Shape, gamma: usize, beta: usize) -> Result<Sizes> {
        let dims = x.dims();
        let channels = if dims.len() < 2 { 0 } else { dims[1] };
        if self.groups == 0 || channels == 0 || !channels.is_multiple_of(self.groups) || x.elem_count() == 0 {
            candle_core::bail!("{NAME}: {} groups must divide the channels of N x C x ..., got {dims:?}", self.groups);
        }
        if gamma != channels || beta != channels {
            candle_core::bail!("{NAME}: {channels} channels, but {gamma} scales and {beta} shifts");
        }
        Ok(Sizes { channels, pixels: dims[2..].iter().product(), per_group: channels / self.groups })
    }

    /// The operation on `x`, N x C x pixels.
    pub(crate) fn normalised(&self, s: &Sizes, x: &[f32], gamma: &[f32], beta: &[f32]) -> Vec<f32> {
        let group_len = s.per_group * s.pixels;
        let each = |(i, (out, x)): (usize, (&mut [MaybeUninit<f32>], &[f32]))| {
            let (mean, inverse) = mean_and_inverse_deviation(x);
            let first = i % self.groups * s.per_group;
            for (c, (out, x)) in out.chunks_exact_mut(s.pixels).zip(x.chunks_exact(s.pixels)).enumerate() {
                let scale = inverse * gamma[first + c];
                let shift = beta[first + c];
                for (o, &x) in out.iter_mut().zip(x) {
                    o.write(leaky((x - mean) * scale + shift, self.slope));
                }
            }
        };
        let fill = |out: &mut [MaybeUninit<f32>]| {
            out.par_chunks_mut(group_len).zip(x.par_chunks(group_len)).enumerate().for_each(each)
        };
        // SAFETY: groups make up all of `x`, and every number of a group is written.
        unsafe { written(x.len(), fill) }.0
    }

    /// Gradients of `x`, scale and shift from `[x, out, grad]`: the input, the
    /// result and its gradient, N x C x pixels each.
    pub(crate) fn gradients(&self, s: &Sizes, [x, out, grad]: [&[f32]; 3], gamma: &[f32]) -> [Vec<f32>; 3] {
        let group_len = s.per_group * s.pixels;
        let each = |(i, dx): (usize, &mut [MaybeUninit<f32>])| {
            let at = i * group_len..(i + 1) * group_len;
            let first = i % self.groups * s.per_group;
            let gamma = &gamma[first..first + s.per_group];
            self.group_backward(s, [x, out, grad].map(|all| &all[at.clone()]), gamma, dx)
        };
        let fill = |dx: &mut [MaybeUninit<f32>]| dx.par_chunks_mut(group_len).enumerate().map(each).collect();
        // SAFETY: groups make up all of `x`, and `group_backward` writes every number of a group.
        let (dx, moments): (_, Vec<Moments>) = unsafe { written(x.len(), fill) };
        let (mut dgamma, mut dbeta) = (vec![0.0; s.channels], vec![0.0; s.channels]);
        for (i, (along, level)) in moments.into_iter().flatten().enumerate() {
            dgamma[i % s.channels] += along;
            dbeta[i % s.channels] += level;
        }
        [dx, dgamma, dbeta]
    }

    /// One group's gradient into all of `dx`; returns (scale, shift) gradients of its channels.
    fn group_backward(
        &self,
        s: &Sizes,
        [x, out, grad]: [&[f32]; 3],
        gamma: &[f32],
        dx: &mut [MaybeUninit<f32>],
    ) -> Moments {
        let (mean, inverse) = mean_and_inverse_deviation(x);
        let mut inner = Scratch::take(x.len());
        for ((d, &g), &o) in inner.iter_mut().zip(grad).zip(out) {
            *d = if o > 0.0 { g } else { g * self.slope };
        }
        let moments: Moments = inner
            .chunks_exact(s.pixels)
            .zip(x.chunks_exact(s.pixels))
            .map(|(d, x)| (sum_pairs(d, x, |d, x| d * (x - mean)) * inverse, sum(d)))
            .collect();
        let count = x.len() as f32;
        let along = moments.iter().zip(gamma).map(|(m, g)| m.0 * g).sum::<f32>() / count;
        let level = moments.iter().zip(gamma).map(|(m, g)| m.1 * g).sum::<f32>() / count;
        let planes = dx.chunks_exact_mut(s.pixels).zip(x.chunks_exact(s.pixels)).zip(inner.chunks_exact(s.pixels));
        for (((dx, x), inner), &gamma) in planes.zip(gamma) {
            let (a, b) = (inverse * gamma, inverse * inverse * along);
            for ((dx, &x), &d) in dx.iter_mut().zip(x).zip(inner) {
                dx.write(a * d - inverse * level - b * (x - mean));
            }
        }
        moments
    }
}

type Moments = Vec<(f32, f32)>;

fn mean_and_inverse_deviation(x: &[f32]) -> (f32, f32) {
    let mean = sum(x) / x.len() as f32;
    let variance = sum_by(x, |v| (v - mean) * (v - mean)) / x.len() as f32;
    (mean, 1.0 / (variance + EPSILON).sqrt())
}

impl CustomOp3 for GroupNorm {
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
        let (x, gamma, beta) = (floats(NAME, s1, l1)?, floats(NAME, s2, l2)?, floats(NAME, s3, l3)?);
        let s = self.sizes(l1.shape(), gamma.len(), beta.len())?;
        let out = self.normalised(&s, x, gamma, beta);
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        gamma: &Tensor,
        beta: &Tensor,
        res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let s = self.sizes(x.shape(), gamma.elem_count(), beta.elem_count())?;
        let grad = grad.contiguous()?;
        let [dx, dgamma, dbeta] = with_floats(NAME, x, |x| {
            with_floats(NAME, res, |out| {
                with_floats(NAME, &grad, |grad| {
                    with_floats(NAME, gamma, |gamma| self.gradients(&s, [x, out, grad], gamma))
                })
            })
        })????;
        let dx = tensor(dx, x.shape())?;
        Ok((Some(dx), Some(tensor(dgamma, gamma.shape())?), Some(tensor(dbeta, beta.shape())?)))
    }
}

/// The rectifier's gradient from its result and that one's gradient.
pub(crate) fn leaky_gradient(out: &[f32], grad: &[f32], slope: f32) -> Vec<f32> {
    let operands = out.par_chunks(CHUNK).zip(grad.par_chunks(CHUNK));
    let fill = |dx: &mut [MaybeUninit<f32>]| {
        dx.par_chunks_mut(CHUNK).zip(operands).for_each(|(dx, (out, grad))| {
            for ((d, &o), &g) in dx.iter_mut().zip(out).zip(grad) {
                d.write(if o > 0.0 { g } else { g * slope });
            }
        });
    };
    assert_eq!(out.len(), grad.len(), "a result and its gradient");
    // SAFETY: all three are cut alike and are equally long.
    unsafe { written(out.len(), fill) }.0
}

/// The rectifier in place.
pub(crate) fn leaky_in_place(x: &mut [f32], slope: f32) {
    x.par_chunks_mut(CHUNK).for_each(|x| x.iter_mut().for_each(|v| *v = leaky(*v, slope)));
}

struct Leaky {
    slope: f32,
}

impl CustomOp1 for Leaky {
    fn name(&self) -> &'static str {
        "cairn-leaky-relu"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let x = floats(self.name(), storage, layout)?;
        let mut out = vec![0.0; x.len()];
        out.par_chunks_mut(CHUNK).zip(x.par_chunks(CHUNK)).for_each(|(out, x)| {
            for (o, &x) in out.iter_mut().zip(x) {
                *o = leaky(x, self.slope);
            }
        });
        Ok((CpuStorage::F32(out), layout.shape().clone()))
    }

    fn bwd(&self, x: &Tensor, res: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let dx = with_floats(self.name(), &grad, |grad| {
            with_floats(self.name(), res, |out| leaky_gradient(out, grad, self.slope))
        })??;
        Ok(Some(tensor(dx, x.shape())?))
    }
}
