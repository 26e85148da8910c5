//! Sixteen floats at a time: the one place that names vector instructions.
//!
//! One AVX-512 register, two AVX2 registers or a plain array, chosen when the
//! program runs. All three give the same numbers, since every lane is the same
//! chain of fused multiply-adds.

/// Numbers a [`Lanes`] holds.
pub(crate) const LANES: usize = 16;

/// Which instructions to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Isa {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Plain,
}

impl Isa {
    /// All that this machine has, best first.
    pub(crate) fn available() -> Vec<Self> {
        let mut all = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                all.push(Self::Avx512);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                all.push(Self::Avx2);
            }
        }
        all.push(Self::Plain);
        all
    }

    /// The best that this machine has.
    pub(crate) fn best() -> Self {
        Self::available()[0]
    }
}

/// Sixteen floats.
///
/// # Safety
/// Implementors may use instructions that only some machines have: methods
/// MUST be called (and inlined) where the implementor's are enabled.
pub(crate) unsafe trait Lanes: Copy {
    /// All lanes `v`.
    ///
    /// # Safety
    /// As the trait says.
    unsafe fn splat(v: f32) -> Self;

    /// Sixteen neighbours from `from`.
    ///
    /// # Safety
    /// `from` must be valid for reading sixteen floats; it need not be aligned.
    unsafe fn load(from: *const f32) -> Self;

    /// Writes the sixteen to `to`.
    ///
    /// # Safety
    /// `to` must be valid for writing sixteen floats; it need not be aligned.
    unsafe fn store(self, to: *mut f32);

    /// `self * b + c`, rounded once.
    ///
    /// # Safety
    /// As the trait says.
    unsafe fn mul_add(self, b: Self, c: Self) -> Self;
}

/// A vector's worth of memory. Read as such and not by the load intrinsics,
/// whose checks in builds with debug assertions cost half the speed.
#[derive(Clone, Copy)]
#[repr(C, packed)]
struct Unaligned<T>(T);

#[cfg(target_arch = "x86_64")]
pub(crate) mod x86 {
    use crate::conv::lanes::{Lanes, Unaligned};
    use std::arch::x86_64::{__m256, __m512, _mm256_fmadd_ps, _mm256_set1_ps, _mm512_fmadd_ps, _mm512_set1_ps};

    /// One register.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx512(__m512);

    // SAFETY: needs avx512f, as the enum `Isa` promises.
    unsafe impl Lanes for Avx512 {
        #[inline(always)]
        unsafe fn splat(v: f32) -> Self {
            // SAFETY: the caller has the instructions.
            Self(unsafe { _mm512_set1_ps(v) })
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: as promised by the caller; the type asks for no alignment.
            Self(unsafe { (*from.cast::<Unaligned<__m512>>()).0 })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: as promised by the caller; the type asks for no alignment.
            unsafe { *to.cast::<Unaligned<__m512>>() = Unaligned(self.0) }
        }

        #[inline(always)]
        unsafe fn mul_add(self, b: Self, c: Self) -> Self {
            // SAFETY: the caller has the instructions.
            Self(unsafe { _mm512_fmadd_ps(self.0, b.0, c.0) })
        }
    }

    /// Two registers.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256, __m256);

    // SAFETY: needs avx2 and fma, as the enum `Isa` promises.
    unsafe impl Lanes for Avx2 {
        #[inline(always)]
        unsafe fn splat(v: f32) -> Self {
            // SAFETY: the caller has the instructions.
            let v = unsafe { _mm256_set1_ps(v) };
            Self(v, v)
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            let from = from.cast::<Unaligned<__m256>>();
            // SAFETY: as promised by the caller; the type asks for no alignment.
            unsafe { Self((*from).0, (*from.add(1)).0) }
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            let to = to.cast::<Unaligned<__m256>>();
            // SAFETY: as promised by the caller; the type asks for no alignment.
            unsafe {
                *to = Unaligned(self.0);
                *to.add(1) = Unaligned(self.1);
            }
        }

        #[inline(always)]
        unsafe fn mul_add(self, b: Self, c: Self) -> Self {
            // SAFETY: the caller has the instructions.
            unsafe { Self(_mm256_fmadd_ps(self.0, b.0, c.0), _mm256_fmadd_ps(self.1, b.1, c.1)) }
        }
    }
}

/// An array; the compiler may or may not make vectors of it.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; LANES]);

// SAFETY: needs nothing.
unsafe impl Lanes for Plain {
    #[inline(always)]
    unsafe fn splat(v: f32) -> Self {
        Self([v; LANES])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: as promised by the caller; the type asks for no alignment.
        Self(unsafe { (*from.cast::<Unaligned<[f32; LANES]>>()).0 })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as promised by the caller; the type asks for no alignment.
        unsafe { *to.cast::<Unaligned<[f32; LANES]>>() = Unaligned(self.0) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, b: Self, c: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].mul_add(b.0[i], c.0[i])))
    }
}

/// The sum of the sixteen, always in the same order.
#[inline(always)]
pub(crate) fn sum(v: &[f32; LANES]) -> f32 {
    let mut half = [0.0_f32; 8];
    for i in 0..8 {
        half[i] = v[i] + v[i + 8];
    }
    ((half[0] + half[4]) + (half[2] + half[6])) + ((half[1] + half[5]) + (half[3] + half[7]))
}
