//! Forward pass, input gradient and weight gradient over a whole batch.
//!
//! Work is cut by image and rows, never by thread, and every number is summed
//! by one task in one order: the thread count cannot change the bytes.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::frame::Frame;
use super::geometry::{Geometry, Plan, Task, cuts};
use super::kernel::{Sources, correlate, correlate_weights, tile_channels};
use super::lanes::{Isa, LANES};
use super::outer::products;
use super::scratch::Scratch;
use crate::raw::written;

/// A slice of a result plane that one task writes.
type Piece<'a> = &'a mut [MaybeUninit<f32>];

/// How weights are read: `w[results * strides[0] + sources * strides[1] + tap]`.
type Strides = [usize; 2];

/// `out[n][o] = bias[o] + sum over c and taps`, N x O x H' x W', of `x`,
/// N x C x H x W, and `w`, O x C x taps.
pub(crate) fn forward(isa: Isa, g: &Geometry, x: &[f32], w: &[f32], bias: Option<&[f32]>) -> Vec<f32> {
    let strides = [g.inputs * g.kernel_len(), g.kernel_len()];
    run(isa, &g.forward_plan(), x, w, strides, bias)
}

/// Gradient with respect to the input, N x C x H x W, from `grad`,
/// N x O x H' x W'; with a `bias`, C, a transposed convolution.
pub(crate) fn input_gradient(isa: Isa, g: &Geometry, grad: &[f32], w: &[f32], bias: Option<&[f32]>) -> Vec<f32> {
    let strides = [g.kernel_len(), g.inputs * g.kernel_len()];
    run(isa, &g.gradient_plan(), grad, w, strides, bias)
}

/// Computes a plan's results.
fn run(isa: Isa, plan: &Plan, source: &[f32], w: &[f32], strides: Strides, bias: Option<&[f32]>) -> Vec<f32> {
    let tiles = tiles(plan.result.channels, tile_channels(isa));
    let packed: Vec<Packed> = (0..plan.parts.len()).map(|part| Packed::new(plan, part, &tiles, w, strides)).collect();
    let zeros = vec![0.0; plan.result.channels];
    let bias = bias.unwrap_or(&zeros);
    let len = plan.batch * plan.result.channels * plan.result.pixels();
    let tasks = plan.tasks();
    let fill = |out: Piece<'_>| {
        let pieces = pieces(plan, &tasks, out);
        tasks.par_iter().zip(pieces).with_max_len(1).for_each(|(task, mut pieces)| {
            let frame = Frame::new(plan, task);
            let mut planes = Scratch::take(frame.len());
            frame.fill(source, &mut planes);
            let offsets: Vec<Vec<usize>> = (0..plan.parts.len()).map(|part| frame.offsets(part)).collect();
            let sources: Vec<Sources<'_>> = offsets.iter().map(|o| Sources::new(&planes, o, frame.span)).collect();
            for (t, &[from, to]) in tiles.iter().enumerate() {
                let result = (to - from) * frame.span;
                let mut spans = Scratch::take(plan.parts.len() * result);
                for ((sources, packed), out) in sources.iter().zip(&packed).zip(spans.chunks_exact_mut(result)) {
                    correlate(isa, *sources, packed.tile(t), &bias[from..to], out);
                }
                for k in 0..task.images {
                    for o in from..to {
                        let piece = &mut *pieces[k * plan.result.channels + o];
                        let span = |part: usize| &spans[part * result + (o - from) * frame.span..][..frame.span];
                        emit(plan, &frame, task, k, span, piece);
                    }
                }
            }
        });
    };
    // SAFETY: the tasks' pieces make up all of the planes, and `emit` writes every number of its piece.
    unsafe { written(len, fill) }.0
}

