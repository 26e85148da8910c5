//! How long a convolution's passes take. For benches: training reads no clock.

use std::time::Instant;

use serde::Serialize;

use crate::conv::{Geometry, Isa, Window, passes};

/// A two-dimensional convolution to time, square in kernel, stride and padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
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

impl ConvShape {
    fn geometry(&self) -> Result<Geometry, String> {
        let stride = self.size.map(|n| if n == 1 { 1 } else { self.stride });
        let window = Window { stride, padding: self.padding, dilation: [1; 2] };
        let ([h, w], [kh, kw]) = (self.size, self.kernel);
        Geometry::new(&[self.batch, self.inputs, h, w], &[self.outputs, self.inputs, kh, kw], window)
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
