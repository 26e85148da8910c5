//! Sizes of a convolution, and the plans that its passes follow from.
//!
//! Forward pass and input gradient are one computation: results on a grid,
//! each a sum over taps of source pixels at fixed offsets. A stride splits the
//! source into phases (rows and columns modulo the stride) one way and the
//! result the other way, so that every inner loop reads neighbours.

/// A stride, a zero padding and a dilation, `[rows, columns]` each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Input pixels between neighbouring outputs, at least 1.
    pub stride: [usize; 2],
    /// Zeros added at every side.
    pub padding: [usize; 2],
    /// Input pixels between neighbouring taps of the kernel, at least 1.
    pub dilation: [usize; 2],
}

impl Window {
    /// The same stride and padding both ways, without dilation.
    pub fn square(stride: usize, padding: usize) -> Self {
        Self { stride: [stride; 2], padding: [padding; 2], dilation: [1; 2] }
    }

    /// Along columns only: what a one-dimensional convolution does.
    pub fn line(stride: usize, padding: usize) -> Self {
        Self { stride: [1, stride], padding: [0, padding], dilation: [1; 2] }
    }
}

/// All sizes of one convolution; `[rows, columns]` where there are two. A
/// transposed convolution has the sizes of the one whose gradient it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    pub(crate) batch: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) input: [usize; 2],
    pub(crate) kernel: [usize; 2],
    pub(crate) output: [usize; 2],
    pub(crate) window: Window,
}

impl Geometry {
    /// From `x`: N x C x H x W and `w`: O x C x kH x kW.
    pub(crate) fn new(x: &[usize], w: &[usize], window: Window) -> Result<Self, String> {
        let [[batch, inputs, h, wd], [outputs, w_inputs, kh, kw]] = checked(x, w, "O x C x kH x kW", window)?;
        if inputs != w_inputs {
            return Err(format!(
                "the kernel {w:?} takes {w_inputs} input channels, the input {x:?} has {inputs}; \
                 groups are not supported: narrow the channels and convolve each group by itself"
            ));
        }
        let (input, kernel) = ([h, wd], [kh, kw]);
        let mut output = [0; 2];
        for d in 0..2 {
            let padded = input[d] + 2 * window.padding[d];
            let reach = (kernel[d] - 1) * window.dilation[d] + 1;
            if padded < reach {
                return Err(format!("the kernel {w:?} is larger than the padded input {x:?}; pad more: {window:?}"));
            }
            output[d] = (padded - reach) / window.stride[d] + 1;
        }
        Ok(Self { batch, inputs, outputs, input, kernel, output, window })
    }

    /// From `x`: N x O x H x W, `w`: O x C x kH x kW and the rows and columns
    /// `extra` at the far sides: of the convolution that makes `x`'s size of the result's.
    pub(crate) fn transposed(x: &[usize], w: &[usize], window: Window, extra: [usize; 2]) -> Result<Self, String> {
        let [[batch, outputs, h, wd], [w_outputs, inputs, kh, kw]] = checked(x, w, "C x O x kH x kW", window)?;
        if outputs != w_outputs {
            return Err(format!(
                "the transposed kernel {w:?} takes {w_outputs} input channels, the input {x:?} has {outputs}; \
                 groups are not supported: narrow the channels and convolve each group by itself"
            ));
        }
        let (output, kernel) = ([h, wd], [kh, kw]);
        let mut input = [0; 2];
        for d in 0..2 {
            if extra[d] >= window.stride[d] {
                return Err(format!("the output padding {extra:?} must be below the stride: {window:?}"));
            }
            let full = (output[d] - 1) * window.stride[d] + (kernel[d] - 1) * window.dilation[d] + 1 + extra[d];
            input[d] = full.checked_sub(2 * window.padding[d]).filter(|n| *n > 0).ok_or_else(|| {
                format!("nothing is left of {x:?} under the transposed kernel {w:?}; pad less: {window:?}")
            })?;
        }
        Ok(Self { batch, inputs, outputs, input, kernel, output, window })
    }

