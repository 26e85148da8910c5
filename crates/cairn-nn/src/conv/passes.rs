//! Forward pass, input gradient and weight gradient over a whole batch.
//!
//! Work is cut by image and by tile of channels, never by thread, and every
//! number is summed by one task in one order: the thread count cannot change
//! the bytes.

use rayon::prelude::*;

use super::geometry::{Geometry, Layout};
use super::kernel::{Planes, TILE_CHANNELS, correlate, correlate_weights};
use super::lanes::LANES;

/// A batch in padded planes.
struct Padded {
    data: Vec<f32>,
    channels: usize,
    plane_len: usize,
}

impl Padded {
    fn new(images: &[f32], batch: usize, channels: usize, size: [usize; 2], layout: &Layout) -> Self {
        let plane_len = layout.plane_len();
        let mut data = vec![0.0; batch * channels * plane_len];
        data.par_chunks_mut(plane_len)
            .zip(images.par_chunks(size[0] * size[1]))
            .for_each(|(plane, pixels)| layout.fill(pixels, size, plane));
        Self { data, channels, plane_len }
    }

    fn image(&self, i: usize) -> Planes<'_> {
        let len = self.channels * self.plane_len;
        Planes { data: &self.data[i * len..(i + 1) * len], channels: self.channels, plane_len: self.plane_len }
    }
}

/// `out[n][o] = bias[o] + sum over c and taps`, N x O x H' x W'.
pub(crate) fn forward(g: &Geometry, x: &[f32], w: &[f32], bias: Option<&[f32]>) -> Vec<f32> {
    let layout = g.input_layout();
    let (taps, kernel) = (g.taps(), g.kernel_len());
    let padded = Padded::new(x, g.batch, g.inputs, g.input, &layout);
    let packed: Vec<Vec<f32>> = tiles(g.outputs)
        .map(|(first, count)| {
            let mut tile = Vec::with_capacity(g.inputs * kernel * count);
            for ct in 0..g.inputs * kernel {
                tile.extend((first..first + count).map(|o| w[o * g.inputs * kernel + ct]));
            }
            tile
        })
        .collect();
    let zeros = [0.0; TILE_CHANNELS];
    let pixels = g.output[0] * g.output[1];
    let span = layout.padded_span(g.output);
    let mut out = vec![0.0; g.batch * g.output_len()];
    out.par_chunks_mut(g.output_len())
        .enumerate()
        .flat_map(|(i, image)| {
            image.par_chunks_mut(TILE_CHANNELS * pixels).enumerate().map(move |(t, tile)| (i, t, tile))
        })
        .for_each_init(Vec::new, |scratch: &mut Vec<f32>, (i, t, tile)| {
            let count = tile.len() / pixels;
            let bias = bias.map_or(&zeros[..count], |b| &b[t * TILE_CHANNELS..t * TILE_CHANNELS + count]);
            scratch.resize(count * span, 0.0);
            correlate(padded.image(i), &taps, &packed[t], bias, scratch);
            for (plane, wide) in tile.chunks_exact_mut(pixels).zip(scratch.chunks_exact(span)) {
                for (row, from) in plane.chunks_exact_mut(g.output[1]).zip(wide.chunks(layout.columns)) {
                    row.copy_from_slice(&from[..g.output[1]]);
                }
            }
        });
    out
}

/// Gradient with respect to the input, N x C x H x W, from `grad`, N x O x H' x W'.
pub(crate) fn input_gradient(g: &Geometry, grad: &[f32], w: &[f32]) -> Vec<f32> {
    let layout = g.gradient_layout();
    let padded = Padded::new(grad, g.batch, g.outputs, g.output, &layout);
    let phases: Vec<Phase> =
        (0..g.stride[0]).flat_map(|a| (0..g.stride[1]).map(move |b| [a, b])).map(|at| Phase::new(g, w, at)).collect();
    let size = g.gradient_output();
    let span = layout.padded_span(size);
    let pixels = g.input[0] * g.input[1];
    let zeros = [0.0; TILE_CHANNELS];
    let mut out = vec![0.0; g.batch * g.input_len()];
    out.par_chunks_mut(g.input_len())
        .enumerate()
        .flat_map(|(i, image)| {
            image.par_chunks_mut(TILE_CHANNELS * pixels).enumerate().map(move |(t, tile)| (i, t, tile))
        })
        .for_each_init(Vec::new, |scratch: &mut Vec<f32>, (i, t, tile)| {
            let count = tile.len() / pixels;
            scratch.resize(count * span, 0.0);
            for phase in phases.iter().filter(|p| !p.taps.is_empty()) {
                correlate(padded.image(i), &phase.taps, &phase.packed[t], &zeros[..count], scratch);
                for (plane, wide) in tile.chunks_exact_mut(pixels).zip(scratch.chunks_exact(span)) {
                    phase.scatter(g, wide, layout.columns, plane);
                }
            }
        });
    out
}

