//! The networks' fixed first step: make faint marks large.
//!
//! A hidden mark has an amplitude of about one 255th, under picture content a
//! hundred times larger. Beside the picture the networks therefore see its
//! amplified difference from a blur of itself, in opponent colours (fine detail is
//! nearly all lightness in pictures of anything, and would drown the colours),
//! squashed so that an edge counts little more than a mark (the truncated linear
//! unit of steganalysis, Ye, Ni and Yi 2017, made smooth); the detector also sees
//! the class probabilities as flat channels.

use candle_core::{CpuStorage, CustomOp1, CustomOp2, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use crate::raw::{floats, tensor, with_floats};
use crate::sum::sum;

/// The binomial kernel of five taps.
const BLUR: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const REACH: usize = BLUR.len() / 2;
/// Further amplification of the two colour channels.
const CHROMA: f32 = 4.0;

/// `[x, s(gain A (x - blur x)), classes]` along the channels, `s(v) = v / (1 + |v|)`: from `x`, N x C x H x W,
/// and `classes`, N x K, N x (2C + K) x H x W. The blur is binomial, 5 x 5, with
/// the border repeated. `A` turns red, green and blue into lightness and, four
/// times amplified, red-green and yellow-blue (rows of an orthonormal matrix);
/// with other than three channels it is the identity. Without gain (0) the second
/// part is left out.
///
/// # Errors
/// When shapes do not fit or a tensor is not f32 on the CPU.
pub fn front_end(x: &Tensor, gain: f32, classes: Option<&Tensor>) -> Result<Tensor> {
    let op = FrontEnd { gain, copies: true };
    match classes {
        None => x.contiguous()?.apply_op1(op),
        Some(classes) => x.contiguous()?.apply_op2(&classes.contiguous()?, op),
    }
}

/// The second part of [`front_end`] alone, N x C x H x W, with `gain` above 0: for whoever shall not see the picture itself. To
/// the same bytes.
pub(crate) fn residual(x: &Tensor, gain: f32) -> Result<Tensor> {
    x.contiguous()?.apply_op1(FrontEnd { gain, copies: false })
}

/// Channels that [`front_end`] makes of `channels` and `classes`.
pub(crate) fn front_channels(channels: usize, gain: f32, classes: usize) -> usize {
    channels * if gain == 0.0 { 1 } else { 2 } + classes
}

struct FrontEnd {
    gain: f32,
    /// Whether the picture itself comes first.
    copies: bool,
}

const NAME: &str = "cairn-front-end";

impl FrontEnd {
    /// How many of `channels` come first as they are.
    fn copied(&self, channels: usize) -> usize {
        if self.copies { channels } else { 0 }
    }

    fn forward(&self, x: &[f32], shape: &Shape, classes: Option<(&[f32], &Shape)>) -> Result<(CpuStorage, Shape)> {
        let (n, c, h, w) = shape.dims4()?;
        let k = match classes {
            None => 0,
            Some((_, s)) if s.dims().len() == 2 && s.dims()[0] == n => s.dims()[1],
            Some((_, s)) => candle_core::bail!("{NAME}: {n} images need N x K classes, got {s:?}"),
        };
        if x.is_empty() {
            candle_core::bail!("{NAME}: the input {shape:?} is empty");
        }
        let copied = self.copied(c);
        let channels = front_channels(c, self.gain, k) + copied - c;
        let pixels = h * w;
        let mut out = vec![0.0; n * channels * pixels];
        out.par_chunks_mut(channels * pixels).enumerate().for_each(|(image, out)| {
            let (seen, flat) = out.split_at_mut((channels - k) * pixels);
            let (copy, high) = seen.split_at_mut(copied * pixels);
            let x = &x[image * c * pixels..][..c * pixels];
            copy.copy_from_slice(&x[..copied * pixels]);
            if self.gain != 0.0 {
                self.residual(x, w, pixels, high);
                high.iter_mut().for_each(|v| *v /= 1.0 + v.abs());
            }
            if let Some((classes, _)) = classes {
                for (plane, class) in flat.chunks_exact_mut(pixels).zip(&classes[image * k..]) {
                    plane.fill(*class);
                }
            }
        });
        Ok((CpuStorage::F32(out), (n, channels, h, w).into()))
    }

    fn backward(&self, x: &[f32], shape: &Shape, grad: &[f32], channels: usize) -> Result<Tensor> {
        let (n, c, h, w) = shape.dims4()?;
        let pixels = h * w;
        let mut dx = vec![0.0; n * c * pixels];
        dx.par_chunks_mut(c * pixels).enumerate().for_each(|(image, dx)| {
            let at = |channel: usize| &grad[(image * channels + channel) * pixels..][..c * pixels];
            let copied = self.copied(c);
            dx[..copied * pixels].copy_from_slice(&at(0)[..copied * pixels]);
            if self.gain != 0.0 {
                let mut slope = vec![0.0; c * pixels];
                self.residual(&x[image * c * pixels..][..c * pixels], w, pixels, &mut slope);
                for (s, g) in slope.iter_mut().zip(at(copied)) {
                    *s = g / (1.0 + s.abs()).powi(2);
                }
                mix(&mut slope, pixels, true);
                for (slope, dx) in slope.chunks_exact(pixels).zip(dx.chunks_exact_mut(pixels)) {
                    high_pass_adjoint(slope, w, self.gain, dx);
                }
            }
        });
        tensor(dx, shape)
    }

    /// `gain A (x - blur x)` of one image's planes, `pixels` numbers each in rows of `w`, into `out`.
    fn residual(&self, x: &[f32], w: usize, pixels: usize, out: &mut [f32]) {
        for (x, out) in x.chunks_exact(pixels).zip(out.chunks_exact_mut(pixels)) {
            high_pass(x, w, self.gain, out);
        }
        mix(out, pixels, false);
    }
}

/// Opponent colours: lightness, red-green, yellow-blue; orthonormal rows times their amplification.
fn opponent() -> [[f32; 3]; 3] {
    let (grey, two, six) = ((1.0f32 / 3.0).sqrt(), CHROMA * 0.5f32.sqrt(), CHROMA * (1.0f32 / 6.0).sqrt());
    [[grey; 3], [two, -two, 0.0], [six, six, -2.0 * six]]
}

/// Three planes to opponent colours in place, or their gradients back (the transpose).
fn mix(planes: &mut [f32], pixels: usize, back: bool) {
    if planes.len() != 3 * pixels {
        return;
    }
    let a = opponent();
    let (r, rest) = planes.split_at_mut(pixels);
    let (g, b) = rest.split_at_mut(pixels);
    for ((r, g), b) in r.iter_mut().zip(g).zip(b) {
        let v = [*r, *g, *b];
        let of = |k: usize| match back {
            false => a[k][0] * v[0] + a[k][1] * v[1] + a[k][2] * v[2],
            true => a[0][k] * v[0] + a[1][k] * v[1] + a[2][k] * v[2],
        };
        (*r, *g, *b) = (of(0), of(1), of(2));
    }
}

/// `gain (x - blur x)` into `out`.
fn high_pass(x: &[f32], w: usize, gain: f32, out: &mut [f32]) {
    let h = x.len() / w;
    let mut line = vec![0.0; w + 2 * REACH];
    for (y, out) in out.chunks_exact_mut(w).enumerate() {
        line.fill(0.0);
        for (t, weight) in BLUR.iter().enumerate() {
            let from = (y + t).saturating_sub(REACH).min(h - 1);
            for (l, v) in line[REACH..REACH + w].iter_mut().zip(&x[from * w..(from + 1) * w]) {
                *l += weight * v;
            }
        }
        let (left, right) = (line[REACH], line[REACH + w - 1]);
        line[..REACH].fill(left);
        line[REACH + w..].fill(right);
        for (i, (o, v)) in out.iter_mut().zip(&x[y * w..(y + 1) * w]).enumerate() {
            let blur: f32 = line[i..i + 2 * REACH + 1].iter().zip(BLUR).map(|(l, b)| l * b).sum();
            *o = gain * (v - blur);
        }
    }
}

/// Adds the gradient of [`high_pass`]'s input, given its output's, to `dx`.
fn high_pass_adjoint(grad: &[f32], w: usize, gain: f32, dx: &mut [f32]) {
    let h = grad.len() / w;
    let mut line = vec![0.0; w + 2 * REACH];
    for (y, g) in grad.chunks_exact(w).enumerate() {
        line.fill(0.0);
        for (t, weight) in BLUR.iter().enumerate() {
            for (l, v) in line[t..t + w].iter_mut().zip(g) {
                *l += weight * v;
            }
        }
        for edge in 0..REACH {
            line[REACH] += line[edge];
            line[REACH + w - 1] += line[REACH + w + edge];
        }
        for (d, v) in dx[y * w..(y + 1) * w].iter_mut().zip(g) {
            *d += gain * v;
        }
        for (t, weight) in BLUR.iter().enumerate() {
            let to = (y + t).saturating_sub(REACH).min(h - 1);
            for (d, l) in dx[to * w..(to + 1) * w].iter_mut().zip(&line[REACH..REACH + w]) {
                *d -= gain * weight * l;
            }
        }
    }
}

impl CustomOp1 for FrontEnd {
    fn name(&self) -> &'static str {
        NAME
    }

    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        self.forward(floats(NAME, s, l)?, l.shape(), None)
    }

    fn bwd(&self, x: &Tensor, res: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let channels = res.dim(1)?;
        let x = x.contiguous()?;
        with_floats(NAME, &grad.contiguous()?, |g| {
            with_floats(NAME, &x, |v| self.backward(v, x.shape(), g, channels))?
        })?
        .map(Some)
    }
}

