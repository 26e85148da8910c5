//! Sums of many numbers in a fixed order, in sixteen lanes so that they are
//! fast and their rounding error grows with a sixteenth of the length.

const WIDTH: usize = 16;

/// The sum of `f` over `values`.
#[inline(always)]
pub(crate) fn sum_by(values: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let chunks = values.chunks_exact(WIDTH);
    let rest: f32 = chunks.remainder().iter().map(|&v| f(v)).sum();
    let mut lanes = [0.0_f32; WIDTH];
    for chunk in chunks {
        for (l, &v) in lanes.iter_mut().zip(chunk) {
            *l += f(v);
        }
    }
    lanes.iter().sum::<f32>() + rest
}

/// The sum of `f` over pairs of `a` and `b`, which MUST be equally long.
#[inline(always)]
pub(crate) fn sum_pairs(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32) -> f32 {
    let (ca, cb) = (a.chunks_exact(WIDTH), b.chunks_exact(WIDTH));
    let rest: f32 = ca.remainder().iter().zip(cb.remainder()).map(|(&a, &b)| f(a, b)).sum();
    let mut lanes = [0.0_f32; WIDTH];
    for (ca, cb) in ca.zip(cb) {
        for ((l, &a), &b) in lanes.iter_mut().zip(ca).zip(cb) {
            *l += f(a, b);
        }
    }
    lanes.iter().sum::<f32>() + rest
}

/// The sum of `values`.
pub(crate) fn sum(values: &[f32]) -> f32 {
    sum_by(values, |v| v)
}
