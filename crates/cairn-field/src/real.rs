//! The number type of the renderer: `f32` to work, `f64` to prove it. One
//! generic source keeps the checked arithmetic and the shipped one the same.

/// A floating-point type the renderer can run in.
pub trait Real: num_traits::Float + num_traits::NumAssign + Default + Send + Sync + std::fmt::Debug + 'static {
    /// The nearest value of this type.
    fn of(value: f64) -> Self;
    /// As `f64`.
    fn wide(self) -> f64;
    /// The whole part of a number not below zero; 0 for those and for not-a-number.
    fn whole(self) -> usize;
}

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
    fn whole(self) -> usize {
        // By way of i32, one instruction; lattices are far smaller than that.
        (self as i32).max(0) as usize
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
    fn whole(self) -> usize {
        self as usize
    }
}

/// `ln(1 + e^x)`, without overflow for large `x` and without underflow to a
/// wrong sign for small.
#[inline(always)]
pub(crate) fn softplus<T: Real>(x: T) -> T {
    if x > T::of(20.0) { x } else { x.exp().ln_1p() }
}

/// [`softplus`] and its derivative, the logistic function, from one exponential.
#[inline(always)]
pub(crate) fn softplus_and_slope<T: Real>(x: T) -> (T, T) {
    let e = (-x.abs()).exp();
    let all = T::one() + e;
    if x > T::zero() { (x + e.ln_1p(), T::one() / all) } else { (e.ln_1p(), e / all) }
}