/// The input pixels whose padded row and column leave the same remainders when
/// divided by the stride: each phase is a convolution with some of the taps.
struct Phase {
    at: [usize; 2],
    taps: Vec<usize>,
    /// A tile of input channels each: outputs x taps x tile.
    packed: Vec<Vec<f32>>,
}

impl Phase {
    fn new(g: &Geometry, w: &[f32], at: [usize; 2]) -> Self {
        let taps = g.gradient_taps(at);
        let kernel = g.kernel_len();
        let packed = tiles(g.inputs)
            .map(|(first, count)| {
                let mut tile = Vec::with_capacity(g.outputs * taps.len() * count);
                for o in 0..g.outputs {
                    for &(t, _) in &taps {
                        tile.extend((first..first + count).map(|c| w[(o * g.inputs + c) * kernel + t]));
                    }
                }
                tile
            })
            .collect();
        Self { at, taps: taps.into_iter().map(|(_, offset)| offset).collect(), packed }
    }

    /// Copies this phase's results, rows of `columns`, to their pixels.
    fn scatter(&self, g: &Geometry, wide: &[f32], columns: usize, plane: &mut [f32]) {
        let [sh, sw] = g.stride;
        let [ph, pw] = g.padding;
        let count = g.gradient_output();
        let first = (pw + sw - 1 - self.at[1]) / sw;
        let start = first * sw + self.at[1] - pw;
        for (q, from) in wide.chunks(columns).take(count[0]).enumerate() {
            let Some(y) = (q * sh + self.at[0]).checked_sub(ph).filter(|&y| y < g.input[0]) else { continue };
            let row = &mut plane[y * g.input[1]..(y + 1) * g.input[1]];
            if sw == 1 {
                let n = row.len();
                row.copy_from_slice(&from[first..first + n]);
            } else if start < row.len() {
                for (to, v) in row[start..].iter_mut().step_by(sw).zip(&from[first..count[1].max(first)]) {
                    *to = *v;
                }
            }
        }
    }
}

/// Gradient with respect to the weights, O x C x kH x kW.
pub(crate) fn weight_gradient(g: &Geometry, x: &[f32], grad: &[f32]) -> Vec<f32> {
    let layout = g.input_layout();
    let taps = g.taps();
    let padded = Padded::new(x, g.batch, g.inputs, g.input, &layout);
    let pixels = g.output[0] * g.output[1];
    let span = layout.span(g.output).next_multiple_of(LANES);
    let row_len = g.inputs * g.kernel_len();
    let tile_len = TILE_CHANNELS * row_len;
    let mut partial = vec![0.0; g.batch * g.outputs * row_len];
    partial
        .par_chunks_mut(g.outputs * row_len)
        .zip(grad.par_chunks(g.output_len()))
        .enumerate()
        .flat_map(|(i, (out, grad))| {
            let grads = grad.par_chunks(TILE_CHANNELS * pixels);
            out.par_chunks_mut(tile_len).zip(grads).map(move |(out, grad)| (i, out, grad))
        })
        .for_each_init(Vec::new, |scratch: &mut Vec<f32>, (i, out, grad)| {
            scratch.clear();
            scratch.resize(grad.len() / pixels * span, 0.0);
            for (wide, plane) in scratch.chunks_exact_mut(span).zip(grad.chunks_exact(pixels)) {
                for (to, row) in wide.chunks_mut(layout.columns).zip(plane.chunks_exact(g.output[1])) {
                    to[..row.len()].copy_from_slice(row);
                }
            }
            correlate_weights(padded.image(i), &taps, scratch, span, out);
        });
    let (sum, rest) = partial.split_at_mut(g.outputs * row_len);
    for other in rest.chunks_exact(sum.len()) {
        for (s, o) in sum.iter_mut().zip(other) {
            *s += o;
        }
    }
    partial.truncate(g.outputs * row_len);
    partial
}

/// Gradient with respect to the bias, O.
pub(crate) fn bias_gradient(g: &Geometry, grad: &[f32]) -> Vec<f32> {
    let pixels = g.output[0] * g.output[1];
    (0..g.outputs)
        .into_par_iter()
        .map(|o| {
            let planes = (0..g.batch).map(|i| &grad[(i * g.outputs + o) * pixels..][..pixels]);
            planes.map(crate::sum::sum).sum()
        })
        .collect()
}

/// (first channel, channels) of every tile.
fn tiles(channels: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..channels).step_by(TILE_CHANNELS).map(move |first| (first, TILE_CHANNELS.min(channels - first)))
}