/// Copies the results of one plane's share from their spans, one a phase, to their pixels.
fn emit<'s>(
    plan: &Plan,
    frame: &Frame<'_>,
    task: &Task,
    k: usize,
    span: impl Fn(usize) -> &'s [f32],
    piece: Piece<'_>,
) {
    let side = &plan.result;
    let [rows, columns] = plan.results(task);
    let step = side.step[1];
    let width = columns[1] - columns[0];
    for (y, line) in (rows[0]..rows[1]).zip(piece.chunks_exact_mut(width.max(1))) {
        let (q, a) = ((y + side.before[0]) / side.step[0], (y + side.before[0]) % side.step[0]);
        // Grid column and phase of the line's first pixel.
        let (j, b) = ((columns[0] + side.before[1]) / step - task.columns[0], (columns[0] + side.before[1]) % step);
        let row = |b: usize| frame.result_row(span(a * step + b), k, q);
        match step {
            1 => copy(&row(0)[j..], line),
            2 => weave(&row(b)[j..], &row(1 - b)[j + b..], line),
            _ => {
                for i in 0..step.min(width) {
                    let from = &row((b + i) % step)[j + (b + i) / step..];
                    line[i..].iter_mut().step_by(step).zip(from).for_each(|(to, v)| _ = to.write(*v));
                }
            }
        }
    }
}

/// Fills `line` from `row`, which MUST be as long or longer.
fn copy(row: &[f32], line: &mut [MaybeUninit<f32>]) {
    let row = &row[..line.len()];
    line.iter_mut().zip(row).for_each(|(to, v)| _ = to.write(*v));
}

/// Fills `line` with `even[0], odd[0], even[1], ...`, which MUST be long enough.
fn weave(even: &[f32], odd: &[f32], line: &mut [MaybeUninit<f32>]) {
    let (even, odd) = (&even[..line.len().div_ceil(2)], &odd[..line.len() / 2]);
    let mut pairs = line.chunks_exact_mut(2);
    for ((pair, e), o) in (&mut pairs).zip(even).zip(odd) {
        pair[0].write(*e);
        pair[1].write(*o);
    }
    if let ([last], Some(e)) = (pairs.into_remainder(), even.last()) {
        last.write(*e);
    }
}

/// Cuts the result planes: for each task its pieces, image by image, channel by channel.
fn pieces<'a>(plan: &Plan, tasks: &[Task], out: Piece<'a>) -> Vec<Vec<Piece<'a>>> {
    let mut pieces: Vec<Vec<Piece<'a>>> = tasks.iter().map(|_| Vec::new()).collect();
    let mut next = 0;
    for (n, image) in out.chunks_exact_mut(plan.result.channels * plan.result.pixels()).enumerate() {
        while tasks[next].first + tasks[next].images <= n {
            next += 1;
        }
        let of = tasks[next..].iter().take_while(|task| task.first <= n).count();
        for mut plane in image.chunks_exact_mut(plan.result.pixels()) {
            for (task, pieces) in tasks[next..].iter().zip(&mut pieces[next..]).take(of) {
                let len: usize = plan.results(task).iter().map(|[from, to]| to - from).product();
                let (piece, rest) = std::mem::take(&mut plane).split_at_mut(len);
                pieces.push(piece);
                plane = rest;
            }
            assert!(plane.is_empty(), "the tasks leave {} pixels of a plane out", plane.len());
        }
    }
    pieces
}

/// One part's weights, tile by tile, in the order in which [`correlate`] reads them.
struct Packed(Vec<Vec<f32>>);

impl Packed {
    fn new(plan: &Plan, part: usize, tiles: &[[usize; 2]], w: &[f32], strides: Strides) -> Self {
        let taps = &plan.parts[part].taps;
        let sources = plan.source.channels * taps.len();
        let pack = |&[from, to]: &[usize; 2]| {
            let mut tile = Vec::with_capacity(sources * (to - from));
            for c in 0..plan.source.channels {
                for tap in taps {
                    let at = c * strides[1] + tap.index;
                    tile.extend((from..to).map(|o| w[o * strides[0] + at]));
                }
            }
            tile
        };
        // Few weights are packed before another thread has woken up.
        let alone = sources * plan.result.channels < SHARE;
        Self(if alone { tiles.iter().map(pack).collect() } else { tiles.par_iter().map(pack).collect() })
    }

