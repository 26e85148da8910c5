//! The number type of the renderer: `f32` to work, `f64` to prove it. One
//! generic source keeps the checked arithmetic and the shipped one the same.

/// Numbers that are worked out together: one AVX2 register of f32.
pub const LANES: usize = 8;

/// A floating-point type the renderer can run in.
pub trait Real: num_traits::Float + num_traits::NumAssign + Default + Send + Sync + std::fmt::Debug + 'static {
    /// The nearest value of this type.
    fn of(value: f64) -> Self;
    /// As `f64`.
    fn wide(self) -> f64;
    /// The whole part of a number, or 2^30 where that is less (lattices are far smaller); 0
    /// for those below zero and for not-a-number.
    fn whole(self) -> i32;
    /// A whole number as this type.
    fn whole_of(value: i32) -> Self;
    /// `ln(1 + e^x)` and its derivative, the logistic function: without overflow for
    /// large `x` and without underflow to a wrong sign for small.
    fn softplus_and_slope(self) -> (Self, Self);
    /// `1 - e^-x` for `x` >= 0, exact for small `x`.
    fn stopped(self) -> Self;
}

/// The larger of two numbers, `b` where one is not a number: unlike `max`, one instruction.
#[inline(always)]
pub(crate) fn larger<T: Real>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// The smaller of two numbers, `b` where one is not a number.
#[inline(always)]
pub(crate) fn smaller<T: Real>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// See [`Real::whole`]. Exact in f32.
const MAX_WHOLE: f32 = 1_073_741_824.0;

impl Real for f32 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn whole(self) -> i32 {
        // Not `as`: that looks at each number's range by itself, and is no vector instruction.
        let within = smaller(larger(self, 0.0), MAX_WHOLE);
        // SAFETY: it lies in [0, MAX_WHOLE]; what is not a number became 0.
        unsafe { within.to_int_unchecked() }
    }
    #[inline(always)]
    fn whole_of(value: i32) -> Self {
        value as f32
    }
    #[inline(always)]
    fn softplus_and_slope(self) -> (Self, Self) {
        let e = exp_of_negative(-self.abs());
        let inverse = 1.0 / (1.0 + e);
        // ln(1 + e) = 2 artanh(e / (2 + e)), a series in at most 1/9.
        let s = e / (2.0 + e);
        let q = s * s;
        let series = 1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0 + q * (1.0 / 9.0 + q * (1.0 / 11.0)))));
        let slope = if self > 0.0 { inverse } else { e * inverse };
        (self.max(0.0) + 2.0 * s * series, slope)
    }
    #[inline(always)]
    fn stopped(self) -> Self {
        // 1 - 2^n (1 + q) with q = e^r - 1: nothing cancels where n = 0.
        let (scale, q) = exp_parts(-self.min(80.0));
        (1.0 - scale) - scale * q
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }
    #[inline(always)]
    fn whole(self) -> i32 {
        // `as` stays in range, and makes nothing of what is not a number.
        (self as i32).clamp(0, MAX_WHOLE as i32)
    }
    #[inline(always)]
    fn whole_of(value: i32) -> Self {
        f64::from(value)
    }
    #[inline(always)]
    fn softplus_and_slope(self) -> (Self, Self) {
        let e = (-self.abs()).exp();
        let all = 1.0 + e;
        if self > 0.0 { (self + e.ln_1p(), 1.0 / all) } else { (e.ln_1p(), e / all) }
    }
    #[inline(always)]
    fn stopped(self) -> Self {
        -(-self).exp_m1()
    }
}

/// `e^x` for `x` <= 0. Without a branch, so that a loop over it becomes vector
/// instructions, which the C library's is not.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
    // Below, e^x has no normal f32.
    let (scale, q) = exp_parts(x.max(-87.0));
    scale + scale * q
}

/// `(2^n, e^r - 1)` with `x = n ln 2 + r`, `|r| <= ln 2 / 2`, for `x` in [-87, 0]
/// (Cody and Waite 1980, chapter 6); a Taylor series, relative error below 2e-7.
#[inline(always)]
fn exp_parts(x: f32) -> (f32, f32) {
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let n = (x * std::f32::consts::LOG2_E).round_ties_even();
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let q = r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0))))));
    (f32::from_bits(((n as i32 + 127) << 23) as u32), q)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_forms_agree_with_the_exact_ones() {
        for i in -4_000..4_000 {
            let x = f64::from(i) * 0.02 + 0.001;
            let (value, slope) = (x as f32).softplus_and_slope();
            let (exact, exact_slope) = f64::from(x as f32).softplus_and_slope();
            assert!((f64::from(value) - exact).abs() <= 5e-7 * exact + 1e-37, "softplus({x}) = {value}, not {exact}");
            assert!((f64::from(slope) - exact_slope).abs() <= 5e-7 * exact_slope + 1e-37, "its slope: {slope}");
        }
        for i in 0..20_000 {
            let x = 10f32.powf(i as f32 / 1_500.0 - 9.0);
            let exact = f64::from(x).stopped();
            assert!((f64::from(x.stopped()) - exact).abs() <= 5e-7 * exact, "1 - e^-{x}");
        }
    }

    #[test]
    fn whole_parts_are_those_of_the_definition() {
        let all = [(f64::NAN, 0), (f64::NEG_INFINITY, 0), (-3.5, 0), (-0.0, 0), (0.999, 0), (1.0, 1), (4095.996, 4095)];
        let far = [(1_073_741_824.0, 1 << 30), (1e12, 1 << 30), (f64::INFINITY, 1 << 30)];
        for (x, whole) in all.into_iter().chain(far) {
            assert_eq!((x.whole(), (x as f32).whole()), (whole, whole), "{x}");
        }
    }

    #[test]
    fn ends_of_the_range_stay_in_it() {
        for x in [-1e38f32, -1e8, -100.0, -20.0, 0.0, 20.0, 1e8, 1e38] {
            let (value, slope) = x.softplus_and_slope();
            assert!(value.is_finite() && value >= 0.0 && (0.0..=1.0).contains(&slope), "{x}: {value}, {slope}");
        }
        assert_eq!(0.0f32.stopped(), 0.0);
        for x in [1e-30f32, 1e-8, 1.0, 30.0, 1e8, 1e38, f32::INFINITY] {
            let a = x.stopped();
            assert!(a > 0.0 && a <= 1.0, "{x}: {a}");
        }
        assert_eq!(f32::INFINITY.stopped(), 1.0);
        assert_eq!(1e8f32.stopped(), 1.0);
    }
}