    pub(crate) fn kernel_len(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    /// `[shift, phase]` of tap `k` along dimension `d`, in source pixels by the stride.
    fn split(&self, d: usize, k: usize) -> [usize; 2] {
        let at = k * self.window.dilation[d];
        [at / self.window.stride[d], at % self.window.stride[d]]
    }

    fn reach(&self) -> [usize; 2] {
        [0, 1].map(|d| self.split(d, self.kernel[d] - 1)[0])
    }

    /// The plan of `out[o] = sum over c and taps of w[o][c][tap] * x[c]`.
    pub(crate) fn forward_plan(&self) -> Plan {
        let mut used = Vec::new();
        let mut taps = Vec::with_capacity(self.kernel_len());
        for index in 0..self.kernel_len() {
            let (y, x) = (self.split(0, index / self.kernel[1]), self.split(1, index % self.kernel[1]));
            let phase = [y[1], x[1]];
            let known = used.iter().position(|p| *p == phase);
            let phase = known.unwrap_or_else(|| {
                used.push(phase);
                used.len() - 1
            });
            taps.push(Tap { index, phase, shift: [y[0], x[0]] });
        }
        let source =
            Side { channels: self.inputs, size: self.input, step: self.window.stride, before: self.window.padding };
        let result = Side { channels: self.outputs, size: self.output, step: [1; 2], before: [0; 2] };
        let parts = vec![Part { taps }];
        Plan { batch: self.batch, source, result, reach: self.reach(), grid: self.output, used, parts }
    }

    /// The plan of the input gradient: each phase of the input is a
    /// convolution of the output gradient with some of the taps.
    pub(crate) fn gradient_plan(&self) -> Plan {
        let reach = self.reach();
        let stride = self.window.stride;
        let mut parts = vec![Part { taps: Vec::new() }; stride[0] * stride[1]];
        for index in 0..self.kernel_len() {
            let (y, x) = (self.split(0, index / self.kernel[1]), self.split(1, index % self.kernel[1]));
            let shift = [reach[0] - y[0], reach[1] - x[0]];
            parts[y[1] * stride[1] + x[1]].taps.push(Tap { index, phase: 0, shift });
        }
        let grid = [0, 1].map(|d| (self.input[d] + self.window.padding[d]).div_ceil(stride[d]));
        let source = Side { channels: self.outputs, size: self.output, step: [1; 2], before: reach };
        let result = Side { channels: self.inputs, size: self.input, step: stride, before: self.window.padding };
        Plan { batch: self.batch, source, result, reach, grid, used: vec![[0; 2]], parts }
    }
}

/// Refuses shapes that are no batch of images and no kernel.
fn checked(x: &[usize], w: &[usize], kernel: &str, window: Window) -> Result<[[usize; 4]; 2], String> {
    let (&[a, b, c, d], &[e, f, g, h]) = (x, w) else {
        return Err(format!("an input N x C x H x W and a kernel {kernel} are needed, got {x:?} and {w:?}"));
    };
    if x.contains(&0) || w.contains(&0) || window.stride.contains(&0) || window.dilation.contains(&0) {
        return Err(format!(
            "sizes, strides and dilations must be at least 1: input {x:?}, kernel {w:?}, {window:?}; leave empty batches out"
        ));
    }
    Ok([[a, b, c, d], [e, f, g, h]])
}

/// One side of a [`Plan`]: planes, and how grid position `q` of phase `a` maps
/// to their pixels: `q * step + a - before`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side {
    pub(crate) channels: usize,
    pub(crate) size: [usize; 2],
    pub(crate) step: [usize; 2],
    pub(crate) before: [usize; 2],
}

impl Side {
    pub(crate) fn pixels(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The first pixel along `d` at or after grid position `q`, at most the size.
    fn first(&self, d: usize, q: usize) -> usize {
        (q * self.step[d]).saturating_sub(self.before[d]).min(self.size[d])
    }
}

/// A kernel's tap: its index in the kernel, the source phase it reads, and how
/// far from the grid position, `[rows, columns]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tap {
    pub(crate) index: usize,
    pub(crate) phase: usize,
    pub(crate) shift: [usize; 2],
}

/// The results of one phase, and the taps that reach them.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    pub(crate) taps: Vec<Tap>,
}

/// What is read, what is written and by which taps.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) batch: usize,
    pub(crate) source: Side,
    pub(crate) result: Side,
    /// Largest shift of any tap.
    pub(crate) reach: [usize; 2],
    /// Grid positions; every result phase has these.
    pub(crate) grid: [usize; 2],
    /// Source phases that taps read.
    pub(crate) used: Vec<[usize; 2]>,
    /// One a result phase, row phases first.
    pub(crate) parts: Vec<Part>,
}

/// A share of the grid that one task computes: whole images, or rows of one
/// image, or columns of one row.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    pub(crate) first: usize,
    pub(crate) images: usize,
    pub(crate) rows: [usize; 2],
    pub(crate) columns: [usize; 2],
}

/// Grid positions of a task at least and at most: enough to fill the inner
/// loops, few enough for the second-level cache.
const POSITIONS: [usize; 2] = [64, 2048];
/// Tasks that a small batch is cut into, so that a few threads share it evenly.
const SHARES: usize = 8;

impl Plan {
    /// Cuts the work. Depends on sizes alone: the thread count must not change
    /// the order of any sum.
    pub(crate) fn tasks(&self) -> Vec<Task> {
        let [h, w] = self.grid;
        let positions = (self.batch * h * w / SHARES).clamp(POSITIONS[0], POSITIONS[1]);
        if 2 * h * w <= positions {
            let images = positions / (h * w);
            let firsts = (0..self.batch).step_by(images);
            let task = |first| Task { first, images: images.min(self.batch - first), rows: [0, h], columns: [0, w] };
            return firsts.map(task).collect();
        }
        let rows = cuts(h, (positions / w).max(1));
        let columns = if h == 1 || w > 2 * POSITIONS[1] { cuts(w, positions) } else { vec![[0, w]] };
        // A piece of a plane must be one slice: rows are cut one by one where columns are cut.
        let rows = if columns.len() > 1 { cuts(h, 1) } else { rows };
        let of = |first: usize| {
            let columns = &columns;
            rows.iter()
                .flat_map(move |&rows| columns.iter().map(move |&columns| Task { first, images: 1, rows, columns }))
        };
        (0..self.batch).flat_map(of).collect()
    }

    /// Result rows and columns of a task, each as `[from, to]`. Pieces of all
    /// tasks of an image, in order, make up its planes.
    pub(crate) fn results(&self, task: &Task) -> [[usize; 2]; 2] {
        [(0, task.rows), (1, task.columns)].map(|(d, [from, to])| {
            let end = if to == self.grid[d] { self.result.size[d] } else { self.result.first(d, to) };
            [if from == 0 { 0 } else { self.result.first(d, from) }, end]
        })
    }
}

/// `n` cut into pieces of about `len`, even to within one.
pub(crate) fn cuts(n: usize, len: usize) -> Vec<[usize; 2]> {
    let pieces = n.div_ceil(len);
    (0..pieces).map(|i| [i * n / pieces, (i + 1) * n / pieces]).collect()
}
