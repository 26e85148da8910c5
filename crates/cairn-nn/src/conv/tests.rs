//! The three passes against sums written out in f64, with each set of
//! instructions and several thread counts.

use super::geometry::{Geometry, Window};
use super::lanes::Isa;
use super::passes;

/// Batch, inputs, outputs, rows, columns, kernel rows, kernel columns.
type Sizes = [usize; 7];

fn wave(len: usize, phase: f32) -> Vec<f32> {
    (0..len).map(|i| (i as f32 * 0.739 + phase).sin()).collect()
}

struct Case {
    g: Geometry,
    x: Vec<f32>,
    w: Vec<f32>,
    grad: Vec<f32>,
}

impl Case {
    fn new([n, c, o, h, w, kh, kw]: Sizes, window: Window) -> Option<Self> {
        let g = Geometry::new(&[n, c, h, w], &[o, c, kh, kw], window).ok()?;
        let outputs = n * o * g.output[0] * g.output[1];
        Some(Self { g, x: wave(n * c * h * w, 0.3), w: wave(o * c * kh * kw, 1.7), grad: wave(outputs, 4.0) })
    }

    /// Calls `f` with (image, output, output pixel, input, input pixel, weight index) of every product.
    fn products(&self, mut f: impl FnMut(usize, usize, usize)) {
        let g = &self.g;
        let [[sh, sw], [ph, pw], [dh, dw]] = [g.window.stride, g.window.padding, g.window.dilation];
        for n in 0..g.batch {
            for (o, c) in (0..g.outputs).flat_map(|o| (0..g.inputs).map(move |c| (o, c))) {
                for (ky, kx) in (0..g.kernel[0]).flat_map(|a| (0..g.kernel[1]).map(move |b| (a, b))) {
                    let weight = (o * g.inputs + c) * g.kernel_len() + ky * g.kernel[1] + kx;
                    for (y, x) in (0..g.output[0]).flat_map(|a| (0..g.output[1]).map(move |b| (a, b))) {
                        let (iy, ix) = ((y * sh + ky * dh).wrapping_sub(ph), (x * sw + kx * dw).wrapping_sub(pw));
                        if iy < g.input[0] && ix < g.input[1] {
                            let input = ((n * g.inputs + c) * g.input[0] + iy) * g.input[1] + ix;
                            f(((n * g.outputs + o) * g.output[0] + y) * g.output[1] + x, input, weight);
                        }
                    }
                }
            }
        }
    }

    /// Forward pass, input gradient and weight gradient in f64: sums, and sums of magnitudes.
    fn slow(&self) -> [Vec<[f64; 2]>; 3] {
        let mut all = [self.grad.len(), self.x.len(), self.w.len()].map(|len| vec![[0.0; 2]; len]);
        let [out, dx, dw] = &mut all;
        let add = |to: &mut [f64; 2], a: f32, b: f32| {
            let product = f64::from(a) * f64::from(b);
            *to = [to[0] + product, to[1] + product.abs()];
        };
        self.products(|o, i, w| {
            add(&mut out[o], self.x[i], self.w[w]);
            add(&mut dx[i], self.grad[o], self.w[w]);
            add(&mut dw[w], self.grad[o], self.x[i]);
        });
        all
    }

    fn fast(&self, isa: Isa) -> [Vec<f32>; 3] {
        let g = &self.g;
        [
            passes::forward(isa, g, &self.x, &self.w, None),
            passes::input_gradient(isa, g, &self.grad, &self.w, None),
            passes::weight_gradient(isa, g, &self.x, &self.grad),
        ]
    }
}

/// Sizes at the borders of tiles, of vectors, of tasks and of strides.
fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let mut state = 1_u64;
    let mut below = |n: u64| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((state >> 33) % n) as usize
    };
    while cases.len() < 120 {
        let sizes =
            [1 + below(4), 1 + below(11), 1 + below(20), 1 + below(23), 1 + below(41), 1 + below(4), 1 + below(5)];
        let window = Window {
            stride: [1 + below(3), 1 + below(3)],
            padding: [below(4), below(4)],
            dilation: [1 + below(2), 1 + below(3)],
        };
        cases.extend(Case::new(sizes, window));
    }
    // One row, long enough to be cut along columns; a plane that is cut in rows; many small images.
    let more: [(Sizes, Window); 6] = [
        ([1, 2, 3, 1, 5000, 1, 9], Window::line(1, 4)),
        ([2, 2, 1, 1, 9001, 1, 5], Window::line(4, 2)),
        ([1, 1, 2, 3, 5003, 3, 3], Window::square(2, 1)),
        ([1, 3, 9, 97, 64, 3, 3], Window::square(1, 1)),
        ([21, 5, 4, 5, 4, 3, 3], Window::square(1, 1)),
        ([21, 5, 4, 5, 4, 3, 3], Window::square(2, 1)),
    ];
    cases.extend(more.into_iter().filter_map(|(sizes, window)| Case::new(sizes, window)));
    cases
}

#[test]
fn all_passes_agree_with_sums_in_f64() {
    for case in cases() {
        let fast = case.fast(Isa::best());
        let passes = ["forward", "input gradient", "weight gradient"];
        for (pass, (fast, slow)) in passes.iter().zip(fast.iter().zip(case.slow())) {
            for (i, (f, [s, magnitude])) in fast.iter().zip(&slow).enumerate() {
                let off = (f64::from(*f) - s).abs();
                assert!(off <= 1e-6 * magnitude, "{pass} of {:?}: entry {i} is {f}, not {s}", case.g);
            }
        }
    }
}

#[test]
fn neither_instructions_nor_threads_change_the_bytes() {
    let bits = |all: [Vec<f32>; 3]| all.map(|v| v.iter().map(|f| f.to_bits()).collect::<Vec<_>>());
    let pools: Vec<_> =
        [1, 2, 3].iter().map(|n| rayon::ThreadPoolBuilder::new().num_threads(*n).build().expect("a pool")).collect();
    for case in cases().iter().skip(60) {
        let expected = bits(case.fast(Isa::best()));
        for isa in Isa::available() {
            for pool in &pools {
                let got = bits(pool.install(|| case.fast(isa)));
                let threads = pool.current_num_threads();
                assert!(got == expected, "{isa:?} with {threads} threads gives other bytes for {:?}", case.g);
            }
        }
    }
}

#[test]
fn what_was_left_in_buffers_does_not_come_back() {
    let window = Window::square(2, 1);
    let mut case = Case::new([2, 3, 5, 17, 19, 3, 3], window).expect("a case");
    let before = case.fast(Isa::best());
    let x = std::mem::replace(&mut case.x, vec![f32::NAN; 2 * 3 * 17 * 19]);
    let grad = std::mem::replace(&mut case.grad, vec![f32::INFINITY; 2 * 5 * 9 * 10]);
    case.fast(Isa::best());
    (case.x, case.grad) = (x, grad);
    assert_eq!(before, case.fast(Isa::best()), "numbers of an earlier call got in");
}
