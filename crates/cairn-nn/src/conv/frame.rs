//! Where a task's pixels lie while it works: zero-padded planes in a buffer
//! that fits the second-level cache.

use super::geometry::{Plan, Side, Task};
use super::lanes::LANES;

/// The layout of one task: for each channel one plane a source phase, in each
/// the task's images one below the other in rows of `pitch`.
pub(crate) struct Frame<'a> {
    plan: &'a Plan,
    task: &'a Task,
    pub(crate) pitch: usize,
    /// Rows of one image, those that taps reach included.
    block_rows: usize,
    phase_len: usize,
    /// Numbers a channel.
    plane_len: usize,
    /// Positions from the first to the last result, in whole vectors.
    pub(crate) span: usize,
}

impl<'a> Frame<'a> {
    pub(crate) fn new(plan: &'a Plan, task: &'a Task) -> Self {
        let [rows, columns] = [task.rows, task.columns].map(|[from, to]| to - from);
        let (block_rows, pitch) = (rows + plan.reach[0], columns + plan.reach[1]);
        let phase_len = task.images * block_rows * pitch;
        // The last vector may run over the last phase's end.
        let plane_len = apart((plan.used.len() * phase_len + LANES).next_multiple_of(LANES));
        let span = (((task.images - 1) * block_rows + rows - 1) * pitch + columns).next_multiple_of(LANES);
        Self { plan, task, pitch, block_rows, phase_len, plane_len, span }
    }

    /// Numbers of all planes.
    pub(crate) fn len(&self) -> usize {
        self.plan.source.channels * self.plane_len
    }

    /// Offsets of every source of the part: channel by channel, tap by tap.
    pub(crate) fn offsets(&self, part: usize) -> Vec<usize> {
        let taps = &self.plan.parts[part].taps;
        let mut offsets = Vec::with_capacity(self.plan.source.channels * taps.len());
        for c in 0..self.plan.source.channels {
            offsets.extend(
                taps.iter().map(|tap| {
                    c * self.plane_len + tap.phase * self.phase_len + tap.shift[0] * self.pitch + tap.shift[1]
                }),
            );
        }
        offsets
    }

    /// Copies the task's share of `source`, N x C x H x W, into `planes` and
    /// writes zeros wherever there is no pixel.
    pub(crate) fn fill(&self, source: &[f32], planes: &mut [f32]) {
        let side = &self.plan.source;
        let pixels = side.pixels();
        for (c, plane) in planes.chunks_exact_mut(self.plane_len).enumerate() {
            for (i, phase) in self.plan.used.iter().enumerate() {
                for k in 0..self.task.images {
                    let image = &source[((self.task.first + k) * side.channels + c) * pixels..][..pixels];
                    let block = &mut plane[i * self.phase_len + k * self.block_rows * self.pitch..];
                    self.fill_block(side, image, *phase, &mut block[..self.block_rows * self.pitch]);
                }
            }
            plane[self.plan.used.len() * self.phase_len..].fill(0.0);
        }
    }

    fn fill_block(&self, side: &Side, image: &[f32], phase: [usize; 2], block: &mut [f32]) {
        let [width, step] = [side.size[1], side.step[1]];
        // Pixel of the frame's first column, and the first column that has one.
        let start = (self.task.columns[0] * step + phase[1]) as isize - side.before[1] as isize;
        let first = if start < 0 { ((-start) as usize).div_ceil(step) } else { 0 }.min(self.pitch);
        let from = (start + (first * step) as isize) as usize;
        for (r, line) in block.chunks_exact_mut(self.pitch).enumerate() {
            let y = ((self.task.rows[0] + r) * side.step[0] + phase[0]).wrapping_sub(side.before[0]);
            let row = if y < side.size[0] { &image[y * width..(y + 1) * width] } else { &[][..] };
            let row = row.get(from..).unwrap_or(&[]);
            let count = row.len().div_ceil(step).min(self.pitch - first);
            line[..first].fill(0.0);
            line[first + count..].fill(0.0);
            let line = &mut line[first..first + count];
            match step {
                1 => line.copy_from_slice(&row[..count]),
                2 => halve(row, line),
                _ => line.iter_mut().zip(row.iter().step_by(step)).for_each(|(to, v)| *to = *v),
            }
        }
    }

    /// Lays the results' gradients, N x O x H x W, out like the results of this
    /// frame, `O x pitch` with zeros where no pixel is; returns the pitch.
    /// Only for plans whose results have no phases.
    pub(crate) fn fill_results(&self, grads: &[f32], wide: &mut [f32]) {
        let side = &self.plan.result;
        let (rows, columns) = (self.task.rows, self.task.columns);
        for (o, wide) in wide.chunks_exact_mut(self.results_pitch()).enumerate() {
            let mut end = 0;
            for k in 0..self.task.images {
                let image = &grads[((self.task.first + k) * side.channels + o) * side.pixels()..][..side.pixels()];
                for y in rows[0]..rows[1] {
                    let at = (k * self.block_rows + y - rows[0]) * self.pitch;
                    wide[end..at].fill(0.0);
                    end = at + columns[1] - columns[0];
                    wide[at..end].copy_from_slice(&image[y * side.size[1]..][columns[0]..columns[1]]);
                }
            }
            wide[end..].fill(0.0);
        }
    }

    /// Numbers a channel in [`Self::fill_results`].
    pub(crate) fn results_pitch(&self) -> usize {
        apart(self.span)
    }

    /// The row of results of grid row `q` (of image `k` of the task) in a span.
    pub(crate) fn result_row<'b>(&self, span: &'b [f32], k: usize, q: usize) -> &'b [f32] {
        let at = (k * self.block_rows + q - self.task.rows[0]) * self.pitch;
        &span[at..at + self.task.columns[1] - self.task.columns[0]]
    }
}

/// Every second number of `row`.
fn halve(row: &[f32], line: &mut [f32]) {
    let pairs = row.chunks_exact(2);
    if let ([last], true) = (pairs.remainder(), line.len() > row.len() / 2) {
        line[row.len() / 2] = *last;
    }
    for (to, pair) in line.iter_mut().zip(pairs) {
        *to = pair[0];
    }
}

/// `len` or a little more: channels a multiple of 4 KiB apart would share few
/// sets of the first-level cache.
fn apart(len: usize) -> usize {
    if len.is_multiple_of(512) { len + LANES } else { len }
}