impl CustomOp2 for FrontEnd {
    fn name(&self) -> &'static str {
        NAME
    }

    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        self.forward(floats(NAME, s1, l1)?, l1.shape(), Some((floats(NAME, s2, l2)?, l2.shape())))
    }

    fn bwd(
        &self,
        x: &Tensor,
        classes: &Tensor,
        res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (n, channels, h, w) = res.dims4()?;
        let (k, pixels) = (classes.dim(1)?, h * w);
        let grad = grad.contiguous()?;
        let dx = if x.track_op() {
            let x = x.contiguous()?;
            Some(with_floats(NAME, &grad, |g| with_floats(NAME, &x, |v| self.backward(v, x.shape(), g, channels))?)??)
        } else {
            None
        };
        let flat = with_floats(NAME, &grad, |g| {
            let plane = |i: usize, j: usize| &g[(i * channels + channels - k + j) * pixels..][..pixels];
            (0..n * k).map(|at| sum(plane(at / k, at % k))).collect()
        })?;
        Ok((dx, Some(tensor(flat, classes.shape())?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raw::bits;
    use candle_core::{Device, Var};

    #[test]
    fn the_residual_alone_is_the_front_ends_second_part_also_backwards() -> Result<()> {
        let data = (0..2 * 3 * 9 * 7).map(|i| 0.5 + 0.5 * (i as f32 * 0.739).sin()).collect::<Vec<_>>();
        let x = Var::from_tensor(&Tensor::from_vec(data, (2, 3, 9, 7), &Device::Cpu)?)?;
        let part = front_end(&x, 30.0, None)?.narrow(1, 3, 3)?.contiguous()?;
        let alone = residual(&x, 30.0)?;
        assert_eq!(bits(&part)?, bits(&alone)?);
        let weight = (part.detach().affine(2.0, 0.3)?.sqr()? + 0.1)?;
        let [a, b] = [part, alone].map(|t| {
            let grads = (t * &weight)?.backward()?;
            bits(grads.get(&x).expect("a gradient"))
        });
        assert_eq!(a?, b?);
        Ok(())
    }
}
