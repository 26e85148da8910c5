//! Sizes of a convolution and the padded plane layouts that follow from them.

use super::kernel::{SLACK, TILE};

/// A stride and a zero padding, `[rows, columns]` each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Input pixels between neighbouring outputs, at least 1.
    pub stride: [usize; 2],
    /// Zeros added at every side.
    pub padding: [usize; 2],
}

impl Window {
    /// The same stride and padding both ways.
    pub fn square(stride: usize, padding: usize) -> Self {
        Self { stride: [stride; 2], padding: [padding; 2] }
    }
}

/// All sizes of one convolution; `[rows, columns]` where there are two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    pub(crate) batch: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) input: [usize; 2],
    pub(crate) kernel: [usize; 2],
    pub(crate) output: [usize; 2],
    pub(crate) stride: [usize; 2],
    pub(crate) padding: [usize; 2],
}

impl Geometry {
    /// From `x`: N x C x H x W and `w`: O x C x kH x kW.
    pub(crate) fn new(x: &[usize], w: &[usize], window: Window) -> Result<Self, String> {
        let (&[batch, inputs, h, wd], &[outputs, w_inputs, kh, kw]) = (x, w) else {
            return Err(format!("input N x C x H x W and kernel O x C x kH x kW are needed, got {x:?} and {w:?}"));
        };
        if inputs != w_inputs {
            return Err(format!("the kernel {w:?} expects {w_inputs} input channels, the input {x:?} has {inputs}"));
        }
        if x.contains(&0) || w.contains(&0) || window.stride.contains(&0) {
            return Err(format!("sizes and strides must be at least 1: input {x:?}, kernel {w:?}, {window:?}"));
        }
        let (input, kernel) = ([h, wd], [kh, kw]);
        let mut output = [0; 2];
        for d in 0..2 {
            let padded = input[d] + 2 * window.padding[d];
            if padded < kernel[d] {
                return Err(format!("the kernel {w:?} is larger than the padded input {x:?}, {window:?}"));
            }
            output[d] = (padded - kernel[d]) / window.stride[d] + 1;
        }
        Ok(Self { batch, inputs, outputs, input, kernel, output, stride: window.stride, padding: window.padding })
    }

    pub(crate) fn input_len(&self) -> usize {
        self.inputs * self.input[0] * self.input[1]
    }

    pub(crate) fn output_len(&self) -> usize {
        self.outputs * self.output[0] * self.output[1]
    }

    pub(crate) fn kernel_len(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    /// Where the padded input lies: split by phase (row and column modulo the
    /// stride), so that a strided convolution too reads neighbours.
    pub(crate) fn input_layout(&self) -> Layout {
        let [a, b] = [0, 1].map(|d| self.output[d] - 1 + self.kernel[d].div_ceil(self.stride[d]));
        Layout { phases: self.stride, before: self.padding, rows: a, columns: b }
    }

    /// Offset of every kernel tap, row by row, in [`Self::input_layout`].
    pub(crate) fn taps(&self) -> Vec<usize> {
        let layout = self.input_layout();
        let [sh, sw] = self.stride;
        (0..self.kernel_len())
            .map(|t| (t / self.kernel[1], t % self.kernel[1]))
            .map(|(ky, kx)| layout.phase_start([ky % sh, kx % sw]) + (ky / sh) * layout.columns + kx / sw)
            .collect()
    }

    /// Input rows and columns that one phase of the input gradient covers,
    /// counted in the padded input.
    pub(crate) fn gradient_output(&self) -> [usize; 2] {
        [0, 1].map(|d| (self.input[d] + self.padding[d]).div_ceil(self.stride[d]))
    }

    /// Where the output gradient lies for the input gradient: enough zeros
    /// before it for every tap of a phase.
    pub(crate) fn gradient_layout(&self) -> Layout {
        let before = [0, 1].map(|d| self.kernel[d].div_ceil(self.stride[d]) - 1);
        let q = self.gradient_output();
        Layout { phases: [1, 1], before, rows: q[0] + before[0], columns: q[1] + before[1] }
    }

    /// For input rows and columns of phase `[a, b]`: each tap that reaches
    /// them, as (index in the kernel, offset in [`Self::gradient_layout`]).
    pub(crate) fn gradient_taps(&self, [a, b]: [usize; 2]) -> Vec<(usize, usize)> {
        let layout = self.gradient_layout();
        let mut taps = Vec::new();
        for ky in (a..self.kernel[0]).step_by(self.stride[0]) {
            for kx in (b..self.kernel[1]).step_by(self.stride[1]) {
                let row = layout.before[0] - ky / self.stride[0];
                let column = layout.before[1] - kx / self.stride[1];
                taps.push((ky * self.kernel[1] + kx, row * layout.columns + column));
            }
        }
        taps
    }
}

/// How a channel's padded pixels lie in memory: one `rows x columns` plane a
/// phase, then slack.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    pub(crate) phases: [usize; 2],
    /// Zeros before the first row and column.
    pub(crate) before: [usize; 2],
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

impl Layout {
    pub(crate) fn phase_start(&self, [a, b]: [usize; 2]) -> usize {
        (a * self.phases[1] + b) * self.rows * self.columns
    }

    pub(crate) fn plane_len(&self) -> usize {
        self.phases[0] * self.phases[1] * self.rows * self.columns + SLACK
    }

    /// Positions from the first to the last of `size` outputs read in this layout.
    pub(crate) fn span(&self, size: [usize; 2]) -> usize {
        (size[0] - 1) * self.columns + size[1]
    }

    /// [`Self::span`] rounded up to whole steps of the inner loop.
    pub(crate) fn padded_span(&self, size: [usize; 2]) -> usize {
        self.span(size).next_multiple_of(TILE)
    }

    /// Writes one channel's `pixels` (`size`) into `plane`, which MUST be zero.
    pub(crate) fn fill(&self, pixels: &[f32], size: [usize; 2], plane: &mut [f32]) {
        let [sh, sw] = self.phases;
        for (y, row) in pixels.chunks_exact(size[1]).enumerate() {
            let at = y + self.before[0];
            if at / sh >= self.rows {
                break;
            }
            for b in 0..sw {
                let start = self.phase_start([at % sh, b]) + (at / sh) * self.columns;
                let line = &mut plane[start..start + self.columns];
                // The first column of this phase at or after the left border.
                let first = (self.before[1] + sw - 1 - b) / sw;
                let from = first * sw + b - self.before[1];
                if sw == 1 {
                    let n = size[1].min(self.columns - first);
                    line[first..first + n].copy_from_slice(&row[..n]);
                } else if from < row.len() && first < line.len() {
                    for (to, v) in line[first..].iter_mut().zip(row[from..].iter().step_by(sw)) {
                        *to = *v;
                    }
                }
            }
        }
    }
}
