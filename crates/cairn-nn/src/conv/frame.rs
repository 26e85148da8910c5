//! Where a task's pixels lie while it works: zero-padded planes in a buffer
//! that fits the second-level cache.

use super::geometry::{Plan, Task};
use super::lanes::LANES;
use super::outer::{Rows, side_by_side};

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
        // All at once: borders are a few numbers here and there.
        planes.fill(0.0);
        let side = &self.plan.source;
        let (pixels, block_len) = (side.pixels(), self.block_rows * self.pitch);
        for (c, plane) in planes.chunks_exact_mut(self.plane_len).enumerate() {
            let mut phases = self.plan.used.as_slice();
            let mut start = 0;
            while let [phase, after @ ..] = phases {
                // The two halves of a row are taken apart in one go.
                let both = side.step[1] == 2 && phase[1] == 0 && after.first() == Some(&[phase[0], 1]);
                let (these, rest) = plane[start..].split_at_mut(self.phase_len);
                for k in 0..self.task.images {
                    let image = &source[((self.task.first + k) * side.channels + c) * pixels..][..pixels];
                    let block = &mut these[k * block_len..(k + 1) * block_len];
                    match both {
                        true => self.fill_pair(image, phase[0], [block, &mut rest[k * block_len..(k + 1) * block_len]]),
                        false => self.fill_block(image, *phase, block),
                    }
                }
                let done = if both { 2 } else { 1 };
                start += done * self.phase_len;
                phases = &phases[done..];
            }
        }
    }

    /// Each row of a block that has pixels, phase `a`, with the source's row.
    fn source_rows(&self, a: usize) -> impl Iterator<Item = (usize, usize)> {
        let side = &self.plan.source;
        let (start, step, before, size) = (self.task.rows[0], side.step[0], side.before[0], side.size[0]);
        let source = move |r: usize| (r, ((start + r) * step + a).wrapping_sub(before));
        (0..self.block_rows).map(source).filter(move |(_, y)| *y < size)
    }

    /// Even and odd columns of phase `a`, for a step of 2.
    fn fill_pair(&self, image: &[f32], a: usize, [even, odd]: [&mut [f32]; 2]) {
        let (first, before) = (2 * self.task.columns[0], self.plan.source.before[1]);
        // Padded columns without a pixel, and pixels before the first padded column.
        let (lead, from) = (before.saturating_sub(first), first.saturating_sub(before));
        let (at, width) = (lead / 2, self.plan.source.size[1]);
        if at >= self.pitch || from >= width {
            return;
        }
        for (r, y) in self.source_rows(a) {
            let mut row = &image[y * width + from..(y + 1) * width];
            let line = r * self.pitch + at..(r + 1) * self.pitch;
            let (mut even, mut odd) = (&mut even[line.clone()], &mut odd[line]);
            if lead % 2 == 1 {
                odd[0] = row[0];
                (even, odd, row) = (&mut even[1..], &mut odd[1..], &row[1..]);
            }
            let count = (row.len() / 2).min(even.len());
            for ((e, o), pair) in even.iter_mut().zip(odd).zip(row[..2 * count].chunks_exact(2)) {
                (*e, *o) = (pair[0], pair[1]);
            }
            if let (Some(e), Some(v)) = (even.get_mut(count), row.get(2 * count)) {
                *e = *v;
            }
        }
    }

    fn fill_block(&self, image: &[f32], phase: [usize; 2], block: &mut [f32]) {
        let side = &self.plan.source;
        let (step, width) = (side.step[1], side.size[1]);
        // Pixel of the frame's first column, and the first column that has one.
        let start = (self.task.columns[0] * step + phase[1]) as isize - side.before[1] as isize;
        let first = if start < 0 { ((-start) as usize).div_ceil(step) } else { 0 };
        let from = (start + (first * step) as isize) as usize;
        if first >= self.pitch || from >= width {
            return;
        }
        let count = (width - from).div_ceil(step).min(self.pitch - first);
        for (r, y) in self.source_rows(phase[0]) {
            let row = &image[y * width + from..(y + 1) * width];
            let line = &mut block[r * self.pitch + first..][..count];
            match step {
                1 => line.copy_from_slice(&row[..count]),
                _ => line.iter_mut().zip(row.iter().step_by(step)).for_each(|(to, v)| *to = *v),
            }
        }
    }

    /// Lays the results' gradients, N x O x H x W, out like the results of this
    /// frame: O rows of [`Self::results_pitch`], zeros where no pixel is. Only for plans whose results have no phases.
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

    /// The task's positions as [`products`](super::outer::products) goes through them.
    pub(crate) fn rows(&self) -> Rows {
        let [rows, columns] = [self.task.rows, self.task.columns].map(|[from, to]| to - from);
        Rows { images: self.task.images, rows, columns, pitch: self.pitch, block: self.block_rows * self.pitch }
    }

    /// Lays the results' gradients, N x O x H x W, out as positions of `lanes`
    /// channels, in the order of [`Self::rows`].
    pub(crate) fn fill_positions(&self, grads: &[f32], lanes: usize, wide: &mut [f32]) {
        let side = &self.plan.result;
        let [from, to] = self.task.columns;
        let mut lines = wide.chunks_exact_mut((to - from) * lanes);
        let mut rows = Vec::with_capacity(side.channels);
        for k in 0..self.task.images {
            let image =
                &grads[(self.task.first + k) * side.channels * side.pixels()..][..side.channels * side.pixels()];
            for (y, line) in (self.task.rows[0]..self.task.rows[1]).zip(&mut lines) {
                rows.clear();
                rows.extend(image.chunks_exact(side.pixels()).map(|plane| &plane[y * side.size[1]..][from..to]));
                side_by_side(&rows, lanes, line);
            }
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

/// `len` or a little more: channels a multiple of 4 KiB apart would share few
/// sets of the first-level cache.
fn apart(len: usize) -> usize {
    if len.is_multiple_of(512) { len + LANES } else { len }
}