    fn tile(&self, t: usize) -> &[f32] {
        &self.0[t]
    }
}

/// `channels` in as few tiles of at most `most` as there can be, as even as they can be.
fn tiles(channels: usize, most: usize) -> Vec<[usize; 2]> {
    let count = channels.div_ceil(most);
    (0..count).map(|t| [t * channels / count, (t + 1) * channels / count]).collect()
}

/// Output channels are the lanes of the weights' gradient from this many on,
/// and from this many sources: fewer do not pay for the gradients' rearrangement.
const MANY: [usize; 2] = [16, 72];

/// Sums of the weights' gradient that exist side by side at most, each over
/// some tasks; they are as large as the weights.
const SHARES: usize = 16;

/// Weights that one task packs or adds up at least.
const SHARE: usize = 1 << 13;

/// Gradient with respect to the weights, O x C x kH x kW.
pub(crate) fn weight_gradient(isa: Isa, g: &Geometry, x: &[f32], grad: &[f32]) -> Vec<f32> {
    let plan = g.forward_plan();
    let tasks = plan.tasks();
    let sources = g.inputs * g.kernel_len();
    let lanes = g.outputs.next_multiple_of(LANES);
    let across = g.outputs >= MANY[0] && sources >= MANY[1] && 4 * (lanes - g.outputs) <= lanes;
    let len = sources * if across { lanes } else { g.outputs };
    let shares = cuts(tasks.len(), tasks.len().div_ceil(SHARES));
    let mut partial = Scratch::take(shares.len() * len);
    shares.par_iter().zip(partial.par_chunks_mut(len)).with_max_len(1).for_each(|(&[from, to], out)| {
        out.fill(0.0);
        for task in &tasks[from..to] {
            let frame = Frame::new(&plan, task);
            let mut planes = Scratch::take(frame.len());
            frame.fill(x, &mut planes);
            let offsets = frame.offsets(0);
            if across {
                let rows = frame.rows();
                let mut wide = Scratch::take(rows.positions() * lanes);
                frame.fill_positions(grad, lanes, &mut wide);
                products(isa, &planes, &offsets, rows, &wide, lanes, out);
            } else {
                let pitch = frame.results_pitch();
                let mut wide = Scratch::take(g.outputs * pitch);
                frame.fill_results(grad, &mut wide);
                correlate_weights(isa, Sources::new(&planes, &offsets, frame.span), &wide, pitch, out);
            }
        }
    });
    let (sum, shares) = partial.split_at_mut(len);
    sum.par_chunks_mut(SHARE).enumerate().for_each(|(i, sum)| {
        for share in shares.chunks_exact(len) {
            sum.iter_mut().zip(&share[i * SHARE..]).for_each(|(s, v)| *s += v);
        }
    });
    if across { transposed(sum, lanes, g.outputs) } else { sum.to_vec() }
}

/// The first `channels` columns of `sum` (sources x lanes) as rows.
fn transposed(sum: &[f32], lanes: usize, channels: usize) -> Vec<f32> {
    let sources = sum.len() / lanes;
    let mut out = vec![0.0; channels * sources];
    // A cache line of lanes at a time.
    out.par_chunks_mut(LANES * sources).enumerate().for_each(|(i, rows)| {
        for (s, share) in sum.chunks_exact(lanes).enumerate() {
            for (row, v) in rows.chunks_exact_mut(sources).zip(&share[i * LANES..]) {
                row[s] = *v;
            }
        }
    });
    out
}

/// Gradient with respect to the bias: sums over `grad`, N x `channels` x `pixels`.
pub(crate) fn bias_gradient(grad: &[f32], channels: usize, pixels: usize) -> Vec<f32> {
    let batch = grad.len() / (channels * pixels);
    (0..channels)
        .into_par_iter()
        .map(|o| (0..batch).map(|i| crate::sum::sum(&grad[(i * channels + o) * pixels..][..pixels])).sum())
        .collect()
}
