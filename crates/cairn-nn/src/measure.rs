//! How long a convolution's passes take. For benches: training reads no clock.

use std::time::Instant;

use crate::conv::{Geometry, Isa, Window, passes};

/// A two-dimensional convolution to time, square in kernel, stride and padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Images.
    pub batch: usize,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Rows and columns of the input.
    pub size: [usize; 2],
    /// Rows and columns of the kernel.
    pub kernel: [usize; 2],
    /// Stride both ways.
    pub stride: usize,
    /// Zeros at every side.
    pub padding: [usize; 2],
}

/// What there is to compute in training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    /// Outputs from input and weights.
    Forward,
    /// The input's gradient from the outputs'.
    InputGradient,
    /// The weights' gradient from the outputs'.
    WeightGradient,
}

impl Pass {
    /// All, in the order of training.
    pub const ALL: [Self; 3] = [Self::Forward, Self::InputGradient, Self::WeightGradient];

    /// As in the bench's table and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::InputGradient => "input gradient",
            Self::WeightGradient => "weight gradient",
        }
    }
}

impl ConvShape {
    /// The convolutions that one step of stage 2 does with default settings
    /// (classifier on nine pictures of 128 x 128, detector on five), some
    /// larger ones, a 1 x 1 and two of the one-dimensional kind.
    pub fn of_training() -> Vec<Self> {
        let mut shapes = Vec::new();
        let mut add = |batch, list: &[[usize; 4]]| {
            for &[inputs, outputs, side, stride] in list {
                let (size, kernel, padding) = ([side; 2], [3; 2], [1; 2]);
                shapes.push(Self { batch, inputs, outputs, size, kernel, stride, padding });
            }
        };
        add(9, &[[3, 16, 128, 2], [16, 32, 64, 2], [32, 64, 32, 2], [64, 64, 16, 2]]);
        add(5, &[[10, 8, 128, 1], [8, 16, 128, 2], [16, 16, 64, 1], [16, 32, 64, 2], [32, 32, 32, 1], [32, 48, 32, 2]]);
        add(5, &[[48, 48, 16, 1], [48, 32, 16, 1], [32, 16, 32, 1], [16, 8, 64, 1], [8, 8, 128, 1], [8, 3, 128, 1]]);
        add(2, &[[32, 32, 128, 1]]);
        add(4, &[[16, 16, 128, 1], [16, 32, 128, 2], [64, 64, 32, 1], [128, 128, 16, 1], [256, 256, 8, 1]]);
        let square =
            Self { batch: 4, inputs: 64, outputs: 64, size: [32; 2], kernel: [1; 2], stride: 1, padding: [0; 2] };
        let line = |inputs, outputs, len, stride| Self {
            batch: 4,
            inputs,
            outputs,
            size: [1, len],
            kernel: [1, 9],
            stride,
            padding: [0, 4],
        };
        shapes.extend([square, line(1, 32, 16384, 1), line(32, 32, 4096, 1)]);
        shapes
    }

    /// As in the bench's table and files: batch x inputs x rows x columns, outputs, kernel, stride.
    pub fn name(&self) -> String {
        let ([h, w], [kh, kw]) = (self.size, self.kernel);
        format!("{}x{}x{h}x{w} to {}, {kh}x{kw} by {}", self.batch, self.inputs, self.outputs, self.stride)
    }

    fn window(&self) -> Window {
        let stride = self.size.map(|n| if n == 1 { 1 } else { self.stride });
        Window { stride, padding: self.padding, dilation: [1; 2] }
    }

    fn geometry(&self) -> Result<Geometry, String> {
        let ([h, w], [kh, kw]) = (self.size, self.kernel);
        Geometry::new(&[self.batch, self.inputs, h, w], &[self.outputs, self.inputs, kh, kw], self.window())
    }

    /// Multiplications and additions of one pass, padding counted as PyTorch's and ours do.
    ///
    /// # Errors
    /// When the sizes are no convolution.
    pub fn flops(&self) -> Result<f64, String> {
        let g = self.geometry()?;
        let products = g.batch * g.outputs * g.output[0] * g.output[1] * g.inputs * g.kernel_len();
        Ok(2.0 * products as f64)
    }

    /// Times `pass` on rayon's current pool, in milliseconds a run, after three runs that do not count.
    ///
    /// # Errors
    /// When the sizes are no convolution.
    pub fn time_ms(&self, pass: Pass, runs: usize) -> Result<Vec<f64>, String> {
        let g = self.geometry()?;
        let wave =
            |len: usize, phase: f32| -> Vec<f32> { (0..len).map(|i| (i as f32 * 0.7391 + phase).sin()).collect() };
        let x = wave(g.batch * g.inputs * g.input[0] * g.input[1], 0.0);
        let w = wave(g.outputs * g.inputs * g.kernel_len(), 1.0);
        let grad = wave(g.batch * g.outputs * g.output[0] * g.output[1], 2.0);
        let isa = Isa::best();
        let run = || {
            let start = Instant::now();
            drop(std::hint::black_box(match pass {
                Pass::Forward => passes::forward(isa, &g, &x, &w, None),
                Pass::InputGradient => passes::input_gradient(isa, &g, &grad, &w, None),
                Pass::WeightGradient => passes::weight_gradient(isa, &g, &x, &grad),
            }));
            start.elapsed().as_secs_f64() * 1e3
        };
        // On one of the pool's threads, as a whole step of training would run.
        let times = rayon::scope(|_| (0..runs + 3).map(|_| run()).collect::<Vec<f64>>());
        Ok(times[3..].to_vec())
    }
}
